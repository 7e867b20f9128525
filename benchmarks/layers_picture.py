"""The pictures of docs/layers.md and docs/hills.md: every layer of the example drive, by subject.

python -m benchmarks.layers_picture vineyard.gpkg docs [--two-drives season.gpkg]

The layers over time need a map of several drives (`--two-drives`), those of the rendered
vineyard in June and in August.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt

from fieldgrid.export.figures.grid import draw_grid
from fieldgrid.geometry import Bounds
from fieldgrid.maps import open_map

COLUMNS, WIDTH_IN, HEIGHT_IN, DPI = 4, 13.0, 3.4, 90
AREA = Bounds(-12.0, 55.0, 10.0, 80.0)
"""The ends of both lanes, and the headland."""


class Sheet(NamedTuple):
    """A picture: its file, and layers, each at its cell size in metres."""

    name: str
    layers: tuple[tuple[str, float], ...]
    several_drives: bool = False


def _at(cell_m: float, *names: str) -> tuple[tuple[str, float], ...]:
    return tuple((name, cell_m) for name in names)


SHEETS = (
    Sheet(
        "layers_density.png",
        (*_at(0.05, "density", "max", "variance", "count"), *_at(0.25, "density", "peak"),
         *_at(0.25, "seen_share", "sure_share")),
    ),
    Sheet("layers_terrain.png", _at(0.1, "ground", "ground_sigma", "height", "slope", "roughness",
                                    "step", "drop", "traversability")),
    Sheet("layers_standing.png", _at(0.1, "density", "occupancy", "max_height", "clearance")),
    Sheet("layers_time.png", _at(0.1, "sessions", "persistence", "static", "seasonal",
                                 "passing", "lasting", "moved"), several_drives=True),
    Sheet("layers.png", _at(0.1, "slope", "roughness", "step", "traversability", "density",
                            "occupancy", "max_height", "clearance")),
)  # fmt: skip


def draw(sheet: Sheet, source: Path, target: Path) -> None:
    """Draw the layers of a sheet beside each other."""
    rows = -(-len(sheet.layers) // COLUMNS)
    figure, places = plt.subplots(
        rows, COLUMNS, figsize=(WIDTH_IN, HEIGHT_IN * rows), layout="constrained", squeeze=False
    )
    with open_map(source) as universal:
        for axes, (name, cell_m) in zip(places.flat, sheet.layers, strict=True):
            view = universal.read(AREA, cell_m=cell_m, layers=(name,))
            draw_grid(axes, view, (), f"{name}, {cell_m:g} m", layer=name)
            axes.label_outer()
    figure.savefig(target, dpi=DPI)


def main() -> None:
    """Draw the sheets whose maps are given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("example", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--two-drives", type=Path)
    arguments = parser.parse_args()
    for sheet in SHEETS:
        source = arguments.two_drives if sheet.several_drives else arguments.example
        if source is not None:
            draw(sheet, source, arguments.folder / sheet.name)


if __name__ == "__main__":
    main()
