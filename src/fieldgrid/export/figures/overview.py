"""Map, trajectories and headings on one page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from fieldgrid.export.figures.drives import DrawnDrive, draw_heading, draw_trajectory
from fieldgrid.export.figures.grid import draw_grid
from fieldgrid.export.figures.page import new_figure
from fieldgrid.maps import MapView

_HEADINGS = 3
"""Sessions whose headings find room beside a map: the latest ones."""

_WIDE = 1.6
"""A map that is over 1.6 times as wide as high lies above the other two, not beside them."""


def sheet(view: MapView, drives: Sequence[DrawnDrive], **drawn: Any) -> Figure:
    """The map beside or above the paths driven and the headings of the latest drives; `drawn` are
    as in `universal_grid`."""
    bounds = view.bounds
    share = (bounds.north_m - bounds.south_m) / (bounds.east_m - bounds.west_m)
    shown = list(drives)[-_HEADINGS:] or [DrawnDrive("")]
    if share * _WIDE < 1.0:
        figure = new_figure((16.0, 14.0 * share + 2.0 + 5.5))
        rows = figure.add_gridspec(2, 1, height_ratios=(14.0 * share + 2.0, 5.5))
        place, rest = rows[0], rows[1].subgridspec(1, 2)
    else:
        figure = new_figure((16.0, 9.0))
        columns = figure.add_gridspec(1, 2, width_ratios=(1.35, 1.0))
        place, rest = columns[0], columns[1].subgridspec(2, 1, height_ratios=(1.35, 1.0))
    axes = figure.add_subplot(place)
    draw_grid(axes, view, drives, **drawn)
    if drawn.get("found"):
        handles, names = axes.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=8, frameon=False)
    draw_trajectory(figure.add_subplot(rest[0]), drives)
    headings = rest[1].subgridspec(len(shown), 1)
    for number, drive in enumerate(shown):
        axes = figure.add_subplot(headings[number])
        draw_heading(axes, drive)
        if len(shown) > 1:  # a third of the room: what all have in common goes without saying
            axes.set_title(drive.name, fontsize="medium")
            axes.set(yticks=range(-180, 181, 180), ylabel="heading (°)")
    return figure
