"""What speaks against the rows that were found: doubts, told beside them.

A row is tested against noise on its own; whether all of them make a field is seen afterwards only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from scipy.spatial import cKDTree

from fieldgrid.core import Float64
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.result import Doubt, Planting
from fieldgrid.field.rows.roads import DoubtfulRoad
from fieldgrid.geometry import project

_IN_LINE = np.cos(np.radians(25.0))
_RADIUS_M, _BENT_RADIUS_M = 65.0, 30.0
"""Rows that bend less are found whole; the second, where they were looked for as bent ones."""

_SAGITTA_M = 0.4
_ROAD_M = 2.0
"""Across less than this there is no road between blocks."""

_OVERLAP_M = 4.0
_HOLES = 2.0
"""Pieces of one row are farther apart than the holes that rows are joined over, and not by much."""
_UNEVEN = 0.25
"""Lanes of one block differ by less than this share of their median."""

_STRAY_SHARE = 0.05
"""At most this share of the obstacle cells in blocks lies on no row."""

_LEAST_STRAY = 30

_SAME = 0.97
_ON_ROW_M = 0.05
"""Rows on either side of a hole end at it, and one that goes on leads over it."""


def find_doubts(
    planting: Planting,
    stray: tuple[int, float],
    roads: Sequence[DoubtfulRoad],
    crop: Crop,
    pitch_m: Sequence[float],
) -> tuple[Doubt, ...]:
    """The doubts of a planting. `stray` is the number of obstacle cells on no row, and their share,
    as `stray_cells` counts them; `roads` may cross the rows or not; `pitch_m` is how far single
    plants of each row are from each other, and empty for other plants."""
    if not planting.rows:
        return ()
    return (
        *_bent(planting, _BENT_RADIUS_M if crop.bend else _RADIUS_M),
        *_in_pieces(planting, crop),
        *_at_roads(planting, roads),
        *_uneven(planting),
        *_across(planting, pitch_m),
        *_stray(planting, *stray),
    )


def may_bend(planting: Planting) -> bool:
    """Whether rows may bend more than the patches allow in which they were straight lines."""
    return any(doubt.kind in ("bend", "pieces") for doubt in planting.doubts)


def is_better(bent: Planting, found: Planting) -> bool:
    """Whether rows have about all of the cells of others and are longer, as they are less broken,
    or about as long with fewer doubts."""
    if not bent.rows:
        return False
    cells, before = (sum(row.cells for row in some.rows) for some in (bent, found))
    length_m, before_m = (
        float(np.mean([row.length_m for row in some.rows])) for some in (bent, found)
    )
    fewer = len(bent.doubts) < len(found.doubts)
    return cells >= _SAME * before and length_m > (_SAME if fewer else 1.0) * before_m


def _bent(planting: Planting, least_m: float) -> Iterator[Doubt]:
    """Rows that bend more than those which are found whole."""
    found = {}
    for row in planting.rows:
        line = np.asarray(row.line.coords)
        sagitta_m = float(np.abs(project(line, line[[0, -1]])[1]).max())
        if sagitta_m > _SAGITTA_M:
            chord_m = float(np.hypot(*(line[-1] - line[0])))
            found[row.id] = chord_m**2 / (8.0 * sagitta_m) + 0.5 * sagitta_m
    tight = {name: radius_m for name, radius_m in found.items() if radius_m < least_m}
    if tight:
        yield Doubt(
            "bend",
            tuple(tight),
            f"{len(tight)} of {len(planting.rows)} rows bend to a radius of "
            f"{min(tight.values()):.0f} m or so; below {least_m:.0f} m rows may be in pieces, or "
            "missed",
        )


def _at_roads(planting: Planting, roads: Sequence[DoubtfulRoad]) -> Iterator[Doubt]:
    """Holes side by side of which nobody can say whether they are a road."""
    for road in roads:
        holes = shapely.MultiLineString(road.holes)
        middle = holes.centroid
        taken = (
            "they are taken for a road, at which rows end, and may lack plants"
            if road.is_road
            else "they are taken for missing plants, and may be a road"
        )
        yield Doubt(
            "road",
            tuple(row.id for row in planting.rows if row.line.distance(holes) < _ON_ROW_M),
            f"{len(road.holes)} holes lie side by side near {middle.x:.1f} m east and "
            f"{middle.y:.1f} m north: {taken}",
        )


def _in_pieces(planting: Planting, crop: Crop) -> Iterator[Doubt]:
    """Rows that end where another one goes on in line; across a road those of another block do."""
    rows = planting.rows
    if len(rows) < 2:
        return
    reach_m = 0.35 * float(np.nanmedian([*(row.spacing_m for row in rows), 2.0]))
    lines = [np.asarray(row.line.coords) for row in rows]
    tips, out = (
        np.array(both)
        for both in zip(*(_tip(end) for line in lines for end in (line[::-1], line)), strict=True)
    )
    reach_of_holes_m = _HOLES * crop.max_bridge_m
    pairs = cKDTree(tips).query_pairs(reach_of_holes_m, output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    first, second = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2].T
    same = np.array(
        [rows[a // 2].block == rows[b // 2].block for a, b in zip(first, second, strict=True)], bool
    )
    way = ((tips[second] - tips[first]) * out[first]).sum(axis=1)
    facing = (out[first] * out[second]).sum(axis=1) < -_IN_LINE
    near = (way > -_OVERLAP_M) & (way < np.where(same, reach_of_holes_m, _ROAD_M))
    # Half-way, as far as the two directions lead towards each other.
    half = 0.5 * way[:, None]
    off = (tips[first] + half * out[first]) - (tips[second] + half * out[second])
    goes_on = facing & near & (np.hypot(off[:, 0], off[:, 1]) < reach_m)
    broken = {rows[k // 2].id for k in (*first[goes_on], *second[goes_on])}
    if broken:
        yield Doubt(
            "pieces",
            tuple(row.id for row in planting.rows if row.id in broken),
            f"{len(broken)} of {len(planting.rows)} rows end where another begins in line: they "
            "may be pieces of rows that bend, or lack many plants; --spacing with their distance "
            "helps where rows are near to each other",
        )


def _tip(line: Float64) -> tuple[Float64, Float64]:
    """The last point of a line and the direction out of it, over some metres."""
    out = line[-1] - line[max(0, len(line) - 5)]
    return line[-1], out / np.hypot(*out)


def _uneven(planting: Planting) -> Iterator[Doubt]:
    """Blocks whose rows are not as far from each other as rows of a block are."""
    lines = {row.id: row.line for row in planting.rows}
    for block in planting.blocks:
        lanes = [lane for lane in planting.lanes if lane.block == block.id]
        if len(lanes) < 3:
            continue
        apart = np.array(
            [
                sum(lines[name].distance(middle) for name in lane.rows)
                for lane in lanes
                for middle in [lane.line.interpolate(0.5, normalized=True)]
            ]
        )
        usual = float(np.median(apart))
        odd = [k for k in range(len(lanes)) if abs(apart[k] - usual) > _UNEVEN * usual]
        if odd:
            yield Doubt(
                "uneven",
                tuple(dict.fromkeys(name for k in odd for name in lanes[k].rows)),
                f"{len(odd)} of {len(lanes)} lanes of {block.id} are {apart[odd].min():.2f} to "
                f"{apart[odd].max():.2f} m wide from row to row and the others "
                f"{usual:.2f} m: a row may be wrong, missed, or none",
            )


def _across(planting: Planting, pitch_m: Sequence[float]) -> Iterator[Doubt]:
    """Single plants that are farther from each other than the rows: trees on a grid stand in line
    both ways, and rows are usually the way in which they are nearer."""
    apart_m = [row.spacing_m for row in planting.rows]
    if not np.isfinite(apart_m).any() or not np.isfinite(pitch_m).any():
        return
    along_m, rows_m = float(np.nanmedian(pitch_m)), float(np.nanmedian(apart_m))
    if along_m > rows_m:
        yield Doubt(
            "across",
            tuple(row.id for row in planting.rows),
            f"plants are {along_m:.2f} m apart along the rows, and rows {rows_m:.2f} m: they may "
            f"run the other way. If so, try --spacing {0.85 * along_m:.1f}:{1.15 * along_m:.1f} "
            f"--plant-spacing {1.15 * rows_m:.1f}",
        )


def _stray(planting: Planting, cells: int, share: float) -> Iterator[Doubt]:
    """Obstacle cells among the rows that belong to none of them."""
    if share > _STRAY_SHARE and cells >= _LEAST_STRAY:
        yield Doubt(
            "stray",
            tuple(row.id for row in planting.rows),
            f"{share:.0%} of the obstacle cells in blocks are on no row: some were missed, "
            "or there is noise, by which rows may be too long; --crop and --spacing say what to "
            "look for, --obstacle-above which cells are plants",
        )
