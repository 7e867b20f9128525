"""`find_rows`: from the evidence of a map to rows, lanes, gaps, headlands, blocks and obstacles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from fieldgrid.core import ConfigError
from fieldgrid.field.rows.blocks import LaneLine, OrderedRows, block_area, lane_lines, order_rows
from fieldgrid.field.rows.chains import reference_lines
from fieldgrid.field.rows.crops import Crop, crop_named
from fieldgrid.field.rows.doubts import find_doubts, is_better, may_bend
from fieldgrid.field.rows.drives import Reach, VehicleTracks, drives_of
from fieldgrid.field.rows.ground import (
    canopies,
    find_things,
    measure_lane,
    seen_cells,
    stray_cells,
    without_specks,
)
from fieldgrid.field.rows.measuring.measure import MeasuredRow, measure_rows
from fieldgrid.field.rows.measuring.neighbours import oriented
from fieldgrid.field.rows.result import Block, Gap, Lane, Planting, Row
from fieldgrid.field.rows.roads import DoubtfulRoad, split_at_roads
from fieldgrid.field.rows.segments import find_segments, link, thinned
from fieldgrid.field.rows.surroundings import headlands_of, obstacles_of
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds, Datum, part
from fieldgrid.maps import OBSTACLE, Evidence, MapFile, MapView, fill_pinholes, open_map

if TYPE_CHECKING:
    from distributed import Client


from fieldgrid.core import Float64
from fieldgrid.field.rows.measuring.extent import plants_among, runs

# How far the plants of a row stand from each other.


_STEP_M = 0.1
_JOINED_M = 0.5
"""Cells of one plant are no farther from each other."""


def plant_pitch_m(evidence: Evidence, line: Float64, half_width_m: float) -> float:
    """The median distance of neighbouring plants along a row [n, 2]; NaN for fewer than three."""
    strip = evidence.strip(line, half_width_m, half_width_m, _STEP_M)
    cells = (strip.cells == OBSTACLE).sum(axis=1).astype(np.float64)
    if not cells.any():
        return float("nan")
    edges = np.array(plants_among(cells, runs(cells > 0.0)), dtype=np.float64) * _STEP_M
    is_next = edges[1:, 0] - edges[:-1, 1] > _JOINED_M
    starts, stops = edges[np.r_[True, is_next], 0], edges[np.r_[is_next, True], 1]
    if len(starts) < 3:
        return float("nan")
    return float(np.median(np.diff(0.5 * (starts + stops))))


MAX_CELLS = 100_000_000
"""Cells that are looked at at once; a larger map is read in cells twice as large."""

DEFAULT_HOLE_M = 0.25
DEFAULT_HEADLAND_M = 15.0
_DRIVEN_SHARE = 0.5


def find_rows(
    universal: MapFile | str | Path,
    *,
    crop: str | Crop = "vineyard",
    bounds: Bounds | None = None,
    obstacle_above: int = OBSTACLE_ABOVE,
    hole_m: float = DEFAULT_HOLE_M,
    headland_m: float = DEFAULT_HEADLAND_M,
    at: str | int | None = None,
    jobs: int | None = None,
    scheduler: str | Client | None = None,
) -> Planting:
    """The rows of a map, and what lies between and beside them.

    `crop` is a preset (vineyard, bushes, orchard, arable) or a :class:`Crop`. A cell is an obstacle
    when its density is above `obstacle_above`. Unseen ground counts as seen where no square of
    `hole_m` metres of it fits. Headlands reach `headland_m` from the plants. `at` is a session or a
    date: the map as of then. `jobs` threads read the map, all cores when not given; with a
    `scheduler`, the address of one of Dask or a client, the workers of that cluster read it. Raises
    ConfigError for what cannot be asked, ClusterError where no scheduler answers or its workers
    cannot read the map; a map without rows gives a planting without rows.
    """
    if not isinstance(universal, MapFile):
        with open_map(universal) as opened:
            return find_rows(
                opened, crop=crop, bounds=bounds, obstacle_above=obstacle_above, hole_m=hole_m,
                headland_m=headland_m, at=at, jobs=jobs, scheduler=scheduler,
            )  # fmt: skip
    for what, value_m, most_m in (("Holes", hole_m, 10.0), ("Headlands", headland_m, 1000.0)):
        if not 0.0 <= value_m <= most_m:  # NaN is outside, too
            raise ConfigError(f"{what} of {value_m:g} m are outside 0..{most_m:g} m.")
    if not 0 <= obstacle_above <= 254:
        raise ConfigError(f"A threshold of {obstacle_above} is outside 0..254; 100 is the paper's.")
    area = bounds or universal.bounds
    cell_m = universal.cell_m
    size = (area.east_m - area.west_m) * (area.north_m - area.south_m)
    while size / cell_m**2 > MAX_CELLS:
        cell_m *= 2.0
    with universal.read_blocks(
        bounds, cell_m, at=at, jobs=jobs, scheduler=scheduler, decide="density"
    ) as blocks:
        evidence = Evidence.of_blocks(blocks, obstacle_above)
        drives = drives_of(universal, at)
    return _planting(
        evidence, universal.datum, drives, crop=crop, hole_m=hole_m, headland_m=headland_m
    )


def rows_of_view(
    view: MapView, *, crop: str | Crop = "vineyard", hole_m: float = DEFAULT_HOLE_M
) -> Planting:
    """The rows of a view that was read already, as `find_rows` finds them without any drives."""
    evidence = Evidence.of(view, OBSTACLE_ABOVE)
    return _planting(
        evidence, view.datum, None, crop=crop, hole_m=hole_m, headland_m=DEFAULT_HEADLAND_M
    )


def _planting(
    evidence: Evidence,
    datum: Datum,
    drives: VehicleTracks | None,
    *,
    crop: str | Crop,
    hole_m: float,
    headland_m: float,
) -> Planting:
    crop = crop if isinstance(crop, Crop) else crop_named(crop)
    found = _with_crop(evidence, datum, drives, crop, hole_m, headland_m)
    if crop.bend or not may_bend(found):
        return found
    bent = _with_crop(evidence, datum, drives, replace(crop, bend=True), hole_m, headland_m)
    return bent if is_better(bent, found) else found


def _with_crop(
    evidence: Evidence,
    datum: Datum,
    drives: VehicleTracks | None,
    crop: Crop,
    hole_m: float,
    headland_m: float,
) -> Planting:
    measured, roads = _measured(evidence, crop)
    ordered = order_rows(measured, crop)
    reach = Reach(drives)
    rows = _rows(ordered, reach)
    lanes = lane_lines(ordered)
    filled = fill_pinholes(evidence, hole_m)
    speckless = without_specks(evidence)
    clean = fill_pinholes(speckless, hole_m)
    coarse = speckless is evidence
    bare = fill_pinholes(without_specks(evidence, of_any_size=True), hole_m) if coarse else clean
    found_lanes = _lanes(evidence, filled, clean, bare, ordered, lanes, rows, drives, reach)
    areas = {}
    for block in dict.fromkeys(ordered.block_of):
        members = [k for k, name in enumerate(ordered.block_of) if name == block]
        areas[block] = block_area(
            [ordered.rows[k].line for k in members],
            [lane.area for lane in lanes if ordered.block_of[lane.left] == block],
            [ordered.rows[k].half_width_m for k in members],
        )
    canopy = canopies(evidence, ordered.rows)
    stray = stray_cells(evidence, canopy, list(areas.values()))
    found = Planting(
        datum,
        evidence.lattice.bounds(evidence.window),
        evidence.cell_m,
        rows,
        found_lanes,
        _gaps(evidence, ordered, rows, reach),
        headlands_of(clean, ordered, areas, headland_m, reach),
        _blocks(ordered, areas, rows, found_lanes),
        obstacles_of(evidence, find_things(speckless, canopy), ordered, found_lanes, reach),
    )
    singles = ordered.rows if crop.are_single else []
    pitch_m = [plant_pitch_m(evidence, row.line, row.half_width_m) for row in singles]
    return replace(found, doubts=find_doubts(found, stray, roads, crop, pitch_m))


def _measured(evidence: Evidence, crop: Crop) -> tuple[list[MeasuredRow], list[DoubtfulRoad]]:
    if np.count_nonzero(evidence.cells == OBSTACLE) < 20:
        return [], []
    points = thinned(evidence, max(evidence.cell_m, crop.min_spacing_m / 4.0))
    segments = find_segments(points, crop)
    if not len(segments.half_m):
        return [], []
    lines = oriented(reference_lines(segments, link(segments, crop), crop))
    return split_at_roads(measure_rows(evidence, lines, crop), crop)


def _rows(ordered: OrderedRows, reach: Reach) -> tuple[Row, ...]:
    spacing: dict[int, list[float]] = {}
    for pair in ordered.pairs:
        if pair.is_lane:
            spacing.setdefault(pair.left, []).append(pair.distance_m)
            spacing.setdefault(pair.right, []).append(pair.distance_m)
    found = []
    for k, row in enumerate(ordered.rows):
        line = shapely.LineString(row.line)
        sessions, pose_sigma_m = reach.of(line)
        length = row.extent.stop_m
        unseen = sum(b - a for a, b in row.extent.unseen_m)
        found.append(
            Row(
                ordered.ids[k],
                ordered.block_of[k],
                line,
                length,
                float(np.hypot(np.sqrt((row.sigma_m**2).mean()), pose_sigma_m)),
                float(np.mean(spacing[k])) if k in spacing else float("nan"),
                row.half_width_m,
                row.sides,
                1.0 - unseen / length,
                row.cells,
                sessions,
                row.scatter_m,
                row.extent.ends_seen,
            )
        )
    return tuple(found)


def _lanes(
    evidence: Evidence,
    filled: Evidence,
    clean: Evidence,
    bare: Evidence,
    ordered: OrderedRows,
    lanes: list[LaneLine],
    rows: tuple[Row, ...],
    drives: VehicleTracks | None,
    reach: Reach,
) -> tuple[Lane, ...]:
    counts: dict[str, int] = {}
    found = []
    for lane in lanes:
        block = ordered.block_of[lane.left]
        counts[block] = counts.get(block, 0) + 1
        half = ordered.rows[lane.left].half_width_m, ordered.rows[lane.right].half_width_m
        ground = measure_lane(evidence, filled, clean, bare, lane, half)
        line = shapely.LineString(lane.line)
        driven = False
        if drives is not None and len(drives.track_m):
            shapely.prepare(lane.area)
            inside = shapely.contains_xy(lane.area, drives.track_m)
            if inside.sum() > 1:
                at = shapely.line_locate_point(line, shapely.points(drives.track_m[inside]))
                driven = bool(np.ptp(at) >= _DRIVEN_SHARE * line.length)
        known = ground.widths_m[np.isfinite(ground.widths_m)]
        found.append(
            Lane(
                f"{block}-L{counts[block]}",
                block,
                (ordered.ids[lane.left], ordered.ids[lane.right]),
                line,
                lane.area,
                float(line.length),
                float(known.min()) if len(known) else float("nan"),
                ground.widths_m,
                ground.known,
                driven,
                0.5 * (rows[lane.left].sigma_m + rows[lane.right].sigma_m),
                ground.cells,
                reach.of(lane.area)[0],
                ground.clear_m,
                ground.clear_sigma_m,
            )
        )
    return tuple(found)


def _gaps(
    evidence: Evidence, ordered: OrderedRows, rows: tuple[Row, ...], reach: Reach
) -> tuple[Gap, ...]:
    found = []
    for row, told in zip(ordered.rows, rows, strict=True):
        for number, (start, stop) in enumerate(row.extent.gaps_m, 1):
            line = shapely.LineString(part(row.line, max(start, 0.0), min(stop, row.extent.stop_m)))
            cells = seen_cells(evidence, line, row.half_width_m)
            found.append(
                Gap(f"{told.id}-G{number}", told.id, line, stop - start, told.sigma_m, cells,
                    reach.of(line)[0])
            )  # fmt: skip
    return tuple(found)


def _blocks(
    ordered: OrderedRows,
    areas: dict[str, shapely.Polygon],
    rows: tuple[Row, ...],
    lanes: tuple[Lane, ...],
) -> tuple[Block, ...]:
    found = []
    for name, area in areas.items():
        lines = [r.line for r, b in zip(ordered.rows, ordered.block_of, strict=True) if b == name]
        along = np.sum([line[-1] - line[0] for line in lines], axis=0)
        members = [row for row in rows if row.block == name]
        apart = [
            p.distance_m for p in ordered.pairs if p.is_lane and ordered.block_of[p.left] == name
        ]
        found.append(
            Block(
                name,
                area,
                len(lines),
                sum(lane.block == name for lane in lanes),
                float(np.degrees(np.arctan2(along[0], along[1]))),
                float(np.median(apart)) if apart else float("nan"),
                float(np.sqrt(np.mean([row.sigma_m**2 for row in members]))),
                sum(row.cells for row in members),
                tuple(dict.fromkeys(one for row in members for one in row.sessions)),
            )
        )
    return tuple(found)
