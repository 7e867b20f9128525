"""A figure's page: made without pyplot, and saved whole or not at all."""

from __future__ import annotations

from functools import partial
from io import BytesIO
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.errors import ConfigError
from fieldgrid.publish import mentions, replacing


def new_figure(size_in: tuple[float, float]) -> Figure:
    """A figure of a size in inches whose parts make room for each other."""
    figure = Figure(figsize=size_in, dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure, whole or not at all, in the format that the name ends in.

    An earlier figure of that name is replaced, but nothing else. Raises ConfigError for a name of
    no known format, MapExistsError for a file that is no figure, MapWriteError where it cannot be
    written.
    """
    path = Path(path)
    written = BytesIO()
    try:
        figure.savefig(written, format=path.suffix.lstrip(".").lower() or "png")
    except ValueError as error:
        raise ConfigError(
            f"{path} names no format that a figure can have; end it in .png, .pdf or .svg."
        ) from error
    # Every kind of figure names the library in its metadata; a photograph does not.
    with replacing(path, ours=partial(mentions, mark=b"atplotlib"), what="a figure") as draft:
        draft.write_bytes(written.getvalue())
