"""The universal grid and its changes, in metres east and north."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from fieldgrid.core import FOUND, ROUTE, UNSEEN, Float64, palette
from fieldgrid.export.cells.raster import value_range
from fieldgrid.export.figures.drives import MOST_NAMES, DrawnDrive
from fieldgrid.export.figures.page import (
    add_scale_bar,
    is_wide,
    name_axes,
    new_figure,
    outline_patch,
    size_of,
)
from fieldgrid.export.figures.relief import draw_relief
from fieldgrid.field import ChangedObject
from fieldgrid.geometry import FREE_UP_TO, Bounds, Feature
from fieldgrid.maps import LAYERS, MEANING, Change, ChangeView, MapView, Mark, MarkKind, decision

# What people said of places, drawn over a map.


SAYS = {
    MarkKind.KEEPOUT: "keep out",
    MarkKind.FREE: "said to be free",
    MarkKind.OBSTACLE: "said to be an obstacle",
    MarkKind.PLACE: "place",
}
_HATCH = {MarkKind.KEEPOUT: "///", MarkKind.OBSTACLE: "xx"}


def draw_marks(
    axes: Axes, marks: Sequence[Mark], bounds: Bounds, others: Sequence[Patch] = ()
) -> None:
    """Draw the marks that lie within bounds, with their names and a legend of their kinds, and of
    `others` that were drawn."""
    inside = [
        mark
        for mark in marks
        if mark.bounds.west_m <= bounds.east_m
        and mark.bounds.east_m >= bounds.west_m
        and mark.bounds.south_m <= bounds.north_m
        and mark.bounds.north_m >= bounds.south_m
    ]
    for mark in inside:
        colour = palette.MARKS[mark.kind]
        if mark.is_point:
            axes.plot(*zip(*mark.corners, strict=True), marker="D", markersize=6, color=colour)
        else:
            axes.add_patch(
                outline_patch(
                    mark.geometry, color=colour, linewidth=1.8, hatch=_HATCH.get(mark.kind)
                )
            )
        if mark.name:
            place = mark.geometry.representative_point().coords[0]
            axes.annotate(
                mark.name,
                place,
                xytext=(5, 4),
                textcoords="offset points",
                color=colour,
                fontsize="small",
                clip_on=True,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
            )
    handles = [*others] + [
        Line2D([], [], linestyle="none", marker="D", color=palette.MARKS[kind], label=SAYS[kind])
        if kind is MarkKind.PLACE
        else Patch(
            fill=False, edgecolor=palette.MARKS[kind], hatch=_HATCH.get(kind), label=SAYS[kind]
        )
        for kind in MarkKind
        if any(mark.kind is kind for mark in inside)
    ]
    if handles:
        axes.legend(handles=handles, loc="upper left", fontsize="small")


def draw_counted(axes: Axes, view: MapView) -> list[Patch]:
    """Tint what counts as free for whoever decides, and does not look so: ground that was driven
    over, and things that moved. Returns what a legend says of it, nothing where there is none, or
    where the view was not read to decide."""
    if view.decided is None:
        return []
    is_said = (view.decided.flags & (decision.DRIVEN | decision.MOVED)) > 0
    shown = is_said & (view.decided.worst == 0) & ~(view.observed & (view.density <= FREE_UP_TO))
    if not shown.any():
        return []
    colour, bounds = palette.MARKS[MarkKind.FREE], view.bounds
    axes.imshow(
        np.ma.masked_array(shown, mask=~shown),
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=ListedColormap([colour]),
        alpha=_TINT,
        origin="lower",
        interpolation="none",
        interpolation_stage="data",
        aspect="equal",
    )
    return [Patch(facecolor=colour, alpha=_TINT, label="free: driven over, or moved")]


_TINT = 0.45

# Rows and what lies between them, drawn over a map.


_ORDER = ("headland", "lane", "row", "gap", "obstacle")
"""Later ones lie on top; blocks are the rows and lanes that are drawn."""

_WIDTHS = {"lane": 1.2, "row": 1.6, "gap": 4.0}
_NAMED = {"lane": 0.4, "row": 0.0}
"""Kinds that have their names beside them: at which share of the length of their lines."""


def draw_found(axes: Axes, features: Sequence[Feature]) -> None:
    """Draw the rows, lanes, gaps, headlands and obstacles of a map, rows and lanes with their
    names; a lane that was not driven is dotted. The first of each kind has a label for a legend.
    """
    labelled = set[str]()
    for kind in _ORDER:
        for one in (feature for feature in features if feature.kind == kind):
            is_dotted = kind == "lane" and not one.properties["driven"]
            name = "lane, not driven" if is_dotted else kind
            style: dict[str, Any] = {
                "color": FOUND[kind],
                "label": None if name in labelled else name,
            }
            labelled.add(name)
            if kind in _WIDTHS:
                axes.plot(
                    *one.geometry.xy,
                    linewidth=_WIDTHS[kind],
                    linestyle=":" if is_dotted else "-",
                    **style,
                )
            else:
                # A tint would look like a value of the cells below it.
                hatch = "//" if kind == "headland" else None
                axes.add_patch(outline_patch(one.geometry, hatch=hatch, linewidth=1.2, **style))
            if kind in _NAMED:
                place = one.geometry.interpolate(_NAMED[kind], normalized=True).coords[0]
                axes.annotate(
                    str(one.properties["id"]),
                    place,
                    fontsize=7,
                    color=FOUND[kind],
                    annotation_clip=True,
                    bbox={"facecolor": "white", "alpha": 0.7, "pad": 0.8, "linewidth": 0.0},
                )


_DENSITY_LABEL = "3D density (> 100: obstacle; tinted: unseen)"


def universal_grid(view: MapView, drives: Sequence[DrawnDrive] = (), **drawn: Any) -> Figure:
    """The universal grid with axes in metres east and north, and a bar of its values (Figs. 8-14).

    `drawn` are `title`, `layer`, `route` and `found`, as `draw_grid` takes them.
    """
    width_in, height_in = size_of(view.bounds)
    beside_in, below_in = (1.0, 2.4) if is_wide(view.bounds) else (2.2, 1.4)
    figure = new_figure((width_in + beside_in, height_in + below_in))
    axes = figure.add_subplot()
    draw_grid(axes, view, drives, **drawn)
    handles, names = axes.get_legend_handles_labels()
    if len(handles) > 1:
        figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    return figure


def draw_grid(
    axes: Axes,
    view: MapView,
    drives: Sequence[DrawnDrive] = (),
    title: str = "",
    *,
    layer: str = "density",
    route: Float64 | None = None,
    found: Sequence[Feature] = (),
) -> None:
    """Draw the universal grid into axes; heights with shades and contours.

    With `drives`, the positions of their local grids are marked, a colour a session; what people
    said of places is drawn over all. `layer` is one that the view was read with; `route` [n, 2],
    metres east and north, and `found`, rows and what lies between them, are drawn over it. Without
    a `title` the size of the cells is said.
    """
    bounds, values = view.bounds, view.layer(layer)
    seen = view.observed & np.isfinite(values)
    low, high = value_range(layer, values[seen])
    axes.set_facecolor(UNSEEN)
    image = axes.imshow(
        np.ma.masked_array(values, mask=~seen),
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=LinearSegmentedColormap.from_list(layer, list(LAYERS[layer].colours.ramp)),
        vmin=low,
        vmax=high,
        origin="lower",
        interpolation="none",
        interpolation_stage="data",  # the same picture, without four floats of colour a cell
        aspect="equal",
    )
    if LAYERS[layer].above_datum:
        draw_relief(axes, view, values, seen)
    _mark_frames(axes, drives, view)
    if found:
        draw_found(axes, found)
    if route is not None:
        axes.plot(route[:, 0], route[:, 1], color="white", linewidth=3.4)
        axes.plot(route[:, 0], route[:, 1], color=ROUTE, linewidth=1.8, label="route")
    draw_marks(axes, view.marks, bounds, draw_counted(axes, view) if layer == "density" else ())
    # What leaves the part that is drawn does not widen it.
    axes.set(xlim=(bounds.west_m, bounds.east_m), ylim=(bounds.south_m, bounds.north_m))
    name_axes(axes, title or f"universal grid, cells of {view.lattice.cell_m * 100:g} cm")
    add_scale_bar(axes, bounds.east_m - bounds.west_m)
    if is_wide(bounds):
        below: Any = {"location": "bottom", "aspect": 60, "fraction": 0.08, "pad": 0.03}
        bar = axes.figure.colorbar(image, ax=axes, **below)
    else:  # beside the ground and as tall
        bar = axes.figure.colorbar(image, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)))
    unit = LAYERS[layer].unit
    words = layer if unit in ("", "1") else f"{layer} ({unit})"
    bar.set_label(_DENSITY_LABEL if layer == "density" else words)


def _mark_frames(axes: Axes, drives: Sequence[DrawnDrive], view: MapView) -> None:
    bounds = view.bounds
    for number, drive in enumerate(drives):
        inside = [
            frame.pose
            for frame in drive.frames
            if frame.accepted
            and bounds.west_m <= frame.pose.east_m <= bounds.east_m
            and bounds.south_m <= frame.pose.north_m <= bounds.north_m
        ]
        if inside:
            axes.plot(
                [pose.east_m for pose in inside],
                [pose.north_m for pose in inside],
                linestyle="none",
                marker=".",
                markersize=4,
                color=drive.colour,
                label=drive.name if number < MOST_NAMES else f"_{drive.name}",
            )


def change(view: ChangeView, objects: Sequence[ChangedObject] = ()) -> Figure:
    """What changed between two moments: a colour for what became of each cell.

    With `objects` each is outlined in the colour of its kind, with its id, kind, area and
    confidence beside it; where one moved from has an arrow.
    """
    bounds = view.bounds
    width_in, height_in = size_of(bounds)
    figure = new_figure((width_in + 4.4, height_in + 1.4))
    axes = figure.add_subplot()
    colours = [palette.CHANGES[kind.name.lower()] for kind in Change]
    axes.imshow(
        view.change,
        origin="lower",
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=ListedColormap(colours),
        vmin=0,
        vmax=len(Change) - 1,
        interpolation="none",
        interpolation_stage="data",
        aspect="equal",
    )
    _mark_objects(axes, objects, bounds)
    name_axes(axes, f"{', '.join(view.after)} against {', '.join(view.before)}")
    add_scale_bar(axes, bounds.east_m - bounds.west_m)
    legend = [
        Patch(facecolor=colour, edgecolor="0.6", label=MEANING[kind])
        for kind, colour in zip(Change, colours, strict=True)
    ]
    legend += [
        Patch(
            facecolor="none",
            edgecolor=palette.CHANGED[kind],
            linewidth=2.0,
            label=f"object: {kind}",
        )
        for kind in dict.fromkeys(o.kind.value for o in objects)
    ]
    figure.legend(handles=legend, loc="outside right upper", fontsize="small")
    return figure


def _mark_objects(axes: Axes, objects: Sequence[ChangedObject], bounds: Bounds) -> None:
    half_m = 0.015 * max(bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m)
    for o in objects:
        colour = palette.CHANGED[o.kind.value]
        west_m, south_m, east_m, north_m = o.area.buffer(half_m).bounds
        axes.add_patch(
            Rectangle(
                (west_m, south_m), east_m - west_m, north_m - south_m,
                fill=False, edgecolor=colour, linewidth=1.8,
            )
        )  # fmt: skip
        if math.isfinite(o.from_east_m):
            axes.annotate(
                "", (o.east_m, o.north_m), (o.from_east_m, o.from_north_m),
                arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.8},
            )  # fmt: skip
        axes.annotate(
            f"{o.id} {o.kind.value} {o.area_m2:.2f} m², {o.confidence:.2f}",
            (east_m, north_m),
            xytext=(4, 2),
            textcoords="offset points",
            color=colour,
            fontsize="small",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )
