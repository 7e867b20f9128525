"""Drops: where the ground falls away, and what was only seen beyond the edge of one.

A frame's channel `drop_cm` says both of its cells (`perception.edges`). Frames of a drive vote.
There is a drop where more than a third of those that could tell saw one: log-odds that are clamped
for each drive, so that many drives over one side do not outvote what is seen from the other, and
three that saw the place without it tell that a ditch was filled. A rise tells nothing: it is the
same edge from below. A drive saw a cell only beyond an edge where three quarters of the frames that
could tell say so; no planner takes that for seen ground, until another drive looks at it from its
own level. The density is as ever.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fieldgrid.core import AnyArray, Int32, UInt64, kernel, palette
from fieldgrid.geometry import BEYOND_DROP, DROP_CHANNEL, NO_DROP_TOLD, STEP_CHANNEL, Lattice
from fieldgrid.maps.layers.built_in.relief import LEAST_STEP_CM
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
from fieldgrid.maps.transfer import CELL_WEIGHT, add_values

CLEAR, FALLS = -1, 2
"""What a part of a local cell adds to the log-odds of a drop."""

LEAST, MOST = -8 * CELL_WEIGHT, 16 * CELL_WEIGHT
"""Between which a drive's log-odds are clamped: eight whole local cells that say the same."""

BEYOND_SHARE = (3, 4)
"""Where at least this share of the parts that could tell lies beyond an edge, all of them do."""


class _DropSums:
    """How many parts of local cells land in a cell, and five sums over those of frames that tell of
    drops: log-odds of a drop; parts with a drop, and its centimetres; those that lie beyond an
    edge, and those that do not."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._parts = np.zeros(cells, dtype=np.uint64)
        self._sums: Int32 | None = None  # before the first frame that tells any

    def add(self, frame: FrameInPlace) -> None:
        spec, landing, channels = frame.cells.grid.spec, frame.landing, frame.cells.channels
        each = np.full(256, landing.unit, np.uint64)
        add_values(frame.cells.grid.density, *landing, each, self._parts)
        drops_cm, steps_cm = channels.get(DROP_CHANNEL), channels.get(STEP_CHANNEL)
        if drops_cm is None:
            return
        if self._sums is None:
            self._sums = np.zeros((self._parts.size, 5), dtype=np.int32)
        if steps_cm is None:
            steps_cm = np.full(spec.shape, NO_DROP_TOLD, np.uint8)
        add_drops(
            np.ascontiguousarray(drops_cm, dtype=np.uint8),
            np.ascontiguousarray(steps_cm, dtype=np.uint8),
            *landing,
            landing.unit,
            self._sums,
        )

    def channels(self) -> UInt64:
        if self._sums is None:
            return nothing((4, self._parts.size))
        odds, drops, total_cm, behind, before = self._sums.T.astype(np.int64)
        share, whole = BEYOND_SHARE
        beyond = (behind > 0) & (whole * behind >= share * (behind + before))
        odds = np.clip(odds, LEAST, MOST)
        parts = np.where(beyond, self._parts.view(np.int64), 0)
        return np.stack([odds, drops, total_cm, parts]).view(np.uint64)


@kernel
def add_drops(drops_cm, steps_cm, cell, shift, spans, unit, sums):  # type: ignore[no-untyped-def]
    """Add what a frame says of its cells [n_y, n_x] to `sums` [cells, 5], where its parts land."""
    for r in range(cell.shape[0]):
        for c in range(spans[r, 0], spans[r, 1]):
            if cell[r, c] < 0:
                continue
            k = np.uint32(cell[r, c])
            drop, step = drops_cm[r >> shift, c >> shift], steps_cm[r >> shift, c >> shift]
            if drop == 0:
                sums[k, 4] += unit
                if step < LEAST_STEP_CM:
                    sums[k, 0] += CLEAR * unit
            elif drop == BEYOND_DROP:
                sums[k, 3] += unit
            elif drop != NO_DROP_TOLD:
                sums[k, 0] += FALLS * unit
                sums[k, 1] += unit
                sums[k, 2] += unit * np.int32(drop)


def _expected(weight: UInt64, _: UInt64) -> Sequence[UInt64]:
    """Mostly there is no drop wherever anything is seen, and it is seen often."""
    none, clear = nothing(weight.shape), CLEAR * weight.view(np.int64)
    return np.maximum(clear, LEAST, out=clear).view(np.uint64), none, none, none


def _of_base(cells: Cells) -> UInt64:
    """Centimetres of the drop in base cells, one more; 0 where nothing is known."""
    odds, parts = cells["drop_odds"].view(np.int64), cells["drop_parts"]
    deepest: UInt64 = (odds != 0).astype(np.uint64)
    some = parts > 0  # few are, so that nothing else is divided
    if some.any():
        parts, total = parts[some], cells["drop_cm_sum"][some]
        mean_cm = (total + parts // np.uint64(2)) // parts
        deepest[some] = np.where(odds[some] > 0, mean_cm, 0) + np.uint64(1)
    return deepest


def _drop(cells: Cells) -> AnyArray:
    deepest = cells["drop_deepest"].astype(np.float32)
    known = deepest > 0.0
    deepest -= 1.0
    deepest /= 100.0
    deepest[~known] = np.nan
    return deepest


def _sure_share(cells: Cells) -> AnyArray:
    share = cells["sure"].astype(np.float32)
    if cells.base_cells > 1:
        np.minimum(share / np.float32(cells.base_cells), 1.0, out=share)
    return share


GROUP = ChannelGroup(
    "drop",
    (
        Channel("drop_odds", signed=True),
        Channel("drop_parts"),
        Channel("drop_cm_sum"),
        Channel("beyond_parts"),
    ),
    fold=_DropSums,
    overview=(
        OverviewChannel("drop_deepest", Combine.MAX, _of_base),
        # Where something was seen other than beyond an edge.
        OverviewChannel(
            "sure",
            Combine.SUM,
            lambda cells: (cells["weight"] > cells["beyond_parts"]).astype(np.uint64),
        ),
    ),
    expected=_expected,
    frame=(STEP_CHANNEL, DROP_CHANNEL),
)

_NAN = float("nan")

DROP = Layer(
    "drop",
    "float32",
    "m",
    "how far the ground falls away at an edge, seen from above; 0 where it does not; of a larger "
    "cell, the deepest of its base cells",
    ("density", "drop"),
    _drop,
    _NAN,
    Colours(palette.DROPS, 0.0, 1.0),
)

SURE_SHARE = Layer(
    "sure_share",
    "float32",
    "1",
    "share of the base cells in the cell that were observed, not only beyond the edge of a drop",
    ("density", "drop"),
    _sure_share,
    _NAN,
    Colours.of(palette.VALUES, 0.0, 1.0),
)
