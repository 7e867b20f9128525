"""What is found of a planting, as typed values with shapely geometries.

All geometries are in metres east and north of the datum. Rows and lanes of a block run the same
way, and left and right are meant in that direction.

`sigma_m` is a standard deviation: of a row and a block that of rows across, of a gap that of its
row, of a lane half the sum of those of its rows (its middle is no worse), of an outline that of the
poses and of cells; NaN where nothing was measured. `cells` are what it rests on: obstacle cells of
a row, a block and an obstacle, seen ones of a lane and a gap, those of its area of a headland.
`sessions` are those of which a frame reaches it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from shapely import LineString, Polygon

from fieldgrid.core import Float64
from fieldgrid.geometry import Bounds, Datum


class Row(NamedTuple):
    """A row of plants: the middle of its canopy from end to end.

    `sigma_m` is the standard deviation of its place across, in the plane of the map: of the fit, of
    the side that was not seen, and of the poses. `spacing_m` is the mean distance to its
    neighbours, NaN without one. `sides` tells from how many sides it was seen, 1 to 2. `known` is
    the share of its length of which something was seen. It rests on `cells` obstacle cells;
    `sessions` are those of which a frame reaches it. `scatter_m` is how far half-metres of it lie
    off its line. `ends_seen` tells of its first and last point whether the ground beyond was seen:
    else the row may go on.
    """

    id: str
    block: str
    line: LineString
    length_m: float
    sigma_m: float
    spacing_m: float
    half_width_m: float
    sides: float
    known: float
    cells: int
    sessions: tuple[str, ...]
    scatter_m: float
    ends_seen: tuple[bool, bool] = (True, True)


class Lane(NamedTuple):
    """The ground between two neighbouring rows.

    `rows` are the left and the right one. `line` is its middle, from a quarter of a spacing inside
    one mouth to the same in the other; `area` reaches from row to row. `widths_m` is the least
    free width in each metre along the line, NaN where too little was seen to tell, and
    `free_width_m` the least of them. `known` is the share of its ground that was seen, pinholes
    not counted. `driven` says whether a vehicle went through it.

    `clear_width_m` with `clear_sigma_m` is the least width that is likely: every obstacle cell
    narrows `free_width_m`, and this one only those that are not alone; shoots of canopies that no
    cell shows are taken off. It counts where canopies were seen on both sides; NaN where nowhere.
    """

    id: str
    block: str
    rows: tuple[str, str]
    line: LineString
    area: Polygon
    length_m: float
    free_width_m: float
    widths_m: Float64
    known: float
    driven: bool
    sigma_m: float = math.nan
    cells: int = 0
    sessions: tuple[str, ...] = ()
    clear_width_m: float = math.nan
    clear_sigma_m: float = math.nan


class Gap(NamedTuple):
    """A stretch of a row in which plants are missing, and the ground was seen."""

    id: str
    row: str
    line: LineString
    length_m: float
    sigma_m: float = math.nan
    cells: int = 0
    sessions: tuple[str, ...] = ()


class Headland(NamedTuple):
    """Seen free ground before the first (`end` = start) or behind the last plants of a block."""

    id: str
    block: str
    end: str
    area: Polygon
    area_m2: float
    sigma_m: float = math.nan
    cells: int = 0
    sessions: tuple[str, ...] = ()


class Block(NamedTuple):
    """Rows that belong together. `heading_deg` is that of its rows, `spacing_m` the usual distance
    between two, NaN for a single row."""

    id: str
    area: Polygon
    rows: int
    lanes: int
    heading_deg: float
    spacing_m: float
    sigma_m: float = math.nan
    cells: int = 0
    sessions: tuple[str, ...] = ()


class Obstacle(NamedTuple):
    """Something that stands in a lane, in a gap or on a headland and is no part of a row."""

    id: str
    lane: str
    row: str
    area: Polygon
    area_m2: float
    sigma_m: float = math.nan
    cells: int = 0
    sessions: tuple[str, ...] = ()


class Doubt(NamedTuple):
    """What speaks against rows that were found: a tight `bend`, `pieces` that end where others go
    on in line, holes side by side that may be a `road` or lack plants, `uneven` distances, single
    plants that may stand in rows `across` these, `stray` obstacle cells on no row; the rows it is
    about, and what to do."""

    kind: str
    rows: tuple[str, ...]
    text: str


@dataclass(frozen=True, slots=True)
class Planting:
    """All that was found in a map, within `bounds`, from cells of `cell_m`."""

    datum: Datum
    bounds: Bounds
    cell_m: float
    rows: tuple[Row, ...]
    lanes: tuple[Lane, ...]
    gaps: tuple[Gap, ...]
    headlands: tuple[Headland, ...]
    blocks: tuple[Block, ...]
    obstacles: tuple[Obstacle, ...]
    doubts: tuple[Doubt, ...] = ()

    def lane(self, name: str) -> Lane | None:
        """A lane by its id, None when there is none."""
        return next((lane for lane in self.lanes if lane.id == name), None)
