"""The universal grid and its changes, in metres east and north."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fieldgrid.figures.page import new_figure
from fieldgrid.mapfile import MEANING, Change, ChangeView, FrameRecord, MapView
from fieldgrid.trajectory import Status

UNSEEN = "#cfdbe6"
"""Colour of cells that no frame has seen: neither bright nor dark."""


_DENSITY = LinearSegmentedColormap.from_list("density", ["#ffffff", "#000000"])


_CHANGES = {
    Change.UNKNOWN: UNSEEN,
    Change.FREE: "#ffffff",
    Change.STAYED: "#404040",
    Change.APPEARED: "#c1121f",
    Change.VANISHED: "#1d6fd1",
    Change.NEW_OBSTACLE: "#e08e45",
    Change.NEW_FREE: "#f2ecd8",
    Change.NOT_SEEN_AGAIN: "#a9b4bd",
}


_GRID_POINT = "#0b6e4f"


def universal_grid(
    view: MapView, frames: list[FrameRecord] | None = None, *, title: str = ""
) -> Figure:
    """The universal grid with axes in metres east and north, and the 0-255 bar (Figs. 8-14).

    With `frames`, the positions of their local grids are marked.
    """
    bounds = view.bounds
    width_m, height_m = bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m
    long_side_in = 9.0
    scale = long_side_in / max(width_m, height_m)
    size = (max(width_m * scale, 3.0) + 2.2, max(height_m * scale, 3.0) + 1.2)
    figure = new_figure(size)
    draw_grid(figure.add_subplot(), view, frames or [], title)
    return figure


def change(view: ChangeView, *, title: str = "") -> Figure:
    """What changed between two moments: a colour for what became of each cell."""
    bounds = view.bounds
    width_m, height_m = bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m
    scale = 9.0 / max(width_m, height_m)
    figure = new_figure((max(width_m * scale, 3.0) + 3.8, max(height_m * scale, 3.0) + 1.2))
    axes = figure.add_subplot()
    axes.imshow(
        view.change,
        origin="lower",
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=ListedColormap([_CHANGES[kind] for kind in Change]),
        vmin=0,
        vmax=len(Change) - 1,
        interpolation="none",
        aspect="equal",
    )
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False)
    axes.set_title(title or f"{', '.join(view.after)} against {', '.join(view.before)}", wrap=True)
    legend = [
        Patch(facecolor=_CHANGES[kind], edgecolor="0.6", label=MEANING[kind]) for kind in Change
    ]
    figure.legend(handles=legend, loc="outside right upper", fontsize="small")
    return figure


def draw_grid(axes: Axes, view: MapView, frames: list[FrameRecord], title: str) -> None:
    """Draw the universal grid into axes."""
    bounds = view.bounds
    shown = np.ma.masked_array(view.density, mask=~view.observed)
    axes.set_facecolor(UNSEEN)
    image = axes.imshow(
        shown,
        origin="lower",
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=_DENSITY,
        vmin=0,
        vmax=255,
        interpolation="none",
        aspect="equal",
    )
    marked = [f for f in frames if f.pose.status is Status.OK and _inside(f, view)]
    if marked:
        axes.plot(
            [f.pose.east_m for f in marked],
            [f.pose.north_m for f in marked],
            linestyle="none",
            marker=".",
            markersize=4,
            color=_GRID_POINT,
        )
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False)
    axes.set_title(title or f"universal grid, cells of {view.lattice.cell_m * 100:g} cm")
    # Beside the axes and exactly as tall, whatever the map's shape.
    bar = axes.figure.colorbar(image, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)))
    bar.set_label("3D density (> 100: obstacle; tinted: unseen)")


def _inside(frame: FrameRecord, view: MapView) -> bool:
    bounds = view.bounds
    east_m, north_m = frame.pose.east_m, frame.pose.north_m
    return bounds.west_m <= east_m <= bounds.east_m and bounds.south_m <= north_m <= bounds.north_m
