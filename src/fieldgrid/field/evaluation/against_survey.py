"""A map against a plain survey: what it found, what it missed, and how far off it lies.

A thing is *seen* when the map observed half of the ground within `within_m` of it, or has an
obstacle there; what was not seen is not missed. A thing is *found* when an obstacle cell lies
within `within_m` of it; a row when a row of the map runs within that distance along half of its
seen length. The error of a thing is the mean way from it to those cells; that of a row is how far
the row of the map lies off it, RMS. The same way for all things is a shift of the map. A post in a
canopy is among obstacles anyhow, and says nothing along the row, so `by_chance` is the share of the
seen ground that would count as found.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
import shapely
from scipy import ndimage

from fieldgrid.core import Bool, TruthError
from fieldgrid.field.evaluation.survey import ROW, Survey, SurveyFeature
from fieldgrid.field.rows.crops import crop_named
from fieldgrid.field.rows.find import find_rows
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds
from fieldgrid.maps import MapFile, MapView

WITHIN_M = 0.3

_STEP_M = 0.25
"""The distance between the points at which rows are compared."""

_LEAST_SHARE = 0.5
_MARGIN_M = 5.0


@dataclass(frozen=True, slots=True)
class ThingScore:
    """One surveyed thing: whether the map saw and found it, the mean way from it to what the map
    has, metres east and north, and its error; None where it was not found."""

    kind: str
    id: str
    seen: bool
    found: bool
    east_error_m: float | None
    north_error_m: float | None
    error_m: float | None


@dataclass(frozen=True, slots=True)
class KindScore:
    """What became of the things of one kind. Errors are lengths in metres, of what was found;
    `shift_east_m` and `shift_north_m` are their mean as vectors."""

    kind: str
    surveyed: int
    not_seen: int
    found: int
    missed: int
    error_median_m: float | None
    error_p95_m: float | None
    error_max_m: float | None
    shift_east_m: float | None
    shift_north_m: float | None


@dataclass(frozen=True, slots=True)
class FalseScore:
    """What the map has on the ground that the survey covers, and the survey has not: rows, and
    groups of obstacle cells that touch each other, and their area. Rows are None where the survey
    names none."""

    rows: int | None
    obstacles: int
    obstacles_m2: float


@dataclass(frozen=True, slots=True)
class SurveyScores:
    """All scores, as `fieldgrid evaluate --json` prints them. `false` is None where the survey does
    not say which ground it covers."""

    within_m: float
    by_chance: float | None
    kinds: tuple[KindScore, ...]
    false: FalseScore | None
    things: tuple[ThingScore, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain dicts and lists, ready for JSON."""
        return asdict(self)


def evaluate_survey(
    universal: MapFile, survey: Survey, *, within_m: float = WITHIN_M, crop: str = "vineyard"
) -> SurveyScores:
    """Compare a map with a survey in its plane; `crop` says which rows to look for in the map.

    Raises TruthError when the survey lies beside the map, ConfigError for a crop that is none, also
    where the survey has no rows.
    """
    planted = crop_named(crop)
    shapes = [thing.shape for thing in survey.things]
    shapes += [] if survey.area is None else [survey.area]
    west, south, east, north = shapely.total_bounds(shapes)
    whole = universal.bounds
    bounds = Bounds(
        max(west - _MARGIN_M, whole.west_m),
        max(south - _MARGIN_M, whole.south_m),
        min(east + _MARGIN_M, whole.east_m),
        min(north + _MARGIN_M, whole.north_m),
    )
    if bounds.west_m >= bounds.east_m or bounds.south_m >= bounds.north_m:
        raise TruthError(
            f"The survey ({west:.0f} to {east:.0f} m east, {south:.0f} to {north:.0f} m north of "
            f"the datum) lies beside the map ({whole.west_m:.0f} to {whole.east_m:.0f} m east, "
            f"{whole.south_m:.0f} to {whole.north_m:.0f} m north); is it of this field?"
        )
    view = universal.read(bounds)
    obstacle = view.observed & (view.density > OBSTACLE_ABOVE)
    things = [thing for thing in survey.things if thing.kind != ROW]
    scores = [_thing(thing, view, obstacle, within_m) for thing in things]
    lines: list[Any] = []
    surveyed_rows = [thing for thing in survey.things if thing.kind == ROW]
    if surveyed_rows:
        lines = [row.line for row in find_rows(universal, crop=planted).rows]
        scores += [_row(row, view, lines, within_m) for row in surveyed_rows]
    kinds = dict.fromkeys(score.kind for score in scores)
    return SurveyScores(
        within_m,
        _by_chance(view, obstacle, survey, within_m),
        tuple(_kind(kind, [one for one in scores if one.kind == kind]) for kind in kinds),
        _false(survey, view, obstacle, lines, within_m) if survey.area is not None else None,
        tuple(scores),
    )


def _thing(thing: SurveyFeature, view: MapView, obstacle: Bool, within_m: float) -> ThingScore:
    reach_m = thing.radius_m + within_m
    rows, columns = _slices(view, thing.shape, reach_m)
    east_m, north_m = view.lattice.centres(view.window)
    places = shapely.points(*np.meshgrid(east_m[columns], north_m[rows]))
    away_m = shapely.distance(places, thing.shape)
    near = away_m <= reach_m
    hit = near & obstacle[rows, columns]
    # What lies off the edge of the map was not seen.
    cells = max(int(near.sum()), round(thing.shape.buffer(reach_m).area / view.lattice.cell_m**2))
    if not hit.any():
        seen = int((near & view.observed[rows, columns]).sum()) >= _LEAST_SHARE * cells
        return ThingScore(thing.kind, thing.id, seen, False, None, None, None)
    nearest = shapely.get_point(shapely.shortest_line(thing.shape, places[hit]), 0)
    way = shapely.get_coordinates(places[hit]) - shapely.get_coordinates(nearest)
    off_m = away_m[hit]
    # Within the thing itself a cell is not off at all.
    share = np.maximum(off_m - thing.radius_m, 0.0) / np.where(off_m > 0.0, off_m, 1.0)
    east, north = (way * share[:, None]).mean(axis=0).tolist()
    return ThingScore(thing.kind, thing.id, True, True, east, north, math.hypot(east, north))


