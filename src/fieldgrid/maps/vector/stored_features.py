"""Features found in a map and stored in it for a GIS, the viewer and figures.

They are tables of features, `found_` and their kind, and no evidence: a digest of their own covers
them, and the root digest of the map stays as it is. What they were found in is noted with them, so
that whoever reads them can tell whether the map has changed since.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from fieldgrid.core import MapError, shortened
from fieldgrid.geometry import Feature
from fieldgrid.maps.file.digest import of_rows
from fieldgrid.maps.file.geometry import encode_shape, shape_of
from fieldgrid.maps.file.schema import GDAL_COUNTS, SRS_ID, has_table
from fieldgrid.maps.writing.subject import Subject

FOUND_KEY = "found_sha256"
"""In fieldgrid_meta: the digest of the layers that are stored, absent where there are none."""

FOUND_PREFIX = "found_"
"""Before the kind of features, in the name of their layer."""

_SAYS = "Found by fieldgrid in the map of SHA-256 "
_TYPES = {bool: "BOOLEAN", int: "INTEGER", float: "REAL"}


class StoredFeatures(NamedTuple):
    """Features stored in a map, and the root digest of the map in which they were found."""

    features: tuple[Feature, ...]
    root_sha256: str


def keep_features(
    connection: sqlite3.Connection, features: Sequence[Feature], root_sha256: str
) -> None:
    """Put features into a map in place of those that it has, within the caller's transaction."""
    announcing = ("gpkg_geometry_columns", "gpkg_contents", GDAL_COUNTS)
    for table, _, kind in _announced(connection):
        for of in announcing:
            if has_table(connection, of):
                connection.execute(f"DELETE FROM {of} WHERE table_name = ?", (table,))
        if kind is not None:
            what = "VIEW" if kind == "view" else "TABLE"
            connection.execute(f"DROP {what} {_quoted(table)}")
    for kind in dict.fromkeys(feature.kind for feature in features):
        _keep(connection, kind, [one for one in features if one.kind == kind], root_sha256)
    connection.execute("DELETE FROM fieldgrid_meta WHERE key = ?", (FOUND_KEY,))
    if features:
        digest = _digest(connection)
        connection.execute("INSERT INTO fieldgrid_meta VALUES (?, ?)", (FOUND_KEY, digest))


def check_stored(subject: Subject) -> Iterator[str]:
    """The stored layers against their digest; those of maps of before there was one are not told
    of."""
    connection = subject.connection
    kept = connection.execute(
        "SELECT value FROM fieldgrid_meta WHERE key = ?", (FOUND_KEY,)
    ).fetchone()
    layers = _announced(connection)
    if all(kind == "table" for *_, kind in layers):
        if kept is None:
            return
        try:
            digest = _digest(connection)
        except sqlite3.DatabaseError as error:
            digest = shortened(error)
    else:
        digest = "one of them is no table"
    if kept is None or kept[0] != digest:
        names = ", ".join(shortened(table, 60) for table, *_ in layers)
        yield (
            f"The layers that `fieldgrid rows --keep` stored in the map ({names or 'none is left'})"
            " are not as they were stored; run it again."
        )


def read_stored_features(connection: sqlite3.Connection) -> StoredFeatures | None:
    """The features that a map keeps, None where it keeps none; MapError for damaged ones."""
    found: list[Feature] = []
    root = ""
    for table, says, kind in _announced(connection):
        root = says.removeprefix(_SAYS)
        try:
            if kind != "table":
                raise ValueError("it is no table")
            rows = connection.execute(f"SELECT * FROM {_quoted(table)} ORDER BY fid")
            names = [column[0] for column in rows.description][2:]
            found += [
                Feature(
                    table.removeprefix(FOUND_PREFIX),
                    shape_of(geom),
                    dict(zip(names, values, strict=True)),
                )
                for _, geom, *values in rows
            ]
        except (ValueError, TypeError) as error:
            raise MapError(
                f"The layer {table} of the map is damaged ({shortened(error)}); find it again with "
                "`fieldgrid rows --keep`."
            ) from error
    return StoredFeatures(tuple(found), root) if found else None


