"""What lasts and what passes: obstacles by the drives that saw them standing.

The classes are those of the map's own cells. They follow from the channels of the sessions, and are
stored for larger cells only; these have what is highest in them.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import UInt64, palette
from fieldgrid.geometry import OBSTACLE_ABOVE
from fieldgrid.maps.layers.built_in.density import DENSITIES, mean
from fieldgrid.maps.layers.declaration import (
    Cells,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    OverviewChannel,
)

_LEAST = 2
"""Sessions that must have seen a place to say what lasts there."""


def lasting_density(cells: Cells) -> UInt64:
    """The density, 0 where most drives, or half of them, saw no obstacle, and that of an obstacle
    where most saw one: the mean over all is less where some saw far more of a cell."""
    stood, seen, density = cells["obstacle_sessions"], cells["seen_sessions"], mean(cells)
    stays = np.uint64(2) * stood > seen
    kept = np.where(stays, np.maximum(density, OBSTACLE_ABOVE + 1), density)
    return np.where(stays | (stood == 0), kept, 0).astype(np.uint64)


def _classes(cells: Cells) -> tuple[UInt64, ...]:
    """Whether an obstacle stood in all of two sessions or more, in several but not in all, or in a
    single one of them; and the density that lasts."""
    stood, seen = cells["obstacle_sessions"], cells["seen_sessions"]
    static = (seen >= _LEAST) & (stood == seen)
    seasonal = (stood >= 2) & (stood < seen)
    passing = (stood == 1) & (seen >= _LEAST)
    flags = (where.astype(np.uint64) for where in (static, seasonal, passing))
    return *flags, lasting_density(cells)


GROUP = ChannelGroup(
    "lasting",
    (),
    follows_from=("density", "sessions"),
    overview=(
        OverviewChannel("static", Combine.MAX),
        OverviewChannel("seasonal", Combine.MAX),
        OverviewChannel("passing", Combine.MAX),
        OverviewChannel("lasting_peak", Combine.MAX),
    ),
    overview_of_base=_classes,
)


_CLASS = Colours((palette.DENSITY[0].colour, palette.DENSITY[-1].colour), 0.0, 1.0)


def _layer(name: str, meaning: str) -> Layer:
    groups = "density", "sessions", GROUP.name
    return Layer(name, "uint8", "", meaning, groups, lambda cells: cells[name], None, _CLASS)


STATIC = _layer("static", "1: an obstacle in every session that observed the cell, two at least")
SEASONAL = _layer(
    "seasonal", "1: an obstacle in two or more of the sessions that observed the cell, not in all"
)
PASSING = _layer("passing", "1: an obstacle in one only of the sessions that observed the cell")

LASTING = Layer(
    "lasting",
    "uint8",
    "",
    "highest density of the base cells in the cell, 0 where half of the sessions or more that "
    "observed one saw no obstacle",
    ("density", "sessions", GROUP.name),
    lambda cells: cells["lasting_peak"],
    None,
    DENSITIES,
)
