"""Where the channels of a window of cells come from: stored tiles, or frames folded anew; and those
of larger cells from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from fieldgrid.core import UInt64
from fieldgrid.geometry import Lattice, Window, tile_window
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.blocks import blocks_under, whole_blocks
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup, is_nothing, nothing
from fieldgrid.maps.layers.window import (
    WindowFold,
    at_cells,
    empty_cells,
    merge_sessions,
    with_overviews,
)
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.transfer import Transfer, footprint
from fieldgrid.maps.views.base_cells import Multiple, Resampling

FOR_KERNELS = ("weight", "sum")
"""Kernels take no channel that takes no memory."""


class CellSource(Protocol):
    """Gives the channels of windows of cells, those of overviews included; from any thread."""

    def merged(self, window: Window) -> Cells | None:
        """The sessions that were asked for together; None where they saw nothing."""


class StoredLevel:
    """The tiles over all sessions of a zoom level; `level` counts from the base, where alone
    derived groups follow from them."""

    def __init__(self, tables: TileTables, level: int, groups: Sequence[ChannelGroup]) -> None:
        self._tables, self._groups = tables, groups
        self._zoom, self._level = tables.matrices.base_zoom - level, level

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        found = []
        for tile in window.tiles():
            cells = self._tables.cells(self._zoom, tile)
            if cells is not None:
                if self._level == 0:
                    cells = with_overviews(self._groups, cells)
                found.append((tile_window(tile), cells))
        return assembled(window, found)


class FoldedFrames:
    """Frames folded anew: on any lattice, by any rule, from any frames."""

    def __init__(
        self,
        lattice: Lattice,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
        sessions: Sequence[tuple[str, Sequence[FrameRecord]]],
    ) -> None:
        self._lattice, self._transfer, self._groups = lattice, transfer, groups
        self._sessions = [
            (
                name,
                [
                    (frame, footprint(frame.spec, frame.pose, lattice))
                    for frame in sorted(frames, key=lambda frame: frame.pose.time_ns)
                ],
            )
            for name, frames in sessions
        ]

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        total: Cells | None = None
        for _, cells in self._folded(window):
            total = cells if total is None else merge_sessions(self._groups, total, cells)
        return None if total is None else with_overviews(self._groups, total)

    def by_session(self, window: Window) -> Iterator[tuple[str, Cells]]:
        """Each session that may have seen something, in the order in which they were given."""
        for name, cells in self._folded(window):
            yield name, with_overviews(self._groups, cells)

    def _folded(self, window: Window) -> Iterator[tuple[str, Cells]]:
        near = whole_blocks(window, self._lattice)
        for name, frames in self._sessions:
            inside = [frame for frame, place in frames if place.intersect(near) is not None]
            if inside:
                fold = WindowFold(self._lattice, window, self._transfer, self._groups)
                for frame in inside:
                    fold.add(frame.cells(), frame.pose)
                yield name, fold.cells()


class LargerCells:
    """Cells that follow from the map's own, which another source has."""

    def __init__(self, source: CellSource, by: Multiple | Resampling) -> None:
        self._source, self._by = source, by

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        found = self._source.merged(self._by.under(window))
        return None if found is None else self._by.larger(found, window)


class FoldedOverBase:
    """Frames folded anew into cells that are no whole multiple of the map's own, where maxima and
    overviews are those of the map's own cells: a new fold would blur what these tell apart."""

    def __init__(
        self, folded: CellSource, base: LargerCells, groups: Sequence[ChannelGroup]
    ) -> None:
        self._folded, self._base, self._groups = folded, base, groups

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        base = self._base.merged(window)
        if base is None:
            return None
        folded = self._folded.merged(window) or empty_cells(self._groups, window.shape)
        return Cells({**folded, **base}, base.base_cells)


def assembled(window: Window, parts: Iterable[tuple[Window, Cells]]) -> Cells | None:
    """The cells of a window from windows that it touches; None when there are none.

    What has one value for each block of a part has one for each cell here.
    """
    names: tuple[str, ...] = ()
    arrays, base_cells = dict[str, UInt64](), 1
    for whole, cells in parts:
        names, base_cells = tuple(cells), cells.base_cells
        part = whole.intersect(window)
        if part is None:
            continue
        place = window.slices_of(part)
        for name, values in cells.items():
            if is_nothing(values) and name not in FOR_KERNELS:
                continue
            if name not in arrays:
                arrays[name] = np.zeros(window.shape, dtype=np.uint64)
            side = whole.width // values.shape[1]
            under = blocks_under(whole, side).slices_of(blocks_under(part, side))
            arrays[name][place] = at_cells(values[under], part, side)
    if not names:
        return None
    return Cells({name: arrays.get(name, nothing(window.shape)) for name in names}, base_cells)
