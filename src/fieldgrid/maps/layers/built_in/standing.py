"""What stands above the ground: how high it reaches, and how much room there is below what hangs.

A frame's channels `top_dm` and `foot_dm` say both in decimetres, in blocks of 20 cm
(`perception.standing`); they count in cells in which the frame has a density. Frames and
sessions meet by the highest top and the lowest foot. Something hangs where the lowest that any
frame saw is above `LEAST_ROOM_DM`, and one saw the ground below it: a trunk that another frame sees
takes the room away.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import AnyArray, UInt8, UInt64, kernel, palette
from fieldgrid.geometry import FOOT_CHANNEL, GROUND_BELOW, TOP_CHANNEL, Lattice
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    nothing,
)
from fieldgrid.maps.layers.frame import FrameInPlace

LEAST_ROOM_DM = 3
"""What begins lower stands on the ground: the slice begins at 2."""

FROM_FOOT = 128
"""The foot is kept as this many decimetres less its height, so that the lowest foot is the maximum.
"""


class _StandingHeights:
    """Of each cell the highest top, the rest to the lowest foot, and whether ground shows below."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._shape = cells, 3
        self._most: UInt8 | None = None  # before the first frame that tells any

    def add(self, frame: FrameInPlace) -> None:
        grid, landing, channels = frame.cells.grid, frame.landing, frame.cells.channels
        tops_dm, feet_dm = channels.get(TOP_CHANNEL), channels.get(FOOT_CHANNEL)
        if tops_dm is None or feet_dm is None:
            return
        if self._most is None:
            self._most = np.zeros(self._shape, dtype=np.uint8)
        raise_standing(
            grid.density,
            np.ascontiguousarray(tops_dm, dtype=np.uint8),
            np.ascontiguousarray(feet_dm, dtype=np.uint8),
            *landing,
            self._most,
        )

    def channels(self) -> UInt64:
        return nothing(self._shape[::-1]) if self._most is None else self._most.T.astype(np.uint64)


@kernel
def raise_standing(density, tops_dm, feet_dm, cell, shift, spans, most):  # type: ignore[no-untyped-def]
    """Raise `most` [cells, 3] to what a frame [n_y, n_x] says of the cells that it lands in."""
    for r in range(cell.shape[0]):
        j = r >> shift
        for c in range(spans[r, 0], spans[r, 1]):
            i = c >> shift
            if cell[r, c] < 0 or density[j, i] == 0 or tops_dm[j, i] == 0:
                continue
            k, foot, below = np.uint32(cell[r, c]), feet_dm[j, i], np.uint8(0)
            if foot >= GROUND_BELOW:
                foot, below = np.uint8(foot - GROUND_BELOW), np.uint8(1)
            most[k, 0] = max(most[k, 0], tops_dm[j, i])
            most[k, 1] = max(most[k, 1], np.uint8(FROM_FOOT - foot))
            most[k, 2] = max(most[k, 2], below)


def _max_height(cells: Cells) -> AnyArray:
    top = cells["top_dm"].astype(np.float64) / 10.0
    return np.where((top == 0.0) & (cells["sum"] > 0), np.nan, top)


def _clearance(cells: Cells) -> AnyArray:
    foot_dm = FROM_FOOT - cells["foot_from_dm"].astype(np.float64)
    hangs = (cells["top_dm"] > 0) & (cells["ground_below"] > 0) & (foot_dm >= LEAST_ROOM_DM)
    return np.where(hangs, foot_dm / 10.0, np.nan)


GROUP = ChannelGroup(
    "standing",
    tuple(
        Channel(name, Combine.MAX, Combine.MAX)
        for name in ("top_dm", "foot_from_dm", "ground_below")
    ),
    fold=_StandingHeights,
    frame=(TOP_CHANNEL, FOOT_CHANNEL),
    of_frames=True,
)

_GROUPS, _NAN = ("density", "standing"), float("nan")

MAX_HEIGHT = Layer(
    "max_height",
    "float32",
    "m",
    "how high what stands reaches above the ground, up to the top of the slice; 0 where nothing "
    "stands; of a larger cell, the highest in it",
    _GROUPS,
    _max_height,
    _NAN,
    Colours.of(palette.VALUES, 0.0, 2.2),
)

CLEARANCE = Layer(
    "clearance",
    "float32",
    "m",
    "how high above the ground the lowest of what hangs over it is, where something does and "
    "nothing stands below; of a larger cell, the lowest in it",
    _GROUPS,
    _clearance,
    _NAN,
    Colours(palette.GOODNESS, 0.0, 2.2),
)
