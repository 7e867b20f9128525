"""A view of a map block by block, for what never needs all of it at once.

The blocks have the bits of `MapFile.read`, and are of one state of the map.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from fieldgrid.core import ConfigError, Runner, Threads
from fieldgrid.geometry import TILE_CELLS, Lattice, Window, aligned_parts
from fieldgrid.maps.views.read import Content, Request, read_view
from fieldgrid.maps.views.view import MapView
from fieldgrid.maps.writing.sharing import check_known

MAX_CELLS = 10_000_000_000
"""Cells that may be read in blocks: 25 square kilometres at 5 cm."""

ONE_BY_ONE = Threads(1)

_MOST = 8
"""Blocks that are under way or wait here: each takes up to 10 MB a byte of a cell."""

_ROWS, _COLUMNS = 4 * TILE_CELLS, 32 * TILE_CELLS


class MapBlocks(NamedTuple):
    """The cells that were asked for, and the views that cover those that were observed.

    The views come from the north to the south, and from the west to the east; each begins and
    ends where tiles do, or at the window's edge. There is none where nothing was observed or
    marked.
    """

    lattice: Lattice
    window: Window
    views: Iterator[MapView]


class _BlockReader:
    """Reads blocks of a view. Pickled it is where the map lies: each worker reads there."""

    def __init__(self, content: Content, request: Request) -> None:
        self._of = content, request

    def __reduce__(self) -> tuple[Any, ...]:
        return _arrived, self._of

    def __call__(self, window: Window) -> MapView | None:
        """The view of a block; None where nothing was observed or marked."""
        content, request = self._of
        view = read_view(content, request._replace(window=window))
        return view if view.observed.any() or view.is_marked else None


def _arrived(content: Content, request: Request) -> _BlockReader:
    check_known((), request.layers)
    # The cluster has a task for each of its threads.
    return _BlockReader(content, request._replace(jobs=1))


def blocks_of(content: Content, request: Request, run: Runner = ONE_BY_ONE) -> MapBlocks:
    """The view that is asked for in blocks; ConfigError when it has too many cells.

    Threads of this process work on one block after the other, those of the request; a cluster
    reads some blocks at a time.
    """
    window = request.window
    if window.width * window.height > MAX_CELLS:
        raise ConfigError(
            f"{window.width:.6g} x {window.height:.6g} cells of {request.lattice.cell_m} m are "
            f"over {MAX_CELLS / 1e9:.0f} thousand million; give smaller bounds or a larger cell."
        )
    views = run.in_order(_BlockReader(content, request), windows(window), most=_MOST)
    return MapBlocks(request.lattice, window, (view for view in views if view is not None))


def windows(whole: Window) -> list[Window]:
    """A window cut where tiles begin, the northern rows first."""
    return sorted(aligned_parts(whole, _ROWS, _COLUMNS), key=lambda part: -part.j0)
