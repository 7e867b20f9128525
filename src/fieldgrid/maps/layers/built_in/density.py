"""The 3D density: the mean over all that frames said of a cell, and what its base cells say."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import AnyArray, UInt64, palette
from fieldgrid.geometry import Lattice
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
from fieldgrid.maps.transfer import WeightedSums, mean_density


class _Sums:
    """Weight and weighted sum, in sixteenths of a local cell."""

    def __init__(self, cells: int, lattice: Lattice) -> None:
        self._lattice = lattice
        self._sums = WeightedSums(cells)

    def add(self, frame: FrameInPlace) -> None:
        self._sums.add(frame.cells.grid, frame.landing, self._lattice)

    def channels(self) -> UInt64:
        return self._sums.channels()


def mean(cells: Cells) -> AnyArray:
    """The density of each cell, uint8."""
    return mean_density(cells["weight"], cells["sum"])[0]


GROUP = ChannelGroup(
    "density",
    (Channel("weight"), Channel("sum")),
    fold=_Sums,
    of_frames=True,
    overview=(
        OverviewChannel("peak", Combine.MAX, lambda cells: mean(cells).astype(np.uint64)),
        OverviewChannel("seen", Combine.SUM, lambda cells: cells.observed.astype(np.uint64)),
    ),
)

DENSITIES = Colours.of(palette.DENSITY, 0.0, 255.0)
"""Pale is free, red to black an obstacle."""

DENSITY = Layer(
    "density", "uint8", "", "mean 3D density, 0..255", ("density",), mean, None, DENSITIES
)

PEAK = Layer(
    "peak",
    "uint8",
    "",
    "highest mean density of the base cells in the cell",
    ("density",),
    lambda cells: cells["peak"],
    None,
    DENSITIES,
)

SEEN_SHARE = Layer(
    "seen_share",
    "float32",
    "1",
    "share of the base cells in the cell that were observed",
    ("density",),
    lambda cells: np.minimum(cells["seen"] / np.float32(cells.base_cells), 1.0),
    float("nan"),
    Colours.of(palette.VALUES, 0.0, 1.0),
)
