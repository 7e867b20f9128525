"""How likely a cell is occupied: log-odds with clamping, over what frames say of it.

The inverse sensor model: a frame that sees an obstacle in a cell says that it is occupied with 0.7,
one that sees free ground, and no obstacle there, with 0.4; one in doubt says nothing. An edge at
which the ground falls away is an obstacle, and of ground that was only seen beyond one a frame is
in doubt. That is l = ln(p / (1 - p)), +0.85 and -0.4, added up over the frames of a drive and
clamped to -2..3.5, so that one drive never outweighs all later ones; then over the drives, and
clamped again. The numbers are those of OctoMap (Hornung et al. 2013), the idea is that of Moravec
and Elfes (1985).
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import AnyArray, UInt64, kernel, palette
from fieldgrid.geometry import (
    BEYOND_DROP,
    DROP_CHANNEL,
    FREE_UP_TO,
    NO_DROP_TOLD,
    OBSTACLE_ABOVE,
    Lattice,
)
from fieldgrid.maps.layers.built_in.count import frames_of_weight
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    OverviewChannel,
)
from fieldgrid.maps.layers.frame import FrameInPlace

PER_UNIT = 20
"""Log-odds are whole twentieths, so that a sum does not depend on the order of its terms."""

FREE, OCCUPIED = -8, 17
"""What a frame adds: p = 0.40 and 0.70."""

LEAST, MOST = -40, 70
"""Between which log-odds are clamped: p = 0.12 and 0.97."""

_NOTHING, _FREE, _DOUBT, _OBSTACLE = range(4)
"""What a frame says of a cell, the strongest of what its local cells there say."""

_SAYS = np.full(256, _DOUBT, dtype=np.int32)
_SAYS[: FREE_UP_TO + 1] = _FREE
_SAYS[OBSTACLE_ABOVE + 1 :] = _OBSTACLE

_NO_DROPS = np.zeros((0, 0), dtype=np.uint8)
"""Of a frame that does not tell them."""

_WORTH = np.array([0, FREE, 0, OCCUPIED], dtype=np.int32)


class _LogOdds:
    """The log-odds of one session; beside them, what the latest frame has said of the cell."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._cells = np.zeros((cells, 2), dtype=np.int32)
        self._frames = 0

    def add(self, frame: FrameInPlace) -> None:
        self._frames += 1
        landing, density = frame.landing, frame.cells.grid.density
        drops_cm = frame.cells.channels.get(DROP_CHANNEL, _NO_DROPS)
        add_log_odds(
            *(density, np.ascontiguousarray(drops_cm), *landing),
            *(self._frames, _SAYS, _WORTH, self._cells),
        )

    def channels(self) -> UInt64:
        return np.clip(self._cells[:, 0], LEAST, MOST).astype(np.int64).view(np.uint64)[None]


@kernel
def add_log_odds(density, drops_cm, cell, shift, spans, number, says, worth, cells):  # type: ignore[no-untyped-def]
    """Add what a frame says of each cell to `cells` [cells, 2]: its log-odds, and what the last
    frame said there, plus 4 times the number of that. `drops_cm` is empty where it tells none.

    A frame counts once in a cell: where it says more, what it said before is taken back.
    """
    before = np.int32(4 * number)
    for r in range(cell.shape[0]):
        for c in range(spans[r, 0], spans[r, 1]):
            if cell[r, c] < 0:
                continue
            k = np.uint32(cell[r, c])
            said = max(cells[k, 1] - before, np.int32(0))
            now = says[density[r >> shift, c >> shift]]
            if drops_cm.size:
                drop = drops_cm[r >> shift, c >> shift]
                if drop == BEYOND_DROP:
                    now = max(now, _DOUBT)
                elif drop > 0 and drop != NO_DROP_TOLD:
                    now = _OBSTACLE
            if now > said:
                cells[k, 0] += worth[now] - worth[said]
                cells[k, 1] = before + now


def _expected(weight: UInt64, total: UInt64) -> UInt64:
    """As if all frames agreed."""
    frames = frames_of_weight(weight).view(np.int64)
    free = np.where(total == 0, np.maximum(FREE * frames, LEAST), 0)
    is_obstacle = total > weight * np.uint64(OBSTACLE_ABOVE)
    return np.where(is_obstacle, np.minimum(OCCUPIED * frames, MOST), free).view(np.uint64)[None]


def _of_base(cells: Cells) -> UInt64:
    """The clamped log-odds of base cells from 1 on, 0 of those that were not seen."""
    clamped = np.clip(cells["log_odds"].view(np.int64), LEAST, MOST) - LEAST + 1
    return np.where(cells.observed, clamped, 0).astype(np.uint64)


def _probability(cells: Cells) -> AnyArray:
    log_odds = (cells["most_occupied"].astype(np.float64) - 1.0 + LEAST) / PER_UNIT
    return np.asarray(1.0 / (1.0 + np.exp(-log_odds)))


GROUP = ChannelGroup(
    "occupancy",
    (Channel("log_odds", signed=True),),
    fold=_LogOdds,
    overview=(OverviewChannel("most_occupied", Combine.MAX, _of_base),),
    expected=_expected,
    frame=(DROP_CHANNEL,),
)

OCCUPANCY = Layer(
    "occupancy",
    "float32",
    "1",
    "probability that the cell is occupied, from clamped log-odds; of a larger cell, the highest "
    "of its base cells",
    ("density", "occupancy"),
    _probability,
    float("nan"),
    Colours.of(palette.OCCUPANCY, 0.0, 1.0),
)
