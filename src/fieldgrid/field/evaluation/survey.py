"""A plain survey: posts, rows and obstacles that somebody measured, from GeoJSON or CSV.

GeoJSON is in longitude and latitude (RFC 7946); the property `kind` says what a feature is. A CSV
has a line for each point: `kind` and `id`, and either `lat_deg` and `lon_deg` (or `lat`, `lon`) or
`east_m` and `north_m` in the map's plane, or `wkt_m`, as `fieldgrid rows -o` writes it. Points of
one row, in their order, have one id. `radius_m` is that of a post, or half the width of a row. A
polygon of the kind `area` says what ground the survey covers: what the map has there and the survey
has not is false.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from fieldgrid.core import (
    Float64,
    TruthError,
    bounded_lines,
    check_document,
    file_bytes,
    parse_json,
    quoted,
    shortened,
)
from fieldgrid.geometry import MAX_DISTANCE_M, Datum

ROW, AREA = "row", "area"

MOST_FEATURES, MOST_CORNERS = 200_000, 1_000_000

_LATITUDE = ("latdeg", "lat", "latitude")
_LONGITUDE = ("londeg", "lon", "long", "lng", "longitude")
_EAST, _NORTH = ("eastm", "east"), ("northm", "north")
"""Columns by the letters of their names alone: "Lat [deg]" is one."""

_RADIUS = "radius_m"


class SurveyFeature(NamedTuple):
    """One thing that was surveyed: a point, line or polygon, metres east and north of the datum,
    and how far it reaches around that: the radius of a post, half the width of a row."""

    kind: str
    id: str
    shape: Any
    radius_m: float = 0.0


class Survey(NamedTuple):
    """What was surveyed, and the ground that the survey covers; None where it does not say."""

    things: tuple[SurveyFeature, ...]
    area: Any | None

    @property
    def points_m(self) -> Float64:
        """The points, and the corners of the lines and polygons [n, 2], metres east and north."""
        return np.asarray(shapely.get_coordinates([thing.shape for thing in self.things]))


def read_survey(path: str | Path, datum: Datum) -> Survey:
    """Read a survey into the plane of a datum; a problem is a TruthError that names the file."""
    path = Path(path)
    try:
        size = file_bytes(path)
        with path.open(encoding="utf-8-sig", newline="") as file:
            if path.suffix.lower() in (".geojson", ".json"):
                check_document(size, path, TruthError)
                things_of_file: Iterable[SurveyFeature] = _geojson(file.read(), datum)
            else:
                things_of_file = _csv(bounded_lines(file, path), datum)
            found = list(_few(things_of_file))
    except FileNotFoundError as error:
        raise TruthError(f"There is no survey {path}; check the name.") from error
    except (OSError, UnicodeError) as error:
        raise TruthError(f"{path} cannot be read as a survey: {error}.") from error
    except _SurveyError as error:
        raise TruthError(f"{path}: {error}") from error
    for thing in found:
        if thing.shape.is_empty or not np.isfinite(shapely.get_coordinates(thing.shape)).all():
            raise TruthError(f"{path}: {thing.kind} {quoted(thing.id)} has no place.")
        far_m = float(np.abs(shapely.bounds(thing.shape)).max())
        if far_m > MAX_DISTANCE_M:
            raise TruthError(
                f"{path}: {thing.kind} {quoted(thing.id)} lies {far_m / 1000:.0f} km from the "
                f"map's datum {datum.described()}; is it the survey of this field, in longitude "
                "and latitude?"
            )
    areas = [thing.shape for thing in found if thing.kind == AREA]
    if any(shape.geom_type not in ("Polygon", "MultiPolygon") for shape in areas):
        raise TruthError(f"{path}: an {AREA} is no polygon; draw the ground that was surveyed.")
    things = tuple(thing for thing in found if thing.kind != AREA)
    if not things:
        raise TruthError(f"{path} has no post, row or obstacle; name at least one.")
    for thing in things:
        if thing.kind == ROW and thing.shape.geom_type not in ("LineString", "MultiLineString"):
            raise TruthError(
                f"{path}: row {quoted(thing.id)} is a {thing.shape.geom_type}; a row is a line, or "
                "two points or more with one id."
            )
    return Survey(things, shapely.union_all(areas) if areas else None)


class _SurveyError(Exception):
    """What is wrong in a file, without its name."""


def _few(things: Iterable[SurveyFeature]) -> Iterator[SurveyFeature]:
    """What is in a survey, while it is not more than can be."""
    for count, thing in enumerate(things):
        if count == MOST_FEATURES:
            raise _SurveyError(f"it has over {MOST_FEATURES} features; cut it to the map.")
        yield thing


def _geojson(text: str, datum: Datum) -> Iterable[SurveyFeature]:
    if text.count("[") > MOST_CORNERS:
        raise _SurveyError(f"it has over {MOST_CORNERS} corners; simplify it.")
    try:
        for number, feature in enumerate(parse_json(text)["features"], 1):
            properties = feature.get("properties") or {}
            shape = shapely.geometry.shape(feature["geometry"])
            kind = str(properties.get("kind") or "obstacle").strip().lower()
            name = str(properties.get("id") or feature.get("id") or number)
            degrees = shapely.get_coordinates(shape)
            if (np.abs(degrees) > [180.0, 90.0]).any():
                raise _SurveyError(
                    f"{kind} {quoted(name)} has the position {degrees[0].tolist()}, which is no "
                    "longitude and latitude; export it in WGS84, as GeoJSON asks."
                )
            yield SurveyFeature(
                kind, name, _in_plane(shape, datum), _radius_m(properties.get(_RADIUS))
            )
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise _SurveyError(
            f"it is no GeoJSON FeatureCollection ({shortened(repr(error))})."
        ) from error
    except shapely.errors.ShapelyError as error:
        raise _SurveyError(f"it has a broken geometry ({error}).") from error


def _in_plane(shape: Any, datum: Datum) -> Any:
    def turned(degrees: Float64) -> Float64:
        heights = np.full(len(degrees), datum.height_m)
        east_m, north_m, _ = datum.to_enu(degrees[:, 1], degrees[:, 0], heights)
        return np.column_stack([east_m, north_m])

    return shapely.transform(shapely.force_2d(shape), turned)


def _radius_m(given: Any) -> float:
    try:
        radius_m = 0.0 if given in (None, "") else float(given)
    except (TypeError, ValueError):
        radius_m = math.nan
    if not 0.0 <= radius_m <= 100.0:  # not a number either
        raise _SurveyError(f"a {_RADIUS} of {given} cannot be; give metres, 0 to 100.")
    return radius_m


def _csv(lines: Iterable[str], datum: Datum) -> Iterable[SurveyFeature]:
    reader = csv.DictReader(lines)
    try:
        names = {re.sub("[^a-z]", "", n.lower()): n for n in reader.fieldnames or () if n}
    except csv.Error as error:
        raise _SurveyError(f"it is no CSV ({error}).") from error
    if "wktm" in names:
        columns: tuple[str, ...] = ("wktm",)
    else:
        pairs = [_first(names, _LATITUDE), _first(names, _LONGITUDE)]
        if None in pairs:
            pairs = [_first(names, _EAST), _first(names, _NORTH)]
        if None in pairs:
            raise _SurveyError(
                f"it has the columns {', '.join(names.values())[:200] or 'none'}, and no position; "
                "name them lat_deg and lon_deg, or east_m and north_m."
            )
        columns = tuple(str(name) for name in pairs)
    # A receiver's list has one more column: what the points are called, under what they are.
    others = [name for name in names if name not in (*columns, "kind", "id", "radiusm")]
    label = None if "kind" in names or "id" in names or len(others) != 1 else others[0]
    try:
        yield from _joined(
            list(_few(_point(reader.line_num, row, names, columns, label, datum) for row in reader))
        )
    except csv.Error as error:
        raise _SurveyError(f"it is no CSV after line {reader.line_num} ({error}).") from error
    except shapely.errors.ShapelyError as error:
        raise _SurveyError(f"it cannot be read ({error}).") from error


def _first(names: Mapping[str, str], wanted: Sequence[str]) -> str | None:
    return next((name for name in wanted if name in names), None)


def _point(
    number: int,
    row: Mapping[str, str | None],
    names: Mapping[str, str],
    columns: tuple[str, ...],
    label: str | None,
    datum: Datum,
) -> SurveyFeature:
    cells = {name: (row.get(original) or "").strip() for name, original in names.items()}
    kind = (cells.get("kind") or label or "post").lower()
    name = cells.get("id") or (cells[label] if label else "") or str(number)
    radius_m = _radius_m(cells.get("radiusm"))
    if columns == ("wktm",):
        return SurveyFeature(kind, name, shapely.from_wkt(cells["wktm"]), radius_m)
    try:
        first, second = (float(cells[column]) for column in columns)
        if columns[0] in _LATITUDE:
            if not (abs(first) <= 90.0 and abs(second) <= 180.0):
                raise ValueError(f"{first}, {second} is no latitude and longitude")
            shape = _in_plane(shapely.Point(second, first), datum)
        else:
            if not (math.isfinite(first) and math.isfinite(second)):
                raise ValueError(f"{first}, {second} is no place")
            shape = shapely.Point(first, second)
        return SurveyFeature(kind, name, shape, radius_m)
    except ValueError as error:
        raise _SurveyError(f"line {number} has no position ({error}).") from error


def _joined(points: Sequence[SurveyFeature]) -> Iterable[SurveyFeature]:
    """The points of each row as its line, all else as it is."""
    rows: dict[str, list[Any]] = {}
    for thing in points:
        if thing.kind in (ROW, AREA) and thing.shape.geom_type == "Point":
            rows.setdefault(f"{thing.kind} {thing.id}", []).append(thing)
        else:
            yield thing
    for corners in rows.values():
        kind, name, _, radius_m = corners[0]
        least = 2 if kind == ROW else 3
        if len(corners) < least:
            raise _SurveyError(
                f"the {kind} {quoted(name)} has {len(corners)} points; it needs {least}, with one "
                "id."
            )
        places = [thing.shape for thing in corners]
        shape = shapely.LineString(places) if kind == ROW else shapely.Polygon(places)
        yield SurveyFeature(kind, name, shape, radius_m)
