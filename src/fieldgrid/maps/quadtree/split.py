"""Cells of a window into squares: from small to large what they hold, from large to small which
of them stay whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, Bool, Float32, UInt8
from fieldgrid.geometry import Window, squares
from fieldgrid.maps.cost import LETHAL, UNKNOWN_COST
from fieldgrid.maps.quadtree.rule import Rule, close_cells, whole_squares
from fieldgrid.maps.views.view import MapView

_CHUNK_CELLS = 1024
"""Cells along the side of what is worked on at a time: a multiple of the largest square."""

_NONE = np.uint8(255)
"""The lowest of no values."""


class State(IntEnum):
    """What the known cells of a square count as for a planner; `UNSEEN` where none is known."""

    UNSEEN = 0
    FREE = 1
    DOUBT = 2
    OBSTACLE = 3


class Squares(NamedTuple):
    """Squares [n] of a lattice. Each has a side of 2^`level` cells, and begins in the south-west at
    the cell `column`, `row`.

    `mean`, `lowest` and `highest` are densities of its observed cells (0..255; NaN, 0 and 0 where
    there are none), `seen_share` is the share of it that is known to a planner (0..1), `state` what
    that counts as, a `State`.
    """

    level: UInt8
    row: npt.NDArray[np.int32]
    column: npt.NDArray[np.int32]
    mean: Float32
    lowest: UInt8
    highest: UInt8
    seen_share: Float32
    state: UInt8


class _SquareStats(NamedTuple):
    """What all squares of one side hold, arrays [rows, columns]: observed cells, the sum of their
    densities, the lowest (255 for none) and the highest, the sum of the shares that were seen, the
    least state of known cells (255 for none) and the highest, and whether a cell is to stand alone.
    """

    observed: npt.NDArray[np.uint32]
    total: npt.NDArray[np.uint32]
    lowest: UInt8
    highest: UInt8
    seen: Float32
    least: UInt8
    most: UInt8
    alone: Bool

    def doubled(self) -> _SquareStats:
        """What the squares of twice the side hold."""
        return _SquareStats(
            _halved(self.observed, np.add),
            _halved(self.total, np.add),
            _halved(self.lowest, np.minimum),
            _halved(self.highest, np.maximum),
            _halved(self.seen, np.add),
            _halved(self.least, np.minimum),
            _halved(self.most, np.maximum),
            _halved(self.alone, np.logical_or),
        )

    def within(self, shape: tuple[int, int], place: tuple[slice, slice]) -> _SquareStats:
        """What the squares of a larger window hold, which is nothing outside of these squares."""
        if self.observed.shape == shape:
            return self
        wide = _SquareStats._make(np.zeros(shape, one.dtype) for one in self)
        wide.lowest[:] = wide.least[:] = _NONE
        for name in self._fields:
            getattr(wide, name)[place] = getattr(self, name)
        return wide

    @property
    def mean(self) -> Float32:
        """The mean density of the observed cells; NaN where there is none."""
        mean = self.total / np.maximum(self.observed, 1)
        return np.where(self.observed > 0, mean, np.nan).astype(np.float32)

    @property
    def known(self) -> Bool:
        """Where there is anything to tell."""
        return np.asarray((self.observed > 0) | (self.most > State.UNSEEN))

    def whole(self, rule: Rule, cells: int) -> Bool:
        """Which squares, of `cells` cells each, lose no more density than the rule allows."""
        # Judged by the very mean that is kept, so that the bound holds exactly.
        mean = self.mean.astype(np.float64)
        near = (self.highest - mean <= rule.loss) & (mean - self.lowest <= rule.loss)
        alike = (self.least == self.most) & (self.seen >= rule.least_seen * cells)
        return np.asarray(
            (near | (self.observed == 0)) & (alike | (self.most == State.UNSEEN)) & ~self.alone
        )


def _halved(fine: AnyArray, join: Callable[[AnyArray, AnyArray], AnyArray]) -> AnyArray:
    """Each four values as one, an array of half as many rows and columns."""
    rows = join(fine[0::2], fine[1::2])
    return join(rows[:, 0::2], rows[:, 1::2])


def squares_of(view: MapView, rule: Rule, layer: str) -> Iterator[Squares]:
    """The squares of a view, part by part; what lies outside of it counts as unseen."""
    decided = view.decision(rule.curve.least_drop_m)
    density = view.layer(layer)
    for chunk in squares(whole_squares(view.window, rule.levels[-1]), _CHUNK_CELLS):
        part = chunk.intersect(view.window)
        if part is None:
            continue
        place = view.window.slices_of(part)
        seen = np.nan_to_num(decided.seen[place])
        keepout = None
        if decided.keepout is not None:
            keepout = decided.keepout[place]
            seen[keepout] = 1.0  # what it is there is known, whoever saw it
        cost = rule.curve.cost(decided.worst[place], decided.seen[place], keepout)
        seen[cost == UNKNOWN_COST] = 0.0  # a larger cell may be seen in part and still be unseen
        observed = view.observed[place]
        if not observed.any() and (cost == UNKNOWN_COST).all():
            continue
        # The cells of the part as squares of level 0.
        state = np.full(cost.shape, State.DOUBT, dtype=np.uint8)
        for value, means in (
            (0, State.FREE), (LETHAL, State.OBSTACLE), (UNKNOWN_COST, State.UNSEEN),
        ):  # fmt: skip
            state[cost == value] = means
        highest = np.where(observed, density[place], np.uint8(0))
        cells = _SquareStats(
            observed.astype(np.uint32),
            highest.astype(np.uint32),
            np.where(observed, density[place], _NONE),
            highest,
            seen.astype(np.float32),
            np.where(state > State.UNSEEN, state, _NONE),
            state,
            np.zeros(cost.shape, dtype=np.bool_),
        )
        if rule.near is not None:
            cells = cells._replace(alone=close_cells(rule.near, view.lattice, part))
        yield _split(cells.within(chunk.shape, chunk.slices_of(part)), rule, chunk)


def _split(cells: _SquareStats, rule: Rule, window: Window) -> Squares:
    """The squares of a window: the largest that may stay whole, and in the rest smaller ones."""
    levels = [cells]
    for _ in range(rule.levels[-1]):
        levels.append(levels[-1].doubled())
    found = []
    covered = np.zeros(levels[-1].observed.shape, dtype=np.bool_)
    for level in range(rule.levels[-1], -1, -1):
        if level in rule.levels:
            one = levels[level]
            whole = one.whole(rule, 1 << 2 * level) if level else np.ones_like(covered)
            taken = whole & one.known & ~covered
            j, i = np.nonzero(taken)
            found.append(
                Squares(
                    np.full(len(j), level, dtype=np.uint8),
                    ((j << level) + window.j0).astype(np.int32),
                    ((i << level) + window.i0).astype(np.int32),
                    one.mean[taken],
                    np.where(one.observed[taken] > 0, one.lowest[taken], np.uint8(0)),
                    one.highest[taken],
                    one.seen[taken] / np.float32(1 << 2 * level),
                    one.most[taken],
                )
            )
            covered |= whole
        if level:
            covered = covered.repeat(2, axis=0).repeat(2, axis=1)
    return joined(found)


def joined(parts: Sequence[Squares]) -> Squares:
    """The squares of all parts."""
    return Squares._make(map(np.concatenate, zip(_EMPTY, *parts, strict=True)))


_EMPTY = Squares._make(
    np.zeros(0, dtype) for dtype in ("u1", "i4", "i4", "f4", "u1", "u1", "f4", "u1")
)
