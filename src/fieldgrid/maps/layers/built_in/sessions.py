"""How many sessions observed a cell, and in how many of them it was an obstacle."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import AnyArray, UInt64, palette
from fieldgrid.geometry import OBSTACLE_ABOVE
from fieldgrid.maps.layers.built_in.density import mean
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    OverviewChannel,
)


def _of_session(cells: Cells) -> UInt64:
    """1 where the session observed the cell, 1 where the session's own mean is an obstacle."""
    return np.stack([cells.observed, mean(cells) > OBSTACLE_ABOVE]).astype(np.uint64)


def _persistence(cells: Cells) -> AnyArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(cells["obstacle_sessions"] / cells["seen_sessions"])


GROUP = ChannelGroup(
    "sessions",
    (Channel("seen_sessions"), Channel("obstacle_sessions")),
    of_session=_of_session,
    overview=(OverviewChannel("most_sessions", Combine.MAX, lambda cells: cells["seen_sessions"]),),
)

SESSIONS = Layer(
    "sessions",
    "uint16",
    "sessions",
    "sessions that observed the cell; of a larger cell, the most that observed a base cell of it",
    ("density", "sessions"),
    lambda cells: cells["most_sessions"],
    0,
    Colours.of(palette.VALUES, 0.0),
)

PERSISTENCE = Layer(
    "persistence",
    "float32",
    "1",
    "share of the sessions that observed the cell in which it was an obstacle",
    ("density", "sessions"),
    _persistence,
    float("nan"),
    Colours.of(palette.VALUES, 0.0, 1.0),
)
