"""Features: those that others put into the map file, and routes from files.

Any table that the GeoPackage announces as features in the map's plane is shown; those that this
package keeps of each drive come from `drives`, and marks with the map itself.
"""

from __future__ import annotations

import math
import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import MapError
from fieldgrid.geometry import Datum
from fieldgrid.maps import schema

MOST_FEATURES = 5_000
MOST_VERTICES = 200_000

_ENVELOPE_DOUBLES = (0, 4, 6, 6, 8)
_POINT, _LINE, _POLYGON = 1, 2, 3
_MULTI = {4: _POINT, 5: _LINE, 6: _POLYGON}
"""The multi-geometries of well-known binary, and what each is made of."""


Geometry = tuple[int, list[list[tuple[float, float]]]]
"""1 point, 2 line or 3 polygon, and its rings of (E, N)."""


def read_features(connection: sqlite3.Connection) -> list[dict[str, Any]]:
    """The tables of features, each with its geometries as [kind, parts], metres of the plane."""
    tables = connection.execute(
        "SELECT c.table_name, g.column_name, c.description FROM gpkg_contents AS c "
        "JOIN gpkg_geometry_columns AS g ON g.table_name = c.table_name "
        "WHERE c.data_type = 'features' AND c.srs_id = ? ORDER BY c.table_name",
        (schema.SRS_ID,),
    ).fetchall()
    return [
        {"table": table, "says": says or "", **_read_table(connection, table, column)}
        for table, column, says in tables
        if table not in (*schema.LAYERS, "mark")
    ]


def route_table(path: Path, datum: Datum) -> dict[str, Any]:
    """A route from a file as such a table; ConfigError for one that cannot be read."""
    from fieldgrid.export import figures

    places = figures.read_route(path, datum)
    ends = np.flatnonzero(np.isnan(places[:, 0]))
    lines = [part[np.isfinite(part[:, 0])].round(3).tolist() for part in np.split(places, ends)]
    return {
        "table": path.name,
        "says": "a route",
        "features": [
            {"geometry": [(_LINE, [line])], "attributes": {"name": path.stem}} for line in lines
        ],
        "cut": False,
    }


def _read_table(connection: sqlite3.Connection, table: str, column: str) -> dict[str, Any]:
    quoted = table.replace('"', '""')
    rows = connection.execute(f'SELECT * FROM "{quoted}" LIMIT ?', (MOST_FEATURES + 1,))
    names = [description[0] for description in rows.description]
    geometry = names.index(column)
    features: list[dict[str, Any]] = []
    vertices = 0
    for row in rows:
        found = geometries(row[geometry]) if isinstance(row[geometry], bytes) else []
        vertices += sum(len(ring) for _, rings in found for ring in rings)
        if len(features) == MOST_FEATURES or vertices > MOST_VERTICES:
            return {"features": features, "cut": True}
        attributes = {
            name: value
            for name, value in zip(names, row, strict=True)
            if isinstance(value, str | int | float) and name != column
        }
        features.append({"geometry": found, "attributes": attributes})
    return {"features": features, "cut": False}


def geometries(blob: bytes) -> list[Geometry]:
    """The points, lines and polygons of a GeoPackage blob; MapError for one that is damaged."""
    try:
        if blob[:2] != b"GP":
            raise ValueError("it is no GeoPackage geometry")
        return _parsed(blob, 8 + 8 * _ENVELOPE_DOUBLES[blob[3] >> 1 & 7])[0]
    except (IndexError, struct.error, ValueError) as error:
        raise MapError(f"A feature of the map is damaged: {error}.") from error


def _parsed(blob: bytes, at: int, *, inside: bool = False) -> tuple[list[Geometry], int]:
    order = "<" if blob[at] else ">"
    (kind,) = struct.unpack_from(f"{order}I", blob, at + 1)
    dimensions = 2 + (kind // 1000 in (1, 2, 3)) + (kind // 1000 == 3)
    kind, at = kind % 1000, at + 5
    if kind in _MULTI and not inside:
        (count,) = struct.unpack_from(f"{order}I", blob, at)
        parts, at = [], at + 4
        for _ in range(_bounded(count, blob)):
            more, at = _parsed(blob, at, inside=True)
            parts += more
        return parts, at
    if kind not in (_POINT, _LINE, _POLYGON):
        raise ValueError(f"it has a geometry of kind {kind}")
    rings, count = [], 1
    if kind == _POLYGON:
        (count,) = struct.unpack_from(f"{order}I", blob, at)
        at += 4
    for _ in range(_bounded(count, blob)):
        points = 1
        if kind != _POINT:
            (points,) = struct.unpack_from(f"{order}I", blob, at)
            at += 4
        numbers = struct.unpack_from(f"{order}{_bounded(points, blob) * dimensions}d", blob, at)
        at += 8 * len(numbers)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError("a coordinate is no number")
        rings.append(list(zip(numbers[::dimensions], numbers[1::dimensions], strict=True)))
    return [(kind, rings)], at


def _bounded(count: int, blob: bytes) -> int:
    if count > len(blob):
        raise ValueError(f"it says that it has {count} parts")
    return count
