"""The relief of the ground about a cell, as frames saw it: how rough it is, and its steps.

Both are differences of heights within one frame, so that what frames have in common, and what the
heights of their poses are off, plays no part. Both are kept for blocks of cells, and each session
has one voice: the mean roughness of its frames, and a step where half of those that could tell saw
one. Roughness is the residual of the plane through nine
heights half a metre apart; steps come with the frames (`find_edges`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fieldgrid.core import AnyArray, Int64, UInt64, kernel, palette
from fieldgrid.geometry import (
    GROUND_CHANNEL,
    NO_GROUND_CM,
    NO_STEP_KNOWN,
    STEP_CHANNEL,
    GridSpec,
    Lattice,
)
from fieldgrid.maps.layers.blocks import COLUMN_BITS, session_means
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    OverviewChannel,
    nothing,
)
from fieldgrid.maps.layers.frame import FrameInPlace

REACH_M = 0.5
"""The plane of a place goes through the heights so far beside, before and behind it."""

BLOCK_M = 0.2
"""Roughness is found once for each block of this size, as which frames keep heights."""

LEAST_STEP_CM = 10
"""Lower steps are noise."""

STEP_VOTES = 2
"""There is a step where one of `STEP_VOTES` frames of a session that could tell saw one, and where
one of `STEP_VOTES` sessions did."""

_PER_M = 500
"""Roughness is summed in steps of 2 mm."""

_UNKNOWN = -1


class _Relief:
    """Five sums over the points of blocks: how many have a roughness, and theirs; how many tell of
    steps, at how many there is one, and the steps' centimetres."""

    def __init__(self, blocks: int, _: Lattice) -> None:
        self._blocks = blocks
        self._sums: Int64 | None = None  # before the first frame that tells any

    def add(self, frame: FrameInPlace) -> None:
        heights_cm, steps_cm = (
            frame.cells.channels.get(name) for name in (GROUND_CHANNEL, STEP_CHANNEL)
        )
        if heights_cm is None and steps_cm is None:
            return
        if self._sums is None:
            self._sums = np.zeros((self._blocks, 5), dtype=np.int64)
        spec = frame.cells.grid.spec
        side = max(round(BLOCK_M / spec.cell_m), 1)
        if steps_cm is None:
            steps_cm = np.full(spec.shape, NO_STEP_KNOWN, np.uint8)
        add_relief(
            roughness(heights_cm, spec, side),
            side,
            np.ascontiguousarray(steps_cm, dtype=np.uint8),
            *frame.in_blocks,
            self._sums,
        )

    def channels(self) -> Sequence[UInt64]:
        if self._sums is None:
            return [nothing((self._blocks,))] * len(GROUP.channels)
        rough_parts, rough, step_parts, steps, cm = self._sums.T
        voted = (steps > 0) & (steps * STEP_VOTES >= step_parts)
        said = (
            (rough_parts > 0).astype(np.int64),
            session_means(rough, rough_parts),
            (step_parts > 0).astype(np.int64),
            voted.astype(np.int64),
            np.where(voted, session_means(cm, steps), 0),
        )
        return [one.view(np.uint64) for one in said]


