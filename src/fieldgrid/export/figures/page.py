"""A page to draw on: made without pyplot, to scale where it shows ground, saved whole or not."""

from __future__ import annotations

import math
import re
import warnings
from functools import partial
from io import BytesIO
from pathlib import Path as FilePath
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.text import Text
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from shapely.geometry.polygon import orient

from fieldgrid.core import ConfigError, mentions, printable, replacing
from fieldgrid.geometry import Bounds

_LONG_SIDE_IN, _SHORT_SIDE_IN = 9.0, 1.5
"""Of the ground drawn on a page of its own."""
_LAYOUTS = 3
_FORMATS = {"png", "pdf", "svg"}
_LONGEST_LINE = 60
"""Characters of a text, such as the name of a drive."""


def new_figure(size_in: tuple[float, float]) -> Figure:
    """A figure of a size in inches whose parts make room for each other."""
    figure = Figure(figsize=size_in, dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def is_wide(bounds: Bounds) -> bool:
    """Whether ground is over 2.5 times as wide as high, so that what explains it lies below it."""
    return bounds.east_m - bounds.west_m > 2.5 * (bounds.north_m - bounds.south_m)


def size_of(bounds: Bounds) -> tuple[float, float]:
    """Width and height in inches that ground of these bounds takes to fill its page."""
    width_m, height_m = bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m
    scale = _LONG_SIDE_IN / max(width_m, height_m)
    return max(width_m * scale, _SHORT_SIDE_IN), max(height_m * scale, _SHORT_SIDE_IN)


def name_axes(axes: Axes, title: str) -> None:
    """Metres along both axes, written in full, and a scale bar."""
    axes.set(xlabel="east (m)", ylabel="north (m)")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.set_title(title, wrap=True)


def add_scale_bar(axes: Axes, width_m: float) -> None:
    """A bar of 1, 2 or 5 times a power of ten metres, about a fifth of the width that is shown."""
    length_m = 10.0 ** math.floor(math.log10(width_m / 5.0))
    length_m *= next(k for k in (5.0, 2.0, 1.0) if k == 1.0 or k * length_m <= width_m / 4.0)
    axes.add_artist(
        AnchoredSizeBar(
            axes.transData,
            length_m,
            f"{length_m:g} m",
            "lower right",
            pad=0.4,
            sep=3,
            borderpad=0.6,
            size_vertical=width_m / 400.0,
            color="black",
        )
    )


def save(figure: Figure, path: str | FilePath) -> None:
    """Write a figure, whole or not at all, in the format that the name ends in.

    An earlier figure of that name is replaced, but nothing else. Raises ConfigError for a name of
    no known format, MapExistsError for a file that is no figure, MapWriteError where it cannot be
    written.
    """
    path = FilePath(path)
    suffix = path.suffix.lstrip(".").lower()
    if suffix not in _FORMATS:
        raise ConfigError(
            f"{path} names no format that a figure can have; end it in .png, .pdf or .svg."
        )
    for text in figure.findobj(Text):
        text.set_text("\n".join(map(_literal, text.get_text().split("\n"))))
    layout = figure.get_layout_engine()
    written = BytesIO()
    with warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box, which says as much.
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from")
        # Where ground keeps its shape, room on one side takes some on another, and after the single
        # time of a drawing labels are cut off at the edge.
        for _ in range(_LAYOUTS):
            if layout is not None:
                layout.execute(figure)
        figure.savefig(written, format=suffix)
    # Every kind of figure names the library in its metadata; a photograph does not.
    with replacing(path, ours=partial(mentions, mark=b"atplotlib"), what="a figure") as draft:
        draft.write_bytes(written.getvalue())


def _literal(text: str) -> str:
    """A line of text as a figure draws it: no formula between dollars, nothing unprintable, and no
    longer than leaves room for the ground."""
    text = text if len(text) <= _LONGEST_LINE else f"{text[:_LONGEST_LINE]}..."
    return re.sub(r"(?<!\\)\$", r"\\$", printable(text))  # a bare dollar begins a formula


def outline_patch(polygon: Any, *, color: str, **style: Any) -> PathPatch:
    """The outline of a polygon of shapely with its holes, to be added to axes."""
    # Holes run the other way round, or they would be hatched, too.
    area = orient(polygon)
    rings = (Path(ring.coords, closed=True) for ring in (area.exterior, *area.interiors))
    return PathPatch(Path.make_compound_path(*rings), fill=False, edgecolor=color, **style)
