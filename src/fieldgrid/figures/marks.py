"""What people said of places, drawn over a map."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fieldgrid import palette
from fieldgrid.figures.page import outline_patch
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import Mark, MarkKind

SAYS = {
    MarkKind.KEEPOUT: "keep out",
    MarkKind.FREE: "said to be free",
    MarkKind.OBSTACLE: "said to be an obstacle",
    MarkKind.PLACE: "place",
}
_HATCH = {MarkKind.KEEPOUT: "///", MarkKind.OBSTACLE: "xx"}


def draw_marks(axes: Axes, marks: Sequence[Mark], bounds: Bounds) -> None:
    """Draw the marks that lie within bounds, with their names and a legend of their kinds."""
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
            hatch = _HATCH.get(mark.kind)
            axes.add_patch(outline_patch(mark.geometry, color=colour, linewidth=1.8, hatch=hatch))
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
    handles = [
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
        # A mark that leaves the part that is drawn does not widen it.
        axes.set(xlim=(bounds.west_m, bounds.east_m), ylim=(bounds.south_m, bounds.north_m))
