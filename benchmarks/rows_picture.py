"""docs/rows.png: what `fieldgrid rows` finds in a map.

python -m benchmarks.rows_picture vineyard.gpkg docs/rows.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.evidence import OBSTACLE, UNSEEN, Evidence
from fieldgrid.mapfile import open_map
from fieldgrid.rows import find_rows


def draw(map_: Path, out: Path) -> None:
    """Draw the rows of a map over its obstacles."""
    with open_map(map_) as universal:
        view = universal.read()
        found = find_rows(universal)
    evidence, bounds = Evidence.of(view), view.bounds
    picture = np.full((*evidence.cells.shape, 3), 255, dtype=np.uint8)
    picture[evidence.cells == UNSEEN] = (222, 226, 232)
    picture[evidence.cells == OBSTACLE] = (90, 90, 90)
    high, wide = bounds.north_m - bounds.south_m, bounds.east_m - bounds.west_m
    figure = Figure(figsize=(7.0, 7.0 * high / wide), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    extent = (bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="antialiased")
    for headland in found.headlands:
        axes.fill(*headland.area.exterior.xy, color="#e8a33d", alpha=0.25, lw=0)
    for lane in found.lanes:
        axes.fill(*lane.area.exterior.xy, color="#3a9d5d", alpha=0.25 * lane.known + 0.05, lw=0)
        axes.plot(*lane.line.xy, color="#1d7a3f", lw=1.2, ls="-" if lane.driven else ":")
        place = lane.line.interpolate(0.4, normalized=True).coords[0]
        is_known = np.isfinite(lane.free_width_m)
        name = f"{lane.id} {lane.free_width_m:.2f} m" if is_known else f"{lane.id} unknown"
        axes.annotate(name, place, fontsize=7, ha="center", color="#0b4a22")
    for row in found.rows:
        axes.plot(*row.line.xy, color="#c0392b", lw=1.4)
        axes.annotate(row.id, row.line.coords[0], fontsize=7, color="#7d1d12")
    for gap in found.gaps:
        axes.plot(*gap.line.xy, color="#2b7bd6", lw=4.0)
    for thing in found.obstacles:
        axes.plot(*thing.area.exterior.xy, color="#a01fa0", lw=1.4)
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="east, m", ylabel="north, m", aspect="equal")
    figure.savefig(out)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
