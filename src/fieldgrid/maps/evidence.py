"""What a map says of a field, as row finding needs it: obstacle cells, free cells, unseen ones.

Rows are measured in *strips*: the cells along a line, straightened, so that columns are distances
to the left of it. A strip is read by the nearest cell, so nothing is interpolated between an
obstacle and what was never seen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from fieldgrid.core import Float64, UInt8, kernel
from fieldgrid.geometry import OBSTACLE_ABOVE, Lattice, Window, lengths, normals
from fieldgrid.maps.views.blocks import MapBlocks
from fieldgrid.maps.views.view import MapView

UNSEEN, FREE, OBSTACLE = 0, 1, 2
"""Classes of cells."""

_BAND_CELLS = 4_000_000
"""Cells that are worked on at a time where it takes some bytes of each."""


class Strip(NamedTuple):
    """The cells along a line: their classes [n along, m across], the distances along (metres from
    its first point) and across (to the left) of their middles."""

    cells: UInt8
    along_m: Float64
    across_m: Float64


class Evidence(NamedTuple):
    """Classes of the cells of a window, uint8 [rows north, columns east]."""

    lattice: Lattice
    window: Window
    cells: UInt8

    @classmethod
    def of(cls, view: MapView, obstacle_above: int = OBSTACLE_ABOVE) -> Evidence:
        """The classes of a view that was read to decide: an obstacle is a cell whose worst density
        is above the threshold."""
        return cls.of_blocks(MapBlocks(view.lattice, view.window, iter((view,))), obstacle_above)

    @classmethod
    def of_blocks(cls, blocks: MapBlocks, obstacle_above: int = OBSTACLE_ABOVE) -> Evidence:
        """The classes of the blocks of a map, of which one is held at a time."""
        cells = np.zeros(blocks.window.shape, dtype=np.uint8)
        for view in blocks.views:
            worst, seen, _ = view.decision()
            classes = np.where(worst > obstacle_above, OBSTACLE, FREE)
            cells[blocks.window.slices_of(view.window)] = np.where(seen > 0.0, classes, UNSEEN)
        return cls(blocks.lattice, blocks.window, cells)

    @property
    def origin_m(self) -> tuple[float, float]:
        """The south-west corner of the window, metres east and north."""
        bounds = self.lattice.bounds(self.window)
        return bounds.west_m, bounds.south_m

    @property
    def cell_m(self) -> float:
        """Side of the cells."""
        return self.lattice.cell_m

    def strip(
        self,
        line: Float64,
        left_m: float,
        right_m: float,
        step_m: float,
        across_step_m: float | None = None,
    ) -> Strip:
        """The cells from `right_m` right of a line to `left_m` left of it, every `step_m` along,
        and every `across_step_m` across: without it, as wide apart as cells are."""
        s = lengths(line)
        at = np.arange(0.5 * step_m, s[-1], step_m)
        middle = np.column_stack([np.interp(at, s, line[:, k]) for k in (0, 1)])
        left = normals(line)
        left = np.column_stack([np.interp(at, s, left[:, k]) for k in (0, 1)])
        left /= np.hypot(left[:, 0], left[:, 1])[:, None]
        apart_m = across_step_m or self.cell_m
        across = np.arange(-right_m + 0.5 * apart_m, left_m, apart_m)
        cells = np.zeros((len(at), len(across)), dtype=np.uint8)
        i0, j0, per_m = self.window.i0, self.window.j0, self.lattice.cells_per_m
        read_across(self.cells, i0, j0, per_m, middle, left, across, cells)
        return Strip(cells, at, across)


@kernel
def read_across(cells, i0, j0, per_m, middle, left, across, found):  # type: ignore[no-untyped-def]
    """Write the classes of the cells that enclose points `across` metres to the left of the points
    `middle`; points outside of the window are left out."""
    for k in range(len(middle)):
        for m in range(len(across)):
            i = math.floor((middle[k, 0] + across[m] * left[k, 0]) * per_m) - i0
            j = math.floor((middle[k, 1] + across[m] * left[k, 1]) * per_m) - j0
            if 0 <= i < cells.shape[1] and 0 <= j < cells.shape[0]:
                found[k, m] = cells[j, i]


def fill_pinholes(evidence: Evidence, hole_m: float) -> Evidence:
    """The evidence with unseen ground taken for free where no square of `hole_m` of it fits.

    A stereo camera leaves pinholes in ground that it has seen; 0 fills none of them. Ground outside
    the window is unseen.
    """
    size = int(hole_m * evidence.lattice.cells_per_m + 1e-9)
    if size < 2:
        return evidence
    cells = evidence.cells.copy()
    height, width = cells.shape
    kernel = np.ones((size, size), np.uint8)
    count, reach = max(_BAND_CELLS // width, 4 * size), 2 * size
    for first in range(0, height, count):
        last = min(first + count, height)
        low, high = max(first - reach, 0), min(last + reach, height)
        unseen = (evidence.cells[low:high] == UNSEEN).astype(np.uint8)
        below, above = reach - (first - low), reach - (high - last)
        padded = cv2.copyMakeBorder(
            unseen, below, above, reach, reach, cv2.BORDER_CONSTANT, value=1
        )
        wide = cv2.morphologyEx(padded, cv2.MORPH_OPEN, kernel)[reach:-reach, reach:-reach]
        cells[first:last][(unseen[first - low : last - low] > 0) & (wide == 0)] = FREE
    return evidence._replace(cells=cells)
