"""`python -m benchmarks.quadtree`: how many squares a map becomes, what they lose, what they cost.

The hillside and KITTI's drive are beside the repository in ../shared/data, and left out where they
are absent. `--picture docs/quadtree.png` draws the squares of the example drive instead.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Rectangle

from benchmarks import EXAMPLE
from benchmarks.hills import KITTI, SLOPE
from benchmarks.timing import paired_ms
from fieldgrid.core import UNSEEN, BuildSettings
from fieldgrid.export.figures.grid import draw_grid
from fieldgrid.geometry import Bounds
from fieldgrid.maps import LAYERS, Costmap, MapFile, Near, Quadtree, open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

DRIVES = ((EXAMPLE, "gnss_rtk.nmea"), (SLOPE, "gnss_rtk.nmea"), (KITTI, None))
LOSSES = (0.0, 16.0, 32.0, 255.0)
DUAL_M = (0.05, 0.4)
AREA = Bounds(-6.4, 64.0, 6.4, 76.8)
"""The end of a lane and the headland."""


def main() -> None:
    """Print what is measured, or draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    picture = parser.parse_args().picture
    for folder, gnss in DRIVES if picture is None else DRIVES[:1]:
        if not folder.is_dir():
            continue
        with tempfile.TemporaryDirectory() as place:
            out = Path(place) / "map.gpkg"
            build_map([folder], out, BuildSettings(), DriveOptions(gnss))
            with open_map(out) as universal:
                if picture is None:
                    print("\n".join(measured(folder.name, universal)), flush=True)
                else:
                    draw(universal, picture)


def measured(name: str, universal: MapFile) -> Iterator[str]:
    """The squares of a map for some losses, and of two sizes."""
    cells = int(universal.read().observed.sum())
    yield f"{name}: {cells} cells of {universal.cell_m:g} m"
    for least_seen in (1.0, 0.9, 0.5):
        for loss in LOSSES:
            asked = {"loss": loss, "least_seen": least_seen}
            yield f"  loss {loss:g}, {_said(universal, cells, asked)}"
        yield f"  of two sides, {_said(universal, cells, {'sides_m': DUAL_M, **asked})}"
    made, costs = paired_ms(
        partial(Quadtree.from_map, universal), partial(Costmap.from_map, universal), 9
    )
    yield f"  it takes {made:.0f} ms, a costmap {costs:.0f} ms"


def _said(universal: MapFile, cells: int, asked: dict[str, Any]) -> str:
    found = Quadtree.from_map(universal, **asked)
    part = found.squares
    covered = (part.seen_share.astype(float) * 4.0**part.level).sum()
    area = (4.0**part.level).sum()
    return (
        f"{asked['least_seen']:.0%} seen: {len(found)} squares, {cells / len(found):.1f} cells a "
        f"square; worst loss {found.worst_loss:.2f}; {1.0 - covered / area:.1%} of it unseen"
    )


def draw(universal: MapFile, target: Path) -> None:
    """The cells, the squares, and those of two sizes that are small near the vehicle."""
    view = universal.read(AREA)
    middle = (AREA.west_m + AREA.east_m) / 2.0, (AREA.south_m + AREA.north_m) / 2.0
    trees = {
        "loss 16": Quadtree.from_map(universal, AREA),
        "loss 16, half seen": Quadtree.from_map(universal, AREA, least_seen=0.5),
        "5 and 40 cm, 5 within 2 m of a point": Quadtree.from_map(
            universal, AREA, sides_m=DUAL_M, least_seen=0.5, loss=255.0, near=Near(middle, 2.0)
        ),
    }
    figure, places = plt.subplots(1, 4, figsize=(16.0, 4.8), layout="constrained")
    draw_grid(places[0], view, (), "cells of 5 cm")
    for axes, (title, tree) in zip(places[1:], trees.items(), strict=True):
        _draw_squares(axes, tree)
        axes.set_title(f"{title}: {len(tree)}", fontsize=11)
    figure.savefig(target, dpi=90)


def _draw_squares(axes: Axes, tree: Quadtree) -> None:
    boxes = [
        Rectangle((west, south), side, side)
        for west, south, side in zip(tree.west_m, tree.south_m, tree.side_m, strict=True)
    ]
    ramp = LinearSegmentedColormap.from_list("density", list(LAYERS["density"].colours.ramp))
    drawn = PatchCollection(boxes, cmap=ramp, edgecolor="#00000060", linewidth=0.2)
    drawn.set_array(np.nan_to_num(tree.squares.mean))
    drawn.set_clim(0.0, 255.0)
    axes.add_collection(drawn)
    axes.set(xlim=AREA[0::2], ylim=AREA[1::2], aspect="equal", facecolor=UNSEEN)
    axes.set_xlabel("east, m")


if __name__ == "__main__":
    main()
