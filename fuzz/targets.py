"""Every parser that is fuzzed. A new one needs a module like `fuzz.nmea`, and a line here."""

from __future__ import annotations

from fuzz import nmea, targets_bags, targets_files, targets_formats, targets_map, targets_ros
from fuzz.target import Target

TARGETS: list[Target] = [
    nmea.TARGET,
    *targets_formats.TARGETS,
    *targets_files.TARGETS,
    *targets_map.TARGETS,
    *targets_ros.TARGETS,
    *targets_bags.TARGETS,
]
