"""Folding a session's frames over a window of cells, and what cells become: merged, larger."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from fieldgrid.core import Int32, UInt64, kernel
from fieldgrid.geometry import Lattice, Pose, Window
from fieldgrid.maps.layers.blocks import block_side, blocks_under, whole_blocks
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Combine,
    OverviewChannel,
    has_any,
    is_nothing,
    nothing,
)
from fieldgrid.maps.layers.frame import FrameCells, FrameInPlace
from fieldgrid.maps.transfer import Landing, Transfer, land

FOR_KERNELS = ("weight", "sum")
"""Kernels take no channel that takes no memory."""


class WindowFold:
    """The frames of one session over a window: all that groups accumulate of them.

    The density comes first among `groups`.
    """

    def __init__(
        self,
        lattice: Lattice,
        window: Window,
        transfer: Transfer,
        groups: Sequence[ChannelGroup],
    ) -> None:
        self._lattice, self._asked, self._transfer = lattice, window, transfer
        self._groups = groups
        self._side = block_side(lattice)
        self._under = blocks_under(window, self._side)
        # Whether a frame saw anything of a block is known where all of it is.
        self._window = whole_blocks(window, lattice)
        # What a group has values of: the cells of the window, or the blocks under it.
        self._units = {g.name: self._under if g.blocks else self._window for g in groups}
        self._folds = {
            group.name: group.fold(math.prod(self._units[group.name].shape), lattice)
            for group in groups
            if group.fold is not None
        }
        self._stamps: Int32 | None = None  # some groups do without the cells that a frame touched
        self._done: dict[str, list[UInt64]] = {}
        self._frames = 0

    def add(self, cells: FrameCells, pose: Pose) -> None:
        """Carry one frame into the window; what falls outside is left out.

        Frames come in the order of their time, those of one time in any.
        """
        self._frames += 1
        landing = land(cells.grid, pose, self._lattice, self._window, self._transfer)
        frame = FrameInPlace(cells, pose, self._lattice, self._window, landing, self._touched)
        for fold in self._folds.values():
            fold.add(frame)

    def _touched(self, landing: Landing) -> Int32:
        """The cells that the latest frame landed in, each once."""
        if self._stamps is None:
            self._stamps = np.zeros(math.prod(self._window.shape), np.int32)
        touched = np.empty(min(landing.cell.size, self._stamps.size), dtype=np.int32)
        return touched[: touch(landing.cell, landing.spans, self._frames, self._stamps, touched)]

    def cells(self, part: Window | None = None, *, whole_blocks: bool = False) -> Cells:
        """The channels of the window, or of another that it touches, which are 0 outside of this
        one; no frame follows.

        Where the part has `whole_blocks`, groups with blocks give one value for each.
        """
        if self._folds:
            self._finish()
        if part is not None and self._window.union(part) != self._window:
            common = self._window.intersect(part)
            assert common is not None
            cells = self.cells(common, whole_blocks=whole_blocks)
            found = assembled(self._groups, part, [(common, cells)], whole_blocks=whole_blocks)
            assert found is not None
            return found
        inside, arrays = part or self._asked, dict[str, UInt64]()
        for group in self._groups:
            if group.derived:
                continue
            channels: Iterable[UInt64] = (
                self._channels(group, inside, whole_blocks)
                if group.of_session is None
                else group.of_session(Cells(arrays))
            )
            for one, values in zip(group.channels, channels, strict=True):
                # An array of its own, which does without the others' memory; kernels take the
                # first ones.
                is_held = group is self._groups[0] or has_any(values)
                arrays[one.name] = (
                    np.ascontiguousarray(values) if is_held else nothing(values.shape)
                )
        return Cells(arrays, block=self._side if whole_blocks else 1)

    def _finish(self) -> None:
        """Take the channels from the folds: nothing of blocks in which no cell was observed."""
        folds, self._folds = self._folds, {}
        seen = np.empty(0, np.bool_)
        for group in self._groups:
            if group.name not in folds:
                continue
            made = folds.pop(group.name).channels()
            channels = [one.reshape(self._units[group.name].shape) for one in made]
            if group is self._groups[0] and any(other.blocks for other in self._groups):
                side, (height, width) = self._side, self._under.shape
                weighty = (channels[0] > 0).reshape(height, side, width, side)
                seen = np.logical_or.reduce(weighty, axis=(1, 3))
            elif group.blocks:
                channels = [one if is_nothing(one) else one * seen for one in channels]
            self._done[group.name] = channels

    def _channels(self, group: ChannelGroup, part: Window, whole_blocks: bool) -> Iterable[UInt64]:
        """The channels of a group that was folded, in a part of the window."""
        done = self._done[group.name]
        if all(is_nothing(values) for values in done):
            units = blocks_under(part, self._side) if group.blocks and whole_blocks else part
            return [nothing(units.shape)] * len(group.channels)
        if group.blocks:
            under = self._under.slices_of(blocks_under(part, self._side))
            found = [
                values[under] if whole_blocks else at_cells(values[under], part, self._side)
                for values in done
            ]
        else:
            found = [values[self._window.slices_of(part)] for values in done]
        return found if group.unfold is None else group.unfold(found)


def at_cells(values: UInt64, window: Window, side: int) -> UInt64:
    """The values of the blocks under a window at its cells, [rows, columns]."""
    if side == 1:
        return values
    if is_nothing(values):
        return nothing(window.shape)
    under = blocks_under(window, side)
    rows, columns = (
        (first + np.arange(size)) // side - start
        for first, size, start in (
            (window.j0, window.height, under.j0),
            (window.i0, window.width, under.i0),
        )
    )
    return values[rows][:, columns]


@kernel
def touch(cell, spans, number, stamps, touched):  # type: ignore[no-untyped-def]
    """Fill `touched` with each cell of a landing once; returns how many there are."""
    count = 0
    for r in range(cell.shape[0]):
        for c in range(spans[r, 0], spans[r, 1]):
            k = cell[r, c]
            if k >= 0 and stamps[np.uint32(k)] != number:
                stamps[np.uint32(k)] = number
                touched[count] = k
                count += 1
    return count


def merge_sessions(groups: Iterable[ChannelGroup], a: Cells, b: Cells) -> Cells:
    """What two sessions, or two sets of them, have in the same cells together."""
    channels = (channel for group in groups for channel in group.channels)
    return Cells(
        {c.name: combined(c.sessions, a[c.name], b[c.name]) for c in channels},
        a.base_cells,
        a.block,
    )


def combined(how: Combine, a: UInt64, b: UInt64) -> UInt64:
    """Two values of a channel as one; it may be one of those that are given."""
    if is_nothing(a) or is_nothing(b):
        return b if is_nothing(a) else a
    return np.maximum(a, b) if how is Combine.MAX else a + b


def assembled(
    groups: Iterable[ChannelGroup],
    window: Window,
    parts: Iterable[tuple[Window, Cells | None]],
    *,
    whole_blocks: bool = False,
) -> Cells | None:
    """The cells of a window from windows that it touches, as sessions meet in them; None when there
    are none.

    What has one value for each block of a part has one for each cell here, unless both consist of
    `whole_blocks` and are to keep them.
    """
    highest = {
        channel.name
        for group in groups
        for channel in group.channels
        if channel.sessions is Combine.MAX
    }
    arrays, shapes = dict[str, UInt64](), dict[str, tuple[int, int]]()
    base_cells = block = 1
    for whole, cells in parts:
        part = whole.intersect(window)
        if cells is None or part is None:
            continue
        base_cells, block = cells.base_cells, cells.block if whole_blocks else 1
        for name, values in cells.items():
            side = whole.width // values.shape[1]
            under = blocks_under(window, side if whole_blocks else 1)
            shapes[name] = under.shape
            if is_nothing(values) and name not in FOR_KERNELS:
                continue
            is_all = whole == window and values.shape == under.shape and values.flags.writeable
            # An overview may be the array of a channel: to each is added apart.
            if name not in arrays and is_all and not any(values is one for one in arrays.values()):
                arrays[name] = values
                continue
            if name not in arrays:
                arrays[name] = np.zeros(under.shape, np.uint64)
            touched = blocks_under(part, side)
            found = values[blocks_under(whole, side).slices_of(touched)]
            if whole_blocks:
                inside = arrays[name][under.slices_of(touched)]
            else:
                inside, found = arrays[name][under.slices_of(part)], at_cells(found, part, side)
            (np.maximum if name in highest else np.add)(inside, found, out=inside)
    if not shapes:
        return None
    whole_arrays = {name: arrays.get(name, nothing(shape)) for name, shape in shapes.items()}
    return Cells(whole_arrays, base_cells, block)


def with_overviews(groups: Iterable[ChannelGroup], cells: Cells) -> Cells:
    """Base cells with the channels that are stored only of larger ones."""
    made: dict[str, UInt64] = {}
    for group in groups:
        together = [extra.name for extra in group.overview if extra.of_base is None]
        if group.overview_of_base is not None:
            made.update(zip(together, group.overview_of_base(cells), strict=True))
        for extra in group.overview:
            if extra.of_base is not None:
                made[extra.name] = extra.of_base(cells)
    return Cells({**cells, **made}, cells.base_cells, cells.block)


def coarser(groups: Iterable[ChannelGroup], cells: Cells, factor: int) -> Cells:
    """Cells of `factor` times the side, from cells that have the channels of overviews.

    The window's sides are multiples of the factor. Blocks that are no smaller than the new cells
    stay as they are; `factor` is a power of 2 where cells have blocks.
    """
    if factor == 1:
        return cells
    arrays: dict[str, UInt64] = {}
    for group in groups:
        of = max(factor // cells.block, 1) if group.blocks else factor
        channels: tuple[Channel | OverviewChannel, ...] = (*group.channels, *group.overview)
        for channel in channels:
            if channel.coarser is Combine.ABSENT:
                continue
            fine = cells[channel.name]
            shape = fine.shape[0] // of, fine.shape[1] // of
            if is_nothing(fine):
                arrays[channel.name] = nothing(shape)
                continue
            arrays[channel.name] = np.zeros(shape, np.uint64)
            gather(fine, of, channel.coarser is Combine.MAX, arrays[channel.name])
    return Cells(arrays, cells.base_cells * factor * factor, max(cells.block // factor, 1))


@kernel
def gather(fine, factor, highest, coarse):  # type: ignore[no-untyped-def]
    """Fill coarse [h, w], which is 0 before, with the sums, or the highest, of `factor` x `factor`
    values of fine [h · factor, w · factor]."""
    for j in range(coarse.shape[0] * factor):
        for i in range(coarse.shape[1]):
            total = coarse[j // factor, i]
            for k in range(factor):
                value = fine[j, i * factor + k]
                total = max(total, value) if highest else total + value
            coarse[j // factor, i] = total


def empty_cells(groups: Iterable[ChannelGroup], shape: tuple[int, int], block: int = 1) -> Cells:
    """Cells that no frame has seen; `block` is a number of cells along the side of a block."""
    arrays: dict[str, UInt64] = {}
    for group in groups:
        side = block if group.blocks else 1
        for channel in group.channels:
            arrays[channel.name] = np.zeros((shape[0] // side, shape[1] // side), np.uint64)
    return Cells(arrays, block=block)