def roughness(heights_cm: AnyArray | None, spec: GridSpec, block: int) -> Int64:
    """The roughness of each block of `block` x `block` cells of a local grid, in units of the
    channel, -1 where one of its nine heights is not known."""
    rough = np.full(tuple(-(-n // block) for n in spec.shape), _UNKNOWN, dtype=np.int64)
    if heights_cm is not None:
        reach = max(round(REACH_M / spec.cell_m), 1)
        fill_roughness(np.ascontiguousarray(heights_cm, dtype=np.int16), block, reach, rough)
    return rough


@kernel
def fill_roughness(heights_cm, block, reach, rough):  # type: ignore[no-untyped-def]
    """Fill `rough` where all nine heights at distances of `reach` cells are known.

    The least-squares plane through heights h at x, y in {-1, 0, 1} leaves the squares
    Σh² - (Σh)²/9 - (Σxh)²/6 - (Σyh)²/6, of six degrees of freedom.
    """
    n_y, n_x = heights_cm.shape
    for row in range(rough.shape[0]):
        j = row * block + block // 2
        if j < reach or j >= n_y - reach:
            continue
        for column in range(rough.shape[1]):
            i = column * block + block // 2
            if i < reach or i >= n_x - reach:
                continue
            total = squares = right = ahead = np.int64(0)
            known = True
            for y in range(-1, 2):
                for x in range(-1, 2):
                    h = np.int64(heights_cm[j + y * reach, i + x * reach])
                    known = known and h != NO_GROUND_CM
                    total, squares = total + h, squares + h * h
                    right, ahead = right + x * h, ahead + y * h
            if known:
                left = squares - total * total / 9.0 - (right * right + ahead * ahead) / 6.0
                metres = np.sqrt(max(left, 0.0) / 6.0) / 100.0
                rough[row, column] = np.int64(np.floor(metres * _PER_M + 0.5))


@kernel
def add_relief(rough, side, steps_cm, block, cell, sums):  # type: ignore[no-untyped-def]
    """Add what a frame says at the points of blocks to `sums` [blocks, 5]; `rough` has squares of
    `side` x `side` local cells."""
    for b in range(block.size):
        k = np.uint32(block[b])
        for p in range(cell.shape[1]):
            if cell[b, p] < 0:
                continue
            j, i = cell[b, p] >> COLUMN_BITS, cell[b, p] & ((1 << COLUMN_BITS) - 1)
            residual, step = rough[j // side, i // side], steps_cm[j, i]
            if residual >= 0:
                sums[k, 0] += 1
                sums[k, 1] += residual
            if step != NO_STEP_KNOWN:
                sums[k, 2] += 1
                if step >= LEAST_STEP_CM:
                    sums[k, 3] += 1
                    sums[k, 4] += np.int64(step)


def _roughness(cells: Cells) -> AnyArray:
    parts, total = cells["rough_sessions"], cells["rough_sum"]
    return np.where(parts > 0, total / np.maximum(parts, np.uint64(1)) / _PER_M, np.nan)


def _steps_cm(cells: Cells) -> AnyArray:
    """The step of base cells in whole centimetres, one more, 0 where none could be told: one that
    half of the sessions saw."""
    known, seen, total = (cells[name] for name in ("step_known", "step_sessions", "step_cm_sum"))
    voted = (known > 0) & (seen * np.uint64(STEP_VOTES) >= known)
    half = seen // np.uint64(2)
    height = np.where(voted, (total + half) // np.maximum(seen, np.uint64(1)), np.uint64(0))
    return np.where(known > 0, height + np.uint64(1), np.uint64(0)).astype(np.uint64)


def _step(cells: Cells) -> AnyArray:
    highest = cells["step_highest"]
    return np.where(highest > 0, (highest.astype(np.float64) - 1.0) / 100.0, np.nan)


GROUP = ChannelGroup(
    "surface",
    (
        Channel("rough_sessions"),
        Channel("rough_sum"),
        Channel("step_known"),
        Channel("step_sessions"),
        Channel("step_cm_sum"),
    ),
    fold=_Relief,
    overview=(OverviewChannel("step_highest", Combine.MAX, _steps_cm),),
    frame=(GROUND_CHANNEL, STEP_CHANNEL),
    blocks=True,
)

_NAN = float("nan")

ROUGHNESS = Layer(
    "roughness",
    "float32",
    "m",
    "how far the ground is off a plane of a metre, RMS, as a frame sees it",
    ("density", "surface"),
    _roughness,
    _NAN,
    Colours(palette.STEEP, 0.0, 0.1),
)

STEP = Layer(
    "step",
    "float32",
    "m",
    "highest step up or down in the ground, edge of a ditch or terrace, of which the cell is a "
    "side; 0 for none of 10 cm; of a larger cell, the highest of its base cells",
    ("density", "surface"),
    _step,
    _NAN,
    Colours(palette.STEEP, 0.0, 0.4),
)
