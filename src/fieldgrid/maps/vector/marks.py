"""Marks: what people say of a place. Keep-outs, corrections and names, kept as evidence.

A mark is a row of its own, with author and date, under the root digest of the map. Taking it out
keeps the row, so that it can be put back exactly. Which cells a mark covers is decided on the map's
own cells; `marked_cells` has the rule.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import ConfigError, MapError, quoted, shortened
from fieldgrid.geometry import MAX_DISTANCE_M, Bounds, Datum, Feature
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.geometry import Ring, decode_rings, encode_point, encode_polygon
from fieldgrid.maps.vector.styles import add_mark_style
from fieldgrid.maps.writing.subject import Subject

MAX_CORNERS, MAX_TEXT, MAX_MARKS = 2000, 500, 10_000
"""Of a mark, of each of its texts, and of a map, removed ones included."""

_LAYOUT = """
CREATE TABLE fieldgrid_mark (
    id INTEGER PRIMARY KEY NOT NULL,
    kind TEXT NOT NULL,
    geom GEOMETRY NOT NULL,
    name TEXT NOT NULL,
    note TEXT NOT NULL,
    author TEXT NOT NULL,
    created DATETIME NOT NULL,
    removed DATETIME
);
CREATE VIEW mark AS SELECT id AS fid, geom, kind, name, note, author, created
    FROM fieldgrid_mark WHERE removed IS NULL