def _announced(connection: sqlite3.Connection) -> list[tuple[str, str, str | None]]:
    """The layers of kept features in the order they were made: name, description, and what SQLite
    has by that name, None for nothing. By both name and description: no other table is dropped,
    whatever a map says of it. A view is not to be read: its rows may have no end."""
    return connection.execute(
        "SELECT table_name, description, (SELECT "
        "CASE WHEN type = 'view' THEN type WHEN rootpage > 0 THEN type ELSE 'virtual table' END "
        "FROM sqlite_schema WHERE name = table_name COLLATE NOCASE AND type IN ('table', 'view')) "
        "FROM gpkg_contents WHERE substr(description, 1, ?) = ? AND substr(table_name, 1, ?) = ? "
        "ORDER BY rowid",
        (len(_SAYS), _SAYS, len(FOUND_PREFIX), FOUND_PREFIX),
    ).fetchall()


def _digest(connection: sqlite3.Connection) -> str:
    """Of the tables of stored features: their rows, their layout and what a GIS is told of them."""
    hashed = hashlib.sha256()
    for table, *_ in _announced(connection):
        of = f"table_name = {_literal(table)}"
        for rows in (
            _quoted(table),
            f"(SELECT sql FROM sqlite_schema WHERE type = 'table' AND name = {_literal(table)})",
            "(SELECT table_name, data_type, identifier, description, min_x, min_y, max_x, max_y, "
            f"srs_id FROM gpkg_contents WHERE {of})",
            f"(SELECT * FROM gpkg_geometry_columns WHERE {of})",
        ):
            hashed.update(b"%d\n" % of_rows(connection, rows))
    return hashed.hexdigest()


def _keep(
    connection: sqlite3.Connection, kind: str, features: Sequence[Feature], root_sha256: str
) -> None:
    table = f"{FOUND_PREFIX}{kind}"
    names = list(dict.fromkeys(name for one in features for name in one.properties))
    values = [[_plain(one.properties.get(name)) for name in names] for one in features]
    types = (
        next((_TYPES.get(type(v), "TEXT") for v in column if v is not None), "TEXT")
        for column in zip(*values, strict=True)
    )
    columns = ", ".join(
        f"{_quoted(name)} {type_}" for name, type_ in zip(names, types, strict=True)
    )
    connection.execute(
        f"CREATE TABLE {_quoted(table)} "
        f"(fid INTEGER PRIMARY KEY, geom GEOMETRY NOT NULL, {columns})"
    )
    places = ", ".join("?" * (len(names) + 1))
    listed = ", ".join(_quoted(name) for name in names)
    connection.executemany(
        f"INSERT INTO {_quoted(table)} (geom, {listed}) VALUES ({places})",
        [(encode_shape(one.geometry), *row) for one, row in zip(features, values, strict=True)],
    )
    bounds = [one.geometry.bounds for one in features]
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, min_x, min_y, "
        "max_x, max_y, srs_id) VALUES (?, 'features', ?, ?, ?, ?, ?, ?, ?)",
        (
            table,
            table,
            f"{_SAYS}{root_sha256}",
            *(pick(box[k] for box in bounds) for k, pick in enumerate((min, min, max, max))),
            SRS_ID,
        ),
    )
    shapes = {one.geometry.geom_type.upper() for one in features}
    connection.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)",
        (table, shapes.pop() if len(shapes) == 1 else "GEOMETRY", SRS_ID),
    )


def _plain(value: Any) -> Any:
    """A property as a column takes it: NULL for what is not known."""
    if isinstance(value, tuple):
        return " ".join(str(one) for one in value)
    return None if isinstance(value, float) and value != value else value


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _literal(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
