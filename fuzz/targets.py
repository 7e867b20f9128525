"""Every parser that is fuzzed. A new one needs a module like `fuzz.nmea`, and a line here."""

from __future__ import annotations

from fuzz import nmea, targets_formats
from fuzz.target import Target

TARGETS: list[Target] = [
    nmea.TARGET,
    *targets_formats.TARGETS,
]
