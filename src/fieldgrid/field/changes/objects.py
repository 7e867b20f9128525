"""From cells that changed to objects, and how sure each is.

Cells that changed and lie side by side are one object. What reaches no further than plants grow
from what the other side saw is growth (or was cut back); what reaches further appeared (or
vanished).

The confidence of an object is the probability that all three hold:

* it stood: of the looks of the one side at its cells, s saw an obstacle and f free ground. With
  Jeffreys' prior the share of such looks that see an obstacle has the distribution
  Beta(s + 1/2, f + 1/2); the probability is that of a share above one half;
* its place was free on the other side, by the same rule;
* it is not something that the other side saw elsewhere, or would have seen where it did not look:
  1 - exp(-d²/(2·sigma²)). The object can be explained by a shift of at least d, which puts nine
  tenths of it there, and either coordinate of the two positions together has the error sigma.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree
from scipy.special import betainc

from fieldgrid.core import Int16, Int64
from fieldgrid.field.changes.cells import CellChanges, SideDrives
from fieldgrid.field.changes.result import ChangedObject, ChangeKind
from fieldgrid.field.rows.measuring.neighbours import linked_parts
from fieldgrid.geometry import Datum, Lattice, Window

SIDE_BY_SIDE = 2.5
"""Cells that are no further apart, in cells, are one object: frames leave pinholes."""

LEAST_SHARE, LEAST_CELLS = 0.1, 4
"""A frame has looked at an object where it saw this share of its cells, and as many."""

EXPLAINED = 0.9
"""A shift explains an object when it explains this share of its cells."""


class ChangedCells(NamedTuple):
    """Cells that are one object, and what became of it."""

    kind: ChangeKind
    cells: CellChanges

    @property
    def window(self) -> Window:
        """The smallest window around its cells."""
        i0, j0 = int(self.cells.i.min()), int(self.cells.j.min())
        return Window(i0, j0, int(self.cells.i.max()) - i0 + 1, int(self.cells.j.max()) - j0 + 1)


class Votes(NamedTuple):
    """Looks at an object that saw an obstacle, and that saw free ground."""

    stood: float
    freed: float


def things_of(
    cells: CellChanges,
    kinds: tuple[ChangeKind, ChangeKind],
    lattice: Lattice,
    growth_m: float,
    min_area_m2: float,
) -> list[ChangedCells]:
    """The objects of cells that changed in one direction; `kinds` are what reaches further than
    `growth_m`, and what does not."""  # fmt: skip
    far, near = kinds
    least = max(LEAST_CELLS, math.ceil(min_area_m2 * lattice.cells_per_m**2 - 1e-9))
    found, grown = list[ChangedCells](), list[Int64]()
    taken = np.zeros(cells.i.size, dtype=np.bool_)
    for part in _connected(cells, np.flatnonzero(cells.certain)):
        core = part[cells.away_m[part] > growth_m]
        # A sliver of shoots may reach further; what appeared is there with a share of its own.
        if core.size < max(LEAST_CELLS, least / 2):
            grown.append(part)
            continue
        places = np.column_stack([cells.i, cells.j])
        away, _ = cKDTree(places[core]).query(
            places, distance_upper_bound=growth_m * lattice.cells_per_m
        )
        around = np.flatnonzero(np.isfinite(away))
        around = around[~taken[around]]
        taken[around] = True
        if around.size >= least:
            found.append(ChangedCells(far, cells.chosen(around)))
        grown.append(np.setdiff1d(part, around))
    rest = np.concatenate(grown) if grown else np.empty(0, dtype=np.int64)
    rest = rest[~taken[rest]]
    for part in _connected(cells, rest):
        if part.size >= least:
            found.append(ChangedCells(near, cells.chosen(part)))
    return found


def _connected(cells: CellChanges, among: Int64) -> Iterator[Int64]:
    """The parts of some cells that lie side by side."""
    if not among.size:
        return
    places = np.column_stack([cells.i[among], cells.j[among]])
    pairs = cKDTree(places).query_pairs(SIDE_BY_SIDE, output_type="ndarray")
    label = linked_parts(pairs, among.size)
    order = np.argsort(label, kind="stable")
    yield from np.split(among[order], np.flatnonzero(np.diff(label[order])) + 1)


def votes_of(
    things: Sequence[ChangedCells], drives: SideDrives, lattice: Lattice, numbers: Sequence[Int16]
) -> list[Votes]:
    """How the looks of one side at each object were; `numbers` are the drives that count in each of
    its cells."""
    windows = [thing.window for thing in things]
    totals = np.zeros((len(things), 2))
    for number, observers in enumerate(drives.values()):
        for one in observers:
            near = [k for k, w in enumerate(windows) if one.reach.intersect(w) is not None]
            look = one.observe(lattice, one.reach) if near else None
            if look is None:
                continue
            for k in near:
                cells = things[k].cells
                counts = (numbers[k] == number) & cells.certain
                i, j = cells.i[counts] - look.window.i0, cells.j[counts] - look.window.j0
                inside = (i >= 0) & (j >= 0) & (i < look.window.width) & (j < look.window.height)
                at = (j[inside], i[inside])
                stood, freed = int(look.obstacle[at].sum()), int(look.free[at].sum())
                if stood + freed >= max(LEAST_CELLS, LEAST_SHARE * i.size):
                    totals[k] += one.weight * np.array([stood, freed]) / (stood + freed)
    return [Votes(*row) for row in totals.tolist()]


def probability(most: float, least: float) -> float:
    """That a share is above one half, of which `most` looks were for and `least` against."""
    return float(betainc(least + 0.5, most + 0.5, 0.5))


def described(
    thing: ChangedCells,
    stood: Votes,
    freed: Votes,
    sides: tuple[SideDrives, SideDrives],
    lattice: Lattice,
    datum: Datum,
) -> ChangedObject:
    """An object with its measures; `sides` are the drives that saw it standing, and the others."""
    cells, cell_m = thing.cells, lattice.cell_m
    certain = cells.certain
    away_m = float(np.quantile(cells.clear_m[certain], EXPLAINED))
    sigma_m = float(np.median(cells.sigma_m[certain]))
    elsewhere = math.exp(-0.5 * (away_m / max(sigma_m, 1e-9)) ** 2)
    corners = np.column_stack([cells.i, cells.j]) * cell_m
    area = shapely.union_all(shapely.box(*corners.T, *(corners + cell_m).T))
    area = area.buffer(cell_m, join_style="mitre").buffer(-cell_m, join_style="mitre")
    east_m, north_m = (corners.mean(axis=0) + 0.5 * cell_m).tolist()
    lat_deg, lon_deg, _ = datum.to_geodetic(east_m, north_m, 0.0)
    # Of the smallest rectangle around it; the heading is within (-90, 90].
    outline = shapely.get_coordinates(shapely.minimum_rotated_rectangle(area))
    way = np.diff(outline[:3], axis=0)
    lengths_m = np.hypot(*way.T)
    heading_deg = math.degrees(math.atan2(*way[lengths_m.argmax()]))
    return ChangedObject(
        id="",
        kind=thing.kind,
        area=area,
        area_m2=cells.i.size * cell_m**2,
        east_m=east_m,
        north_m=north_m,
        lat_deg=float(lat_deg),
        lon_deg=float(lon_deg),
        length_m=float(lengths_m.max()),
        width_m=float(lengths_m.min()),
        heading_deg=heading_deg - 180.0 * math.ceil((heading_deg - 90.0) / 180.0),
        confidence=probability(stood.stood, stood.freed)
        * probability(freed.freed, freed.stood)
        * (1.0 - elsewhere),
        away_m=away_m,
        sigma_m=sigma_m,
        looks_stood=stood.stood + stood.freed,
        looks_freed=freed.stood + freed.freed,
        stood=_named(sides[0], cells.stood),
        freed=_named(sides[1], cells.freed),
    )


def _named(drives: SideDrives, numbers: Int16) -> tuple[str, ...]:
    names = tuple(drives)
    return tuple(names[k] for k in np.unique(numbers))


def with_moved(objects: Sequence[ChangedObject], moved_m: float) -> list[ChangedObject]:
    """The objects, where one that vanished and one that appeared near it and is like it are one
    that moved; the nearest pairs first."""
    gone = [o for o in objects if o.kind is ChangeKind.VANISHED]
    come = [o for o in objects if o.kind is ChangeKind.APPEARED]
    pairs = sorted(
        (math.hypot(new.east_m - old.east_m, new.north_m - old.north_m), a, b)
        for a, old in enumerate(gone)
        for b, new in enumerate(come)
        if are_alike(old, new)
    )
    moved, used = list[ChangedObject](), set[int]()
    for away_m, a, b in pairs:
        old, new = gone[a], come[b]
        if away_m > moved_m or {id(old), id(new)} & used:
            continue
        used |= {id(old), id(new)}
        moved.append(
            new._replace(
                kind=ChangeKind.MOVED,
                confidence=old.confidence * new.confidence,
                from_east_m=old.east_m,
                from_north_m=old.north_m,
            )
        )
    return [o for o in objects if id(o) not in used] + moved


def are_alike(one: ChangedObject, other: ChangedObject) -> bool:
    """Whether two objects are of like size and shape: areas within a factor of 1.5, sides of their
    rectangles within 1.3 or 10 cm."""

    def near(a: float, b: float, factor: float, least: float) -> bool:
        return max(a, b) <= factor * min(a, b) or abs(a - b) <= least

    return (
        near(one.area_m2, other.area_m2, 1.5, 0.0)
        and near(one.length_m, other.length_m, 1.3, 0.1)
        and near(one.width_m, other.width_m, 1.3, 0.1)
    )
