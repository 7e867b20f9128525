"""A view of a map block by block, for what never needs all of it at once.

The blocks have the bits of `MapFile.read`, and are of one state of the map.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from fieldgrid.core import ConfigError, Runner
from fieldgrid.geometry import TILE_CELLS, Lattice, Window, aligned_parts
from fieldgrid.maps.views.deciding import read_views
from fieldgrid.maps.views.read import Content, Request, with_levels
from fieldgrid.maps.views.view import MapView
from fieldgrid.maps.writing.sharing import check_known

MAX_CELLS = 10_000_000_000
"""Cells that may be read in blocks: 25 square kilometres at 5 cm."""

_MOST = 8
"""Blocks that are under way or wait here: each takes up to 10 MB a byte of a cell."""

_ROWS, _COLUMNS = 4 * TILE_CELLS, 32 * TILE_CELLS


class MapBlocks(NamedTuple):
    """The cells that were asked for, and the views that cover those that were observed.

    The views come from the north to the south, and from the west to the east; each begins and
    ends where tiles do, or at the window's edge. There is none where nothing was observed or
    marked. Behind each come its overviews, of `levels`: cells of 2, 4, ... times the side.
    """

    lattice: Lattice
    window: Window
    views: Iterator[MapView]
    levels: Mapping[Lattice, Window] = MappingProxyType({})


def _block_views(content: Content, request: Request, window: Window) -> list[MapView]:
    """The view of a block, and its overviews; none where nothing was observed or marked."""
    check_known((), request.layers)  # a worker of a cluster may not know a layer
    views = read_views(content, request._replace(window=window))
    return views if views[0].observed.any() or views[0].is_marked else []


@contextmanager
def blocks_of(
    content: Content, request: Request, run: Runner, smallest_px: int | None = None
) -> Iterator[MapBlocks]:
    """The view that is asked for in blocks; ConfigError when it has too many cells.

    Threads of this process work on one block after the other, those of the request, and none any
    more when the context is left; a cluster reads some blocks at a time. With `smallest_px` there
    are overviews, until the longer side of one has at most so many cells, and the window is grown
    to whole cells of the last one.
    """
    if smallest_px is not None:
        request = with_levels(request, content.header.lattice, smallest_px)
    window = request.window
    if window.width * window.height > MAX_CELLS:
        raise ConfigError(
            f"{window.width:.6g} x {window.height:.6g} cells of {request.lattice.cell_m} m are "
            f"over {MAX_CELLS / 1e9:.0f} thousand million; give smaller bounds or a larger cell."
        )
    read = partial(_block_views, content, request)
    northern_first = sorted(aligned_parts(window, _ROWS, _COLUMNS), key=lambda part: -part.j0)
    blocks = (view for block in run.in_order(read, northern_first, most=_MOST) for view in block)
    larger = map(request.at_level, range(1, request.levels + 1))
    levels = {one.lattice: one.window for one in larger}
    with closing(blocks) as views:
        yield MapBlocks(request.lattice, window, views, levels)
