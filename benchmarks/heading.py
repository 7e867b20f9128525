"""`python -m benchmarks.heading`: headings and gears from positions beside real truths.

The logs lie beside the repository, in ../shared/data; a section whose data are absent is
skipped. `--plots DIR` draws the epochs that are wrong, `--only NAME` runs one section.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks import (
    heading_gyro,
    heading_harvester,
    heading_holes,
    heading_honesty,
    heading_road,
    heading_stops,
    heading_tractor,
    heading_vineyard,
    heading_wander,
    heading_weave,
)


class Section(NamedTuple):
    """A table: its name, its title, the data that it needs, and its lines."""

    name: str
    title: str
    needs: Path
    lines: Callable[[], Iterator[str]]


SECTIONS = (
    Section(
        "offset",
        "how far poses lie from accepted fixes",
        heading_road.FOLDER,
        heading_honesty.report_offsets,
    ),
    Section(
        "sigma",
        "simulated drives whose stated sigma changes: errors in sigmas",
        Path("."),
        heading_honesty.report_sigmas,
    ),
    Section(
        "gyro",
        "simulated drives with gyros right and wrong, beside the truth",
        Path("."),
        heading_gyro.report,
    ),
    Section(
        "wander",
        "simulated receivers that drift smoothly within seconds, with gyro, beside the truth",
        Path("."),
        heading_wander.report,
    ),
    Section(
        "stops",
        "simulated vehicles that stop, positions only: errors in sigmas, driving and at rest",
        Path("."),
        heading_stops.report,
    ),
    Section(
        "holes",
        "simulated vehicles whose fixes have holes, positions only, beside the truth",
        Path("."),
        heading_holes.report,
    ),
    Section(
        "doubt",
        "garden tractor, whole and with holes: said doubt of the gear against observed",
        heading_tractor.FOLDER,
        heading_honesty.report_doubts,
    ),
    Section(
        "tractor",
        "garden tractor, positions only, beside its two antennas",
        heading_tractor.FOLDER,
        heading_tractor.report,
    ),
    Section(
        "harvester",
        "forage harvester, 1 Hz: gears beside the work state",
        heading_harvester.FOLDER,
        heading_harvester.report,
    ),
    Section(
        "road",
        "KITTI, positions only and with its gyro, beside the inertial unit",
        heading_road.FOLDER,
        heading_road.report,
    ),
    Section(
        "rendered",
        "rendered vineyard, beside its truth",
        heading_vineyard.TRUTH,
        heading_vineyard.report_rendered,
    ),
    Section(
        "rows",
        "vineyard robot, positions only, beside the surveyed rows",
        heading_vineyard.FOLDER,
        heading_vineyard.report_rows,
    ),
    Section(
        "weave",
        "why the vineyard robot scatters about its rows, beside simulated robots that weave as far",
        heading_vineyard.FOLDER,
        heading_weave.report,
    ),
    Section(
        "harm",
        "the garden tractor's drives by worse receivers, pooled",
        heading_tractor.FOLDER,
        heading_tractor.report_harmed,
    ),
)


def main(arguments: list[str] | None = None) -> None:
    """Measure and print everything, or one section."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=[section.name for section in SECTIONS])
    parser.add_argument("--plots", type=Path, help="draw what is wrong into this folder")
    options = parser.parse_args(arguments)
    for section in SECTIONS:
        if options.only in (None, section.name):
            print(f"\n{section.title}")
            if section.needs.exists():
                for line in section.lines():
                    print(f"  {line}".rstrip())
            else:
                print("  absent: skipped")
    if options.plots is not None:
        from benchmarks import heading_plots

        options.plots.mkdir(parents=True, exist_ok=True)
        heading_plots.draw(options.plots)


if __name__ == "__main__":
    main()
