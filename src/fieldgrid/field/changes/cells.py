"""Cells of which two times say different things, and how far they are from what stood before.

Of each side the latest drive that saw a cell counts, as in `MapFile.diff`. A cell has changed where
most looks of one side see an obstacle, the other side saw it free and nothing in it, and the
nearest thing that the other side saw is further away than the positions of both are unsure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from fieldgrid.core import Bool, Float32, Float64, Int16, Int64
from fieldgrid.field.changes.observations import FrameObserver
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import FREE, OBSTACLE, UNSEEN, Evidence, fill_pinholes

SQUARE_CELLS = 1024
"""Side of the squares that are worked on at a time; one takes some 60 MB."""

PINHOLE_M = 0.25
"""Unseen ground counts as seen where no such square of it fits."""

MARGIN_M = 3.0
"""How far around a square is looked for what stood before; a place that is less sure than that
tells of no change."""


SideDrives = Mapping[str, Sequence[FrameObserver]]
"""The frames of the drives of one side by name, in the order of the drives."""


class SideCells(NamedTuple):
    """What a side knows of the cells of a window, by the latest drive that saw each.

    `obstacle` and `free` count looks; `pose_m2` and `range_m2` are means over the looks; `drive`
    is the number of the drive, -1 where none saw the cell.
    """

    obstacle: Float32
    free: Float32
    stands: Bool
    observed: Bool
    pose_m2: Float32
    range_m2: Float32
    drive: Int16

    @property
    def variance_m2(self) -> Float32:
        """Of the place of what was seen, along one axis. Errors of poses are shared by the looks of
        a drive; those of ranges are each look's own."""
        looks = np.maximum(self.obstacle + self.free, np.float32(1.0))
        return np.asarray(self.pose_m2 + self.range_m2 / looks, dtype=np.float32)


class CellChanges(NamedTuple):
    """Cells of a square that changed in one direction, arrays [n].

    Cell (i, j) of the lattice, `away_m` from the nearest thing of the other side, and `clear_m`
    from the nearest place where that side saw a thing or did not look. The two sides together are
    unsure by `sigma_m`; `certain` where `away_m` is further than the asked number of
    sigmas. `stood` and `freed` are the numbers of the drives that saw it standing, and free.
    """

    i: Int64
    j: Int64
    away_m: Float32
    clear_m: Float32
    sigma_m: Float32
    certain: Bool
    stood: Int16
    freed: Int16

    @classmethod
    def joined(cls, parts: Sequence[CellChanges]) -> CellChanges:
        """The cells of several squares."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def chosen(self, which: Bool | Int64) -> CellChanges:
        """Some of the cells."""
        columns: list[Any] = [column[which] for column in self]
        return CellChanges(*columns)


def changed_cells(
    before: SideDrives, after: SideDrives, lattice: Lattice, window: Window, sigmas: float
) -> tuple[CellChanges, CellChanges]:
    """The cells of a window that appeared, and those that vanished."""
    wide = surroundings(window, lattice)
    inside = wide.slices_of(window)
    old, new = (seen_by(drives, lattice, wide) for drives in (before, after))
    return (
        _changed(new, old, lattice, window, inside, sigmas),
        _changed(old, new, lattice, window, inside, sigmas),
    )


def surroundings(window: Window, lattice: Lattice) -> Window:
    """A window and what lies within `MARGIN_M` of it."""
    return window.grown(math.ceil(MARGIN_M * lattice.cells_per_m))


def seen_by(drives: SideDrives, lattice: Lattice, window: Window) -> SideCells:
    """What the drives of a side saw of a window."""
    total = _unseen(window)
    for number, observers in enumerate(drives.values()):
        one = _seen_by_one(observers, lattice, window, number)
        pairs: Iterator[Any] = zip(total, one, strict=True)
        for array, values in pairs:
            np.copyto(array, values, where=one.drive >= 0)
    return total


def _unseen(window: Window) -> SideCells:
    obstacle, free, pose_m2, range_m2 = np.zeros((4, *window.shape), dtype=np.float32)
    stands, observed = np.zeros((2, *window.shape), dtype=np.bool_)
    drive = np.full(window.shape, -1, dtype=np.int16)
    return SideCells(obstacle, free, stands, observed, pose_m2, range_m2, drive)


def _seen_by_one(
    observers: Sequence[FrameObserver], lattice: Lattice, window: Window, number: int
) -> SideCells:
    seen = _unseen(window)
    told = np.zeros(window.shape, dtype=np.float32)
    for one in observers:
        look = one.observe(lattice, window)
        if look is None:
            continue
        place, weight = window.slices_of(look.window), np.float32(one.weight)
        share = weight * (look.obstacle | look.free)
        told[place] += share
        seen.obstacle[place] += weight * look.obstacle
        seen.free[place] += weight * look.free
        seen.stands[place] |= look.stands
        seen.observed[place] |= look.observed
        seen.pose_m2[place] += share * look.pose_m2
        seen.range_m2[place] += share * look.range_m2
        seen.drive[place][look.observed] = number
    for variance in (seen.pose_m2, seen.range_m2):
        np.divide(variance, told, out=variance, where=told > 0.0)
    return seen


def _changed(
    stood: SideCells,
    freed: SideCells,
    lattice: Lattice,
    window: Window,
    inside: tuple[slice, slice],
    sigmas: float,
) -> CellChanges:
    """The cells where one side saw something standing and the other side free ground."""
    classes = np.where(freed.stands, OBSTACLE, np.where(freed.observed, FREE, UNSEEN))
    wide = Window(0, 0, classes.shape[1], classes.shape[0])
    known = fill_pinholes(Evidence(lattice, wide, classes.astype(np.uint8)), PINHOLE_M).cells
    away_m = _distance_m(known != OBSTACLE, lattice)[inside]
    clear_m = _distance_m(known == FREE, lattice)[inside]
    sigma_m = np.sqrt((stood.variance_m2 + freed.variance_m2)[inside])
    says = (stood.obstacle > stood.free) & (freed.free > 0.0) & ~freed.stands
    j, i = np.nonzero(says[inside])
    # Either side rounds places to the middles of cells.
    rounded_m = math.sqrt(2.0) * lattice.cell_m
    return CellChanges(
        i + window.i0,
        j + window.j0,
        away_m[j, i],
        np.maximum(clear_m[j, i] - rounded_m, 0.0),
        sigma_m[j, i],
        away_m[j, i] - rounded_m > sigmas * sigma_m[j, i],
        stood.drive[inside][j, i],
        freed.drive[inside][j, i],
    )


def _distance_m(within: Bool, lattice: Lattice) -> Float32:
    """How far each cell is from the nearest that is not among these; `MARGIN_M` at most."""
    if within.all():
        return np.full(within.shape, MARGIN_M, dtype=np.float32)
    away_m: Float64 = ndimage.distance_transform_edt(within) * lattice.cell_m
    return np.minimum(away_m, MARGIN_M).astype(np.float32)
