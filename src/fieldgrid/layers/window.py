"""Folding a session's frames over a window of cells, and what cells become: merged, larger."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from fieldgrid.array_types import Int32, UInt64
from fieldgrid.kernel import kernel
from fieldgrid.lattice import Lattice, Window
from fieldgrid.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Combine,
    OverviewChannel,
    is_nothing,
    nothing,
)
from fieldgrid.layers.frame import FrameCells, FrameInPlace
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import Landing, Transfer, land


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
        self._lattice, self._window, self._transfer = lattice, window, transfer
        self._groups = groups
        size = window.width * window.height
        self._folds = {
            group.name: group.fold(size, lattice) for group in groups if group.fold is not None
        }
        self._stamps: Int32 | None = None  # some groups do without the cells that a frame touched
        self._done: dict[str, UInt64] = {}
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
            self._stamps = np.zeros(self._window.width * self._window.height, np.int32)
        touched = np.empty(min(landing.cell.size, self._stamps.size), dtype=np.int32)
        return touched[: touch(landing.cell, self._frames, self._stamps, touched)]

    def cells(self, part: Window | None = None) -> Cells:
        """The channels of the window, or of a part of it; no frame follows."""
        if self._folds:
            shape = (-1, *self._window.shape)
            self._done = {name: f.channels().reshape(shape) for name, f in self._folds.items()}
            self._folds = {}
        inside = (slice(None), *self._window.slices_of(part or self._window))
        arrays: dict[str, UInt64] = {}
        for group in self._groups:
            if group.derived:
                continue
            if group.of_session is None:
                channels = self._done[group.name][inside]
            else:
                channels = group.of_session(Cells(arrays))
            for one, values in zip(group.channels, channels, strict=True):
                if group is self._groups[0]:  # that kernels take
                    arrays[one.name] = np.ascontiguousarray(values)
                else:
                    arrays[one.name] = _own(values)
        return Cells(arrays)


def _own(values: UInt64) -> UInt64:
    """A part of a channel as an array of its own, which does without the others' memory."""
    if is_nothing(values) or not values.any():
        return nothing(values.shape)
    return np.ascontiguousarray(values)


@kernel
def touch(cell, number, stamps, touched):  # type: ignore[no-untyped-def]
    """Fill `touched` with each cell of a landing once; returns how many there are."""
    count = 0
    for r in range(cell.shape[0]):
        for c in range(cell.shape[1]):
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
        {c.name: combined(c.sessions, a[c.name], b[c.name]) for c in channels}, a.base_cells
    )


def combined(how: Combine, a: UInt64, b: UInt64) -> UInt64:
    """Two values of a channel as one; it may be one of those that are given."""
    if is_nothing(a) or is_nothing(b):
        return b if is_nothing(a) else a
    return np.maximum(a, b) if how is Combine.MAX else a + b


def with_overviews(groups: Iterable[ChannelGroup], cells: Cells) -> Cells:
    """Base cells with the channels that are stored only of larger ones."""
    made = {extra.name: extra.of_base(cells) for group in groups for extra in group.overview}
    return Cells({**cells, **made}, cells.base_cells)


def coarser(groups: Iterable[ChannelGroup], cells: Cells, factor: int) -> Cells:
    """Cells of `factor` times the side, from cells that have the channels of overviews.

    The window's sides are multiples of the factor.
    """
    if factor == 1:
        return cells
    arrays: dict[str, UInt64] = {}
    for group in groups:
        channels: tuple[Channel | OverviewChannel, ...] = (*group.channels, *group.overview)
        for channel in channels:
            fine = cells[channel.name]
            shape = fine.shape[0] // factor, fine.shape[1] // factor
            if is_nothing(fine):
                arrays[channel.name] = nothing(shape)
                continue
            arrays[channel.name] = np.zeros(shape, np.uint64)
            gather(fine, factor, channel.coarser is Combine.MAX, arrays[channel.name])
    return Cells(arrays, cells.base_cells * factor * factor)


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


def empty_cells(groups: Iterable[ChannelGroup], shape: tuple[int, int]) -> Cells:
    """Cells that no frame has seen."""
    return Cells(
        {channel.name: np.zeros(shape, np.uint64) for g in groups for channel in g.channels}
    )
