"""Where to drive next: what a plan needs and a map does not know, and a tour of lanes that sees it.

A lane sees its ground and the faces of the rows beside it. Beside a row whose neighbour was not
found there is a lane, too: half a spacing away.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import Bool, ConfigError
from fieldgrid.field.coverage.plan import Coverage, Progress, coverage_in_view
from fieldgrid.field.route.plan import planning_view, searcher_of
from fieldgrid.field.route.vehicle import Vehicle
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.find import DEFAULT_HOLE_M, find_rows
from fieldgrid.field.rows.ground import fill, polygons_of
from fieldgrid.field.rows.network import network_of
from fieldgrid.field.rows.result import Lane, Planting, Row
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds, Feature, part
from fieldgrid.maps import (
    LETHAL,
    UNSEEN,
    CostCurve,
    Evidence,
    MapFile,
    MapView,
    Mark,
    MarkKind,
    fill_pinholes,
    open_map,
)

MOST = 0.9
"""The share of the ground that is not known which the lanes of a tour see."""

_LEAST = 0.05
"""The share of a lane that is not known of which it is worth a drive."""

_INSET = 0.25
"""Of a spacing, between the end of a row and of the lane beside it."""

_SIDES = ("left", "right")
_BOTH = 1.5
"""A row that was seen from fewer sides was seen from one."""

_WHY = {
    "unseen": "no frame has seen it",
    "once": "one frame has seen it",
    "doubtful": "it is neither free nor surely an obstacle",
}
_DAY_NS = 86_400_000_000_000


class Need(NamedTuple):
    """Ground of which a plan knows too little: `kind` is unseen, once (seen by one frame), doubtful
    (neither free nor an obstacle, or a weak obstacle cell that stands alone), side (a row that was
    seen from one side) or old.

    `lane` is the lane, or the headland with its turns, in which it lies; `share` is its part of the
    free ground of that, and of a row the part of its sides that was not seen.
    """

    kind: str
    lane: str
    area: shapely.Geometry
    area_m2: float
    share: float
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class SurveyPlan:
    """What is not known, the most of it first, and a tour over lanes that see `share` of what of it
    lies in lanes."""

    needs: tuple[Need, ...]
    coverage: Coverage
    share: float


def plan_survey(
    universal: MapFile | str | Path,
    vehicle: Vehicle | None = None,
    *,
    most: float = MOST,
    older_than_days: float | None = None,
    start: tuple[float, ...] | None = None,
    goal: tuple[float, ...] | None = None,
    crop: str | Crop = "vineyard",
    cell_m: float | None = None,
    bounds: Bounds | None = None,
    curve: CostCurve | None = None,
    at: str | int | None = None,
    progress: Progress | None = None,
) -> SurveyPlan:
    """What plans for the lanes of a map need and the map does not know, and a tour to see it.

    The tour drives the fewest lanes that see `most` (a share) of what is not known in lanes, in an
    order as that of `plan_coverage`. It leads over ground that nobody has seen: rows that were
    found are obstacles to it, what else stands there is not known. Drives that ended more than
    `older_than_days` ago count as old. The rest is as in `plan_coverage`. Raises ConfigError where
    all is known, too.
    """
    if not isinstance(universal, MapFile):
        with open_map(universal) as opened:
            return plan_survey(
                opened, vehicle, most=most, older_than_days=older_than_days, start=start, goal=goal,
                crop=crop, cell_m=cell_m, bounds=bounds, curve=curve, at=at, progress=progress,
            )  # fmt: skip
    above = OBSTACLE_ABOVE if curve is None else curve.obstacle_above
    planting = find_rows(universal, crop=crop, bounds=bounds, obstacle_above=above, at=at)
    old = {}
    if older_than_days is not None:
        now = time.time_ns()
        days = {i.name: (now - (i.last_time_ns or now)) / _DAY_NS for i in universal.sessions()}
        old = {name: age for name, age in days.items() if age > older_than_days}
    view = planning_view(universal, cell_m, bounds, at)
    counted = universal.read(view.bounds, view.lattice.cell_m, layers=("count",), at=at)
    view = replace(view, layers={**view.layers, **counted.layers})
    return survey_in_view(
        view, planting, vehicle, most=most, old_days=old, start=start, goal=goal, curve=curve,
        progress=progress,
    )  # fmt: skip


def survey_in_view(
    view: MapView,
    planting: Planting,
    vehicle: Vehicle | None = None,
    *,
    most: float = MOST,
    old_days: Mapping[str, float] | None = None,
    start: tuple[float, ...] | None = None,
    goal: tuple[float, ...] | None = None,
    curve: CostCurve | None = None,
    progress: Progress | None = None,
) -> SurveyPlan:
    """Plan a survey as :func:`plan_survey` does, in a view that was read already, with its `count`,
    for the rows of a planting. `old_days` are the ages of sessions that are old."""
    if not 0.0 < most <= 1.0:
        raise ConfigError(f"A share of {most:g} of what is not known is outside 0..1.")
    if not planting.lanes and not planting.rows:
        raise ConfigError("No rows were found in the map; --crop and --spacing say which to seek.")
    beside = replace(planting, lanes=tuple(_lanes_beside(planting)))
    vehicle, old_days = vehicle or Vehicle(), old_days or {}
    needs = list(_needs(view, beside, vehicle, curve or CostCurve(), old_days))
    unknown = {
        lane.id: sum(need.area_m2 for need in needs if need.lane == lane.id)
        for lane in beside.lanes
    }
    worth = [one for one in beside.lanes if unknown[one.id] > _LEAST * one.area.area]
    worth.sort(key=lambda lane: -unknown[lane.id])
    sums = np.cumsum([unknown[lane.id] for lane in worth])
    asked = worth[: np.searchsorted(sums, most * sums[-1]) + 1] if worth else []
    needs.sort(key=lambda need: -need.area_m2)
    if not asked:
        raise ConfigError("The ground of all lanes is known; no further drive is needed.")
    coverage = coverage_in_view(
        walled(view, planting), replace(beside, lanes=tuple(asked)), vehicle,
        start=start, goal=goal, allow_unknown=True, curve=curve, progress=progress,
    )  # fmt: skip
    seen = sum(unknown[lane.lane] for lane in coverage.lanes)
    return SurveyPlan(tuple(needs), coverage, float(seen / sums[-1]))


def walled(view: MapView, planting: Planting) -> MapView:
    """A view in which the rows of a planting are obstacles, whatever of them was seen."""
    marks = [
        Mark(MarkKind.OBSTACLE, tuple(_band(row).exterior.coords[:-1])) for row in planting.rows
    ]
    return replace(view, marks=(*view.marks, *marks))


def need_features(survey: SurveyPlan) -> list[Feature]:
    """What is not known as areas, for `write_features`."""
    return [
        Feature(
            "need",
            need.area,
            {
                "id": str(number), "need": need.kind, "lane": need.lane, "area_m2": need.area_m2,
                "share": need.share, "why": need.why,
            },
        )
        for number, need in enumerate(survey.needs, 1)
    ]  # fmt: skip


def _lanes_beside(planting: Planting) -> Iterator[Lane]:
    """The lanes, as long as the longer row beside them where the other one may go on, and those
    beside rows without a neighbour."""
    rows = {row.id: row for row in planting.rows}
    spacing = {block.id: block.spacing_m for block in planting.blocks}
    bare = {(row.id, side) for row in planting.rows for side in _SIDES}
    for lane in planting.lanes:
        bare -= {(lane.rows[0], "right"), (lane.rows[1], "left")}
        left, right = (rows[name] for name in lane.rows)
        short, long = (left, right) if left.length_m < right.length_m else (right, left)
        apart_m = float(long.line.distance(short.line.interpolate(0.5, normalized=True)))
        away_m = 0.5 * (apart_m if long is right else -apart_m)
        if not all(short.ends_seen):
            whole = _lane(lane.id, lane.rows, long, away_m)
            lane = lane._replace(line=whole.line, area=whole.area, length_m=whole.length_m)
        yield lane
    for name, side in sorted(bare):
        row = rows[name]
        apart_m = row.spacing_m if math.isfinite(row.spacing_m) else spacing[row.block]
        if math.isfinite(apart_m):
            is_left = side == "left"
            pair = ("", name) if is_left else (name, "")
            yield _lane(f"{name}-{side}", pair, row, 0.5 * (apart_m if is_left else -apart_m))


def _lane(name: str, rows: tuple[str, str], row: Row, left_m: float) -> Lane:
    """The lane so far to the left of a row."""
    inset_m = min(2.0 * _INSET * abs(left_m), _INSET * row.length_m)
    beside = shapely.get_coordinates(shapely.offset_curve(row.line, left_m))
    line = shapely.LineString(part(beside, inset_m, row.length_m - inset_m))
    area, size_m = line.buffer(abs(left_m), cap_style="flat"), float(line.length)
    return Lane(name, row.block, rows, line, area, size_m, math.nan, np.zeros(0), 0.0, False)


def _band(row: Row) -> shapely.Polygon:
    return row.line.buffer(row.half_width_m, cap_style="flat")


def _needs(
    view: MapView,
    planting: Planting,
    vehicle: Vehicle,
    curve: CostCurve,
    old_days: Mapping[str, float],
) -> Iterator[Need]:
    """What is not known of the free ground of lanes and headlands, and of rows."""
    evidence = fill_pinholes(Evidence.of(view, curve.obstacle_above), DEFAULT_HOLE_M)
    seen = evidence.cells != UNSEEN
    is_said = False if view.decided is None else view.decided.flags > 0  # driven over, or marked
    worst, share, _ = view.decision(curve.least_drop_m)
    cost = curve.cost(worst, share)
    ground = searcher_of(view, vehicle, allow_unknown=True, curve=curve).ground
    margin = (len(ground.cells) - len(seen)) // 2
    weak = (ground.blocked != ground.without_weak().blocked)[margin:-margin, margin:-margin]
    masks = {
        "once": seen & (view.layer("count") <= 1) & ~np.asarray(is_said),
        "doubtful": ((cost > 0) & (cost < LETHAL)) | weak,
    }
    walls = shapely.union_all([_band(row) for row in planting.rows])
    places = {lane.id: lane.area for lane in planting.lanes}
    turns = [strip.area for strip in network_of(planting).strips if not strip.lane]
    heads = shapely.get_parts(shapely.union_all(turns))
    places |= {f"headland {number}": area for number, area in enumerate(heads, 1)}
    unseen_m2 = {}
    for name, area in places.items():
        free = area.difference(walls)
        found = {kind: _inside(evidence, mask, free) for kind, mask in masks.items()}
        found["unseen"] = free.difference(_inside(evidence, seen, free))
        unseen_m2[name] = float(found["unseen"].area)
        for kind, shape in found.items():
            yield from _need(kind, name, shape, free.area, _WHY[kind])
    for lane in planting.lanes:
        age = min((old_days.get(name, 0.0) for name in lane.sessions), default=0.0)
        if age > 0.0:
            free, why = lane.area.difference(walls), f"the last drive here was {age:.0f} days ago"
            yield from _need("old", lane.id, free, free.area, why)
    for row in planting.rows:
        lanes = [lane.id for lane in planting.lanes if row.id in lane.rows]
        if row.sides < _BOTH and lanes:
            worst_lane, band = max(lanes, key=lambda name: unseen_m2[name]), _band(row)
            both_m2 = band.area / min(2.0 - row.sides, 1.0)
            yield from _need("side", worst_lane, band, both_m2, f"{row.id} was seen from one side")


def _need(
    kind: str, name: str, shape: shapely.Geometry, whole_m2: float, why: str
) -> Iterator[Need]:
    """What of a shape is larger than a pinhole, if anything is."""
    parts = [one for one in shapely.get_parts(shape) if one.area >= DEFAULT_HOLE_M**2]
    if parts:
        area = shapely.union_all(parts)
        yield Need(kind, name, area, float(area.area), min(float(area.area / whole_m2), 1.0), why)


def _inside(evidence: Evidence, mask: Bool, area: shapely.Geometry) -> shapely.Geometry:
    """The part of an area whose cells are in a mask."""
    within = evidence.lattice.window(Bounds(*area.bounds)).intersect(evidence.window)
    if within is None:
        return shapely.Polygon()
    inner = Evidence(evidence.lattice, within, np.zeros(within.shape, np.uint8))
    fill(inner.cells, inner, area)
    inner.cells[:] &= mask[evidence.window.slices_of(within)]
    shapes = polygons_of(inner, inner.cells, evidence.cell_m**2)
    return shapely.union_all(shapes).intersection(area)