"""

TABLE = "fieldgrid_mark"
"""Which a map has from its first mark on."""

_COLUMNS = "id, kind, geom, name, note, author, created, removed"


class MarkKind(StrEnum):
    """What a mark says of the ground that it covers."""

    KEEPOUT = "keepout"
    """No vehicle may go there, whatever stands there."""

    FREE = "free"
    """Nothing stands there, whatever the drives saw."""

    OBSTACLE = "obstacle"
    """Something stands there, whatever the drives saw."""

    PLACE = "place"
    """It has a name, and nothing else."""


class Mark(NamedTuple):
    """What somebody said of a place. `corners` are metres east and north of the datum: one is a
    point, three or more are the outline of a polygon, without the first one again. `holes` are
    parts of a polygon that it does not cover, each by its corners likewise.

    `id` is its number in the map, 0 before it has one; `created` and `removed` are times in UTC as
    in ISO 8601, `created` empty for one of now, `removed` None while it is in force.
    """

    kind: MarkKind
    corners: Ring
    name: str = ""
    note: str = ""
    author: str = ""
    created: str = ""
    removed: str | None = None
    id: int = 0
    holes: tuple[Ring, ...] = ()

    @property
    def rings(self) -> tuple[Ring, ...]:
        """The outline, and those of the holes."""
        return self.corners, *self.holes

    @property
    def active(self) -> bool:
        """Whether it is in force, or was removed."""
        return self.removed is None

    @property
    def is_point(self) -> bool:
        """Whether it is a point, and no polygon."""
        return len(self.corners) == 1

    @property
    def bounds(self) -> Bounds:
        """The smallest rectangle that holds it; of a point it is empty."""
        east, north = zip(*self.corners, strict=True)
        return Bounds(min(east), min(north), max(east), max(north))

    @property
    def geometry(self) -> Any:
        """A shapely point or polygon, metres east and north."""
        import shapely

        return (
            shapely.Point(self.corners)
            if self.is_point
            else shapely.Polygon(self.corners, self.holes)
        )

    def lies_in(self, bounds: Bounds) -> bool:
        """Whether any part of it lies in a rectangle; of a polygon not just its outline."""
        import shapely

        box, shape = shapely.box(*bounds), self.geometry
        return bool(box.intersects(shape) and (self.is_point or not box.touches(shape)))


def checked(mark: Mark) -> Mark:
    """The mark, with numbers as floats, and no corner that repeats the one before; ConfigError for
    one that cannot be."""
    for text in (mark.name, mark.note, mark.author):
        if len(text) > MAX_TEXT or not text.isprintable():
            raise ConfigError(
                f"A mark's text {quoted(text)} is too long or not printable; give up to {MAX_TEXT} "
                "printable characters."
            )
    if mark.kind is MarkKind.PLACE and not mark.name:
        raise ConfigError("A mark of kind place has no name; give it one.")
    corners, *holes = (_checked_ring(ring) for ring in mark.rings)
    count = len(corners) + sum(map(len, holes))
    if not (count == 1 or (len(corners) >= 3 and count <= MAX_CORNERS)):
        raise ConfigError(
            f"A mark of {count} corners is neither a point nor a polygon; give 1 corner, or "
            f"3 to {MAX_CORNERS}, those of holes among them."
        )
    whole = mark._replace(corners=corners, holes=tuple(holes))
    if min(map(len, holes), default=3) < 3 or not whole.geometry.is_valid:
        raise ConfigError(
            f"The outline of the mark about {corners[0][0]:.2f},{corners[0][1]:.2f}, or of a hole "
            "in it, crosses itself or another, or encloses nothing; draw it anew."
        )
    return whole


def _checked_ring(ring: Ring) -> Ring:
    corners: list[tuple[float, float]] = []
    for east, north in ring:
        if not (math.isfinite(east) and math.isfinite(north)):
            raise ConfigError(f"A mark's corner at {east}, {north} is nowhere; give metres.")
        if max(abs(east), abs(north)) > MAX_DISTANCE_M:
            raise ConfigError(
                f"A mark's corner {east:.0f} m east and {north:.0f} m north is over "
                f"{MAX_DISTANCE_M / 1000:.0f} km from the map's datum; check its coordinates."
            )
        if not corners or corners[-1] != (east, north):
            corners.append((float(east), float(north)))
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    return tuple(corners)


def read_marks(connection: sqlite3.Connection, *, removed: bool = False) -> tuple[Mark, ...]:
    """The marks in force in the order of their numbers, with `removed` those taken out too.

    Raises MapError for one that is damaged.
    """
    if not schema.has_table(connection, TABLE):
        return ()
    which = "" if removed else "WHERE removed IS NULL"
    rows = connection.execute(
        f"SELECT {_COLUMNS} FROM fieldgrid_mark {which} ORDER BY id LIMIT {MAX_MARKS + 1}"
    ).fetchall()
    if len(rows) > MAX_MARKS:
        raise MapError(f"The map is damaged: it has over {MAX_MARKS} marks. Restore a copy.")
    return tuple(_mark(row) for row in rows)


@lru_cache(maxsize=2048)  # each view of a map asks for all of them
def _mark(row: tuple[Any, ...]) -> Mark:
    number, kind, geom, *texts = row
    try:
        name, note, author, created, removed = texts
        corners, *holes = decode_rings(geom)
        mark = Mark(
            MarkKind(kind), corners, name, note, author, created, removed, holes=tuple(holes)
        )
        for moment in (created, removed):
            if moment is not None:
                datetime.fromisoformat(moment)
        if checked(mark) != mark:
            raise ValueError("its corners repeat")
    except (TypeError, ValueError, AttributeError) as error:
        raise MapError(
            f"Mark {number} of the map is damaged: {shortened(error).rstrip('.')}. Restore a copy."
        ) from error
    return mark._replace(id=int(number))


def create_marks(connection: sqlite3.Connection) -> None:
    """Lay out the table of marks, which a map has from its first one on, and the view of those in
    force, which a GIS can show and not change."""
    for statement in _LAYOUT.split(";\n"):
        connection.execute(statement)
    announce_marks(connection)


_LISTED = [
    (
        *("features", "mark", "What people said of places", None, None, None, None, schema.SRS_ID),
        *("geom", "GEOMETRY", schema.SRS_ID, 0, 0),
    )
]
"""What a GIS is told of the layer of marks, of a map that is right."""


def announce_marks(connection: sqlite3.Connection) -> None:
    """List the marks for a GIS, in place of what was listed of them."""
    for table in ("gpkg_geometry_columns", "gpkg_contents"):
        connection.execute(f"DELETE FROM {table} WHERE table_name = 'mark'")
    connection.execute("DELETE FROM gpkg_contents WHERE identifier = 'mark'")
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        "VALUES ('mark', 'features', 'mark', 'What people said of places', ?)",
        (schema.SRS_ID,),
    )
    connection.execute(
        "INSERT INTO gpkg_geometry_columns VALUES ('mark', 'geom', 'GEOMETRY', ?, 0, 0)",
        (schema.SRS_ID,),
    )


def check_marks(subject: Subject) -> Iterator[str]:
    """Every mark, and whether a GIS is told of them."""
    connection = subject.connection
    read_marks(connection, removed=True)
    listed = connection.execute(
        "SELECT data_type, identifier, description, min_x, min_y, max_x, max_y, c.srs_id, "
        "column_name, geometry_type_name, g.srs_id, z, m FROM gpkg_contents AS c "
        "JOIN gpkg_geometry_columns AS g USING (table_name) WHERE table_name = 'mark'"
    )
    if schema.has_table(connection, TABLE) and listed.fetchall() != _LISTED:
        yield "The layer mark is not listed as it should be; repair the map."


def insert_marks(connection: sqlite3.Connection, marks: Sequence[Mark]) -> tuple[int, ...]:
    """Add marks within the caller's transaction; returns their numbers."""
    if not schema.has_table(connection, TABLE):
        create_marks(connection)
        add_mark_style(connection)
    (count,) = connection.execute("SELECT count(*) FROM fieldgrid_mark").fetchone()
    if count + len(marks) > MAX_MARKS:
        raise ConfigError(
            f"{len(marks)} marks more than the {count} of the map are over {MAX_MARKS}, the most "
            "that one can have; join some of them into larger ones."
        )
    numbers = []
    for mark in marks:
        whole = checked(mark)
        geom = (
            encode_point(*whole.corners[0])
            if whole.is_point
            else encode_polygon(whole.corners, whole.holes)
        )
        (number,) = connection.execute(
            "INSERT INTO fieldgrid_mark (kind, geom, name, note, author, created) VALUES (?, ?, ?, "
            f"?, ?, coalesce(?, {schema.NOW_SQL})) RETURNING id",
            (whole.kind.value, geom, *whole[2:5], whole.created or None),
        ).fetchone()
        numbers.append(int(number))
    return tuple(numbers)


