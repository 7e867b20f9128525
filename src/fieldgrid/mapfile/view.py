"""A part of a map as arrays, folded anew from the evidence where the tiles do not have it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import ConfigError
from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds, Lattice, Window
from fieldgrid.mapfile.records import FrameRecord
from fieldgrid.transfer import Averaging, MeanFold, PaperFold, Transfer, footprint

MAX_CELLS = 400_000_000
"""Cells that a view may have: 800 MB of density and mask."""

BLOCK_CELLS = 2048
"""Side of the block that is folded at a time, so that its sums take 64 MB at most."""


@dataclass(frozen=True, slots=True)
class MapView:
    """A window of a map: 3D density, uint8 [rows north, columns east], row 0 in the south.

    0 with `observed` is free ground; without, nothing is known of the cell.
    """

    lattice: Lattice
    window: Window
    density: npt.NDArray[np.uint8]
    observed: npt.NDArray[np.bool_]
    datum: Datum

    @property
    def bounds(self) -> Bounds:
        """The outer edges in metres east and north of the datum."""
        return self.lattice.bounds(self.window)


def empty_view(lattice: Lattice, window: Window, datum: Datum) -> MapView:
    """A view in which nothing has been observed, to be filled in place."""
    if window.width * window.height > MAX_CELLS:
        raise ConfigError(
            f"A view of {window.width} x {window.height} cells of {lattice.cell_m} m is over "
            f"{MAX_CELLS / 1e6:.0f} million cells; give smaller bounds or a larger cell."
        )
    density = np.zeros(window.shape, dtype=np.uint8)
    return MapView(lattice, window, density, np.zeros(window.shape, dtype=np.bool_), datum)


def fold(
    view: MapView, frames: Sequence[FrameRecord], averaging: Averaging, transfer: Transfer
) -> None:
    """Fill a view from frames in the order given, block by block, a grid in memory at a time."""
    for block in _blocks(view.window):
        inside = [
            frame
            for frame in frames
            if footprint(frame.spec, frame.pose, view.lattice).intersect(block) is not None
        ]
        if not inside:
            continue
        sums: MeanFold | PaperFold
        if averaging is Averaging.PAPER:
            sums = PaperFold(view.lattice, block)
        else:
            sums = MeanFold(view.lattice, block, transfer)
        for frame in inside:
            sums.add(frame.grid(), frame.pose)
        place = view.window.slices_of(block)
        view.density[place], view.observed[place] = sums.density()


def _blocks(window: Window) -> Iterator[Window]:
    for j0 in range(window.j0, window.j0 + window.height, BLOCK_CELLS):
        for i0 in range(window.i0, window.i0 + window.width, BLOCK_CELLS):
            block = window.intersect(Window(i0, j0, BLOCK_CELLS, BLOCK_CELLS))
            assert block is not None
            yield block