def _slices(view: MapView, shape: Any, reach_m: float) -> tuple[slice, slice]:
    """The rows and columns of a view within reach of a shape's bounds."""
    west, south, east, north = shape.bounds
    low, high = view.lattice.index(
        np.array([west - reach_m, east + reach_m]), np.array([south - reach_m, north + reach_m])
    )
    i, j = np.clip(low - view.window.i0, 0, None), np.clip(high - view.window.j0, 0, None)
    return slice(int(j[0]), int(j[1]) + 1), slice(int(i[0]), int(i[1]) + 1)


def _row(row: SurveyFeature, view: MapView, lines: list[Any], within_m: float) -> ThingScore:
    places = shapely.line_interpolate_point(
        row.shape, np.arange(_STEP_M / 2.0, row.shape.length, _STEP_M)
    )
    at = shapely.get_coordinates(places)
    side = 2 * round(within_m * view.lattice.cells_per_m) + 1
    share = cv2.blur(view.observed.astype(np.float32), (side, side), borderType=cv2.BORDER_CONSTANT)
    i, j = view.lattice.index(at[:, 0], at[:, 1])
    i, j = i - view.window.i0, j - view.window.j0
    inside = (i >= 0) & (j >= 0) & (i < view.window.width) & (j < view.window.height)
    seen = np.zeros(len(at), dtype=np.bool_)
    seen[inside] = share[j[inside], i[inside]] >= _LEAST_SHARE
    if seen.mean() < _LEAST_SHARE or not lines:
        found_seen = bool(seen.mean() >= _LEAST_SHARE)
        return ThingScore(row.kind, row.id, found_seen, False, None, None, None)
    to_lines = shapely.distance(places[seen][:, None], np.array(lines)[None, :])
    nearest = to_lines.argmin(axis=1)
    hit = to_lines.min(axis=1) <= within_m
    if hit.mean() < _LEAST_SHARE:
        return ThingScore(row.kind, row.id, True, False, None, None, None)
    ways = shapely.shortest_line(places[seen][hit], np.array(lines)[nearest[hit]])
    ends = shapely.get_coordinates(ways).reshape(-1, 2, 2)
    across = ends[:, 1] - ends[:, 0]
    east, north = across.mean(axis=0).tolist()
    error_m = math.sqrt(float((across**2).sum(axis=1).mean()))
    return ThingScore(row.kind, row.id, True, True, east, north, error_m)


def _by_chance(view: MapView, obstacle: Bool, survey: Survey, within_m: float) -> float | None:
    """The share of the seen ground, around what was surveyed, that lies as near to an obstacle as
    what counts as found."""
    hull = shapely.convex_hull(shapely.union_all([thing.shape for thing in survey.things]))
    ground = view.observed & _covered(view, hull.buffer(within_m))
    if not ground.any():
        return None
    free = np.ascontiguousarray(~obstacle, dtype=np.uint8)
    away_m = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * view.lattice.cell_m
    return float((away_m[ground] <= within_m).mean()) if obstacle.any() else 0.0


def _covered(view: MapView, area: Any) -> Bool:
    """The cells whose centres lie in an area."""
    east_m, north_m = view.lattice.centres(view.window)
    shapely.prepare(area)
    found = np.zeros(view.window.shape, dtype=np.bool_)
    for row, north in enumerate(north_m):
        found[row] = shapely.contains_xy(area, east_m, np.full(len(east_m), north))
    return found


def _false(
    survey: Survey, view: MapView, obstacle: Bool, lines: list[Any], within_m: float
) -> FalseScore:
    """What the map has on the ground that was surveyed, and the survey has not."""
    rows = [thing.shape for thing in survey.things if thing.kind == ROW]
    known = shapely.union_all(
        [thing.shape.buffer(thing.radius_m + within_m) for thing in survey.things]
    )
    label, count = ndimage.label(obstacle, structure=np.ones((3, 3)))
    excused = np.unique(label[_covered(view, known) | ~_covered(view, survey.area)])
    false = np.setdiff1d(np.arange(1, count + 1), excused)
    near = shapely.union_all(rows).buffer(within_m) if rows else None
    false_rows = [
        line
        for line in lines
        if line.intersection(survey.area).length >= _LEAST_SHARE * line.length
        and (near is None or line.intersection(near).length < _LEAST_SHARE * line.length)
    ]
    cells = int(np.isin(label, false).sum()) if len(false) else 0
    return FalseScore(len(false_rows) if rows else None, len(false), cells * view.lattice.cell_m**2)


def _kind(kind: str, scores: list[ThingScore]) -> KindScore:
    errors = np.array([s.error_m for s in scores if s.error_m is not None])
    ways = np.array(
        [(s.east_error_m, s.north_error_m) for s in scores if s.error_m is not None], dtype=float
    )
    found = len(errors)
    seen = sum(score.seen for score in scores)
    values = np.quantile(errors, [0.5, 0.95, 1.0]).tolist() if found else [None] * 3
    shift = ways.mean(axis=0).tolist() if found else [None] * 2
    return KindScore(kind, len(scores), len(scores) - seen, found, seen - found, *values, *shift)
