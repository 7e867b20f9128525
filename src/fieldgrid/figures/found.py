"""Rows and what lies between them, drawn over a map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from fieldgrid.figures.page import outline_patch
from fieldgrid.lattice import Bounds
from fieldgrid.palette import FOUND
from fieldgrid.vectors import Feature

_ORDER = ("headland", "lane", "row", "gap", "obstacle")
"""Later ones lie on top; blocks are the rows and lanes that are drawn."""

_WIDTHS = {"lane": 1.2, "row": 1.6, "gap": 4.0}
_NAMED = {"lane": 0.4, "row": 0.0}
"""Kinds that have their names beside them: at which share of the length of their lines."""


def draw_found(axes: Axes, features: Sequence[Feature], bounds: Bounds) -> None:
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
                line = ":" if is_dotted else "-"
                axes.plot(*one.geometry.xy, linewidth=_WIDTHS[kind], linestyle=line, **style)
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
    # What leaves the part that is drawn does not widen it.
    axes.set(xlim=(bounds.west_m, bounds.east_m), ylim=(bounds.south_m, bounds.north_m))
