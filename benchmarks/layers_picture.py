"""docs/layers.png: what layers say of the ground of the example drive.

python -m benchmarks.layers_picture vineyard.gpkg docs/layers.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from fieldgrid.figures.grid import draw_grid
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import open_map

LAYERS = (
    *("slope", "roughness", "step", "traversability"),
    *("density", "occupancy", "max_height", "clearance"),
)
CELL_M, ROWS, WIDTH_IN, HEIGHT_IN = 0.1, 2, 13.0, 6.8
AREA = Bounds(-12.0, 55.0, 10.0, 80.0)
"""The ends of both lanes, and the headland."""


def main() -> None:
    """Draw the layers beside each other."""
    source, target = map(Path, sys.argv[1:])
    with open_map(source) as universal:
        view = universal.read(AREA, cell_m=CELL_M, layers=LAYERS)
    figure, places = plt.subplots(
        ROWS, len(LAYERS) // ROWS, figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained"
    )
    for axes, name in zip(places.flat, LAYERS, strict=True):
        draw_grid(axes, view, (), name, layer=name)
        axes.label_outer()
    figure.savefig(target, dpi=90)


if __name__ == "__main__":
    main()
