"""Where the channels of a window of cells come from: stored tiles, or frames folded anew; and those
of larger cells from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce
from itertools import chain
from typing import Protocol

import numpy as np

from fieldgrid.core import UInt64, quoted
from fieldgrid.geometry import Lattice, Window, tile_window
from fieldgrid.maps.file.codec import decode_cells
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.blocks import whole_blocks
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup, nothing
from fieldgrid.maps.layers.window import FOR_KERNELS, WindowFold, assembled, with_overviews
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.transfer import Transfer, footprint
from fieldgrid.maps.views.base_cells import Multiple, Resampling


class CellSource(Protocol):
    """Gives the channels of windows of cells; from any thread. Where they are those of a view, it
    has the overviews, too."""

    def merged(self, window: Window) -> Cells | None:
        """The sessions that were asked for together; None where they saw nothing."""


class StoredLevel:
    """The tiles over all sessions of a zoom level; `level` counts from the base. Those of the base
    are without overviews."""

    def __init__(self, tables: TileTables, level: int) -> None:
        self._tables, self._zoom = tables, tables.matrices.base_zoom - level

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        found = ((tile_window(t), self._tables.cells(self._zoom, t)) for t in window.tiles())
        return assembled(self._tables.groups, window, found)


class FoldedFrames:
    """Frames folded anew: on any lattice, by any rule, from any frames; without overviews."""

    def __init__(
        self,
        lattice: Lattice,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
        sessions: Sequence[tuple[str, Sequence[FrameRecord]]],
    ) -> None:
        self._lattice, self._transfer, self._groups = lattice, transfer, groups
        of_groups = (name for group in groups for name in group.frame)
        self._channels = {"density", "observed", *of_groups}
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
        drives = [frames for _, frames in self._sessions]
        if all(group.of_frames or group.derived for group in self._groups):
            drives = [list(chain.from_iterable(drives))]
        near, parts = whole_blocks(window, self._lattice), []
        for frames in drives:
            places = [place for _, place in frames if place.intersect(near) is not None]
            if places:
                reached = whole_blocks(reduce(Window.union, places), self._lattice)
                part = reached.intersect(window)
                assert part is not None
                parts.append((part, frames))
        found = ((part, self._folded(part, frames)) for part, frames in parts)
        return assembled(self._groups, window, found)

    def by_session(self, window: Window) -> Iterator[tuple[str, Cells]]:
        """Each session that may have seen something, in the order in which they were given; with
        overviews."""
        for name, frames in self._sessions:
            cells = self._folded(window, frames)
            if cells is not None:
                yield name, with_overviews(self._groups, cells)

    def _folded(self, window: Window, frames: Sequence[tuple[FrameRecord, Window]]) -> Cells | None:
        """The cells of frames; None where none of them reaches."""
        near = whole_blocks(window, self._lattice)
        inside = [frame for frame, place in frames if place.intersect(near) is not None]
        if not inside:
            return None
        fold = WindowFold(self._lattice, window, self._transfer, self._groups)
        for frame in inside:
            needed = [one for one in frame.load() if one.name in self._channels]
            cells = decode_cells(frame.spec, needed, f"grid of frame {quoted(frame.frame_id)}")
            fold.add(cells, frame.pose)
        return fold.cells()


class Together:
    """The channels of several sources, of the same cells; of those that two have, the first one's,
    which also says where anything was seen. With `overviews` all follow from what there is then."""

    def __init__(
        self,
        sources: Sequence[CellSource],
        groups: Sequence[ChannelGroup],
        *,
        overviews: bool = True,
    ) -> None:
        self._sources, self._groups, self._overviews = sources, groups, overviews

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        first, *others = (source.merged(window) for source in self._sources)
        if first is None:
            return None
        arrays = dict[str, UInt64]()
        for cells in (*others, first):
            arrays.update(cells or {})
        for name in (channel.name for group in self._groups for channel in group.channels):
            if name not in arrays:
                is_held = name in FOR_KERNELS
                arrays[name] = (
                    np.zeros(window.shape, np.uint64) if is_held else nothing(window.shape)
                )
        found = Cells(arrays, first.base_cells)
        return with_overviews(self._groups, found) if self._overviews else found


class LargerCells:
    """Cells that follow from the map's own, which another source has."""

    def __init__(self, source: CellSource, by: Multiple | Resampling) -> None:
        self._source, self._by = source, by

    def merged(self, window: Window) -> Cells | None:
        """See `CellSource`."""
        found = self._source.merged(self._by.under(window))
        return None if found is None else self._by.larger(found, window)