def set_removed(
    connection: sqlite3.Connection, path: Path, numbers: Iterable[int], *, removed: bool
) -> None:
    """Take marks out, or put them back, within the caller's transaction; ConfigError for one that
    is not there, or is so already."""
    known = {mark.id: mark for mark in read_marks(connection, removed=True)}
    for number in numbers:
        if number not in known:
            raise ConfigError(
                f"{path} has no mark {number}; `fieldgrid mark {path.name}` lists those it has."
            )
        if known[number].active is not removed:
            raise ConfigError(
                f"Mark {number} of {path} is "
                + ("removed already; --restore puts it back." if removed else "not removed.")
            )
        connection.execute(
            f"UPDATE fieldgrid_mark SET removed = {schema.NOW_SQL if removed else 'NULL'} "
            "WHERE id = ?",
            (number,),
        )


def features(marks: Iterable[Mark]) -> list[Feature]:
    """Marks as features, to be written in any format of these."""
    return [
        Feature(mark.kind.value, mark.geometry, {
            "id": mark.id, "name": mark.name, "note": mark.note, "author": mark.author,
            "created": mark.created, "removed": mark.removed or "",
        })
        for mark in marks
    ]  # fmt: skip


def marks_of_geojson(document: Any, datum: Datum, usual: Mapping[str, str]) -> list[Mark]:
    """The marks of a GeoJSON in longitude and latitude: points, polygons and several of these.

    The properties `kind`, `name`, `note` and `author` say what `usual` says where they are missing.
    Raises ConfigError for what is no such document, or has a mark that cannot be.
    """
    try:
        if document["type"] == "FeatureCollection":
            document = document["features"]
        found = []
        for feature in document if isinstance(document, list) else [document]:
            of = feature["geometry"] if feature["type"] == "Feature" else feature
            said = (feature.get("properties") or {}) if feature["type"] == "Feature" else {}
            name, note, author = (
                str(said.get(key) or usual.get(key, "")) for key in ("name", "note", "author")
            )
            kind = said.get("kind") or usual.get("kind")
            if kind not in set(MarkKind):
                raise ConfigError(
                    f"A feature of the GeoJSON has {quoted(kind or 'no kind')} as its kind; give "
                    f"one of {', '.join(MarkKind)}, as its property or with --kind."
                )
            shape, places = str(of["type"]), of["coordinates"]
            parts = places if shape.startswith("Multi") else [places]
            for part in parts:
                if shape.removeprefix("Multi") == "Polygon":
                    rings = part
                elif shape.removeprefix("Multi") == "Point":
                    rings = [[part]]
                else:
                    raise ConfigError(f"The GeoJSON has a {shape}; a mark is a Point or a Polygon.")
                corners, *holes = (
                    tuple(_east_north(datum, float(c[0]), float(c[1])) for c in ring)
                    for ring in rings
                )
                mark = Mark(MarkKind(kind), corners, name, note, author, holes=tuple(holes))
                found.append(checked(mark))
    except ConfigError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise ConfigError(
            f"That is no GeoJSON of points and polygons ({type(error).__name__}: "
            f"{shortened(error)}); write one with a GIS, in longitude and latitude."
        ) from error
    if not found:
        raise ConfigError("The GeoJSON has no feature; draw a point or a polygon.")
    return found


def _east_north(datum: Datum, lon_deg: float, lat_deg: float) -> tuple[float, float]:
    if not (abs(lon_deg) <= 180.0 and abs(lat_deg) <= 90.0):
        raise ConfigError(
            f"A corner of the GeoJSON at {lon_deg:g}, {lat_deg:g} is no longitude and latitude; "
            "write it in WGS 84 (EPSG:4326)."
        )
    east_m, north_m, _ = datum.to_enu(lat_deg, lon_deg, datum.height_m)
    return round(float(east_m), 4), round(float(north_m), 4)
