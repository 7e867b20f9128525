"""Rows and what lies between them, drawn over a map."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from shapely.geometry.polygon import orient

from fieldgrid.lattice import Bounds
from fieldgrid.palette import FOUND
from fieldgrid.vectors import Feature

_ORDER = ("headland", "lane", "row", "gap", "obstacle")
"""Later ones lie on top; blocks are the rows and lanes that are drawn."""

_WIDTHS = {"lane": 1.2, "row": 1.6, "gap": 4.0}
_NAMED = {"lane": 0.4, "row": 0.0}
"""Kinds that have their names beside them, so far along their lines."""


def draw_found(axes: Axes, features: Sequence[Feature], bounds: Bounds) -> None:
    """Draw the rows, lanes, gaps, headlands and obstacles of a map, rows and lanes with their
    names; a lane that was not driven is dotted. The first of each kind has a label for a legend.
    """
    told = set[str]()
    for kind in _ORDER:
        for one in (feature for feature in features if feature.kind == kind):
            name = "lane, not driven" if _is_dotted(one) else kind
            label = None if name in told else name
            told.add(name)
            if kind in _WIDTHS:
                _draw_line(axes, one, label)
            else:
                _draw_area(axes, one, label)
    # What leaves the part that is drawn does not widen it.
    axes.set_xlim(bounds.west_m, bounds.east_m)
    axes.set_ylim(bounds.south_m, bounds.north_m)


def _is_dotted(one: Feature) -> bool:
    return one.kind == "lane" and not one.properties["driven"]


def _draw_line(axes: Axes, one: Feature, label: str | None) -> None:
    colour = FOUND[one.kind]
    axes.plot(
        *one.geometry.xy,
        color=colour,
        linewidth=_WIDTHS[one.kind],
        linestyle=":" if _is_dotted(one) else "-",
        label=label,
    )
    if one.kind in _NAMED:
        place = one.geometry.interpolate(_NAMED[one.kind], normalized=True).coords[0]
        axes.annotate(
            str(one.properties["id"]),
            place,
            fontsize=7,
            color=colour,
            annotation_clip=True,
            bbox={"facecolor": "white", "alpha": 0.7, "pad": 0.8, "linewidth": 0.0},
        )


def _draw_area(axes: Axes, one: Feature, label: str | None) -> None:
    # Holes run the other way round, or they would be filled, too.
    area = orient(one.geometry)
    rings = (Path(ring.coords, closed=True) for ring in (area.exterior, *area.interiors))
    axes.add_patch(
        PathPatch(
            Path.make_compound_path(*rings),
            fill=False,
            edgecolor=FOUND[one.kind],
            # A tint would look like a value of the cells below it.
            hatch="//" if one.kind == "headland" else None,
            linewidth=1.2,
            label=label,
        )
    )
