"""The root digest: one SHA-256 of a map's settings, its plane, sessions and marks, and so of all.

It covers the digests of the sessions, which cover those of their frames, which cover their cells.
It is kept in two places, and changes with each commit; a note of it elsewhere tells whether a map
is still the one that was noted.
"""

from __future__ import annotations

import hashlib
import re
import sqlite3
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import MapError, shortened
from fieldgrid.maps.file.digest import as_json
from fieldgrid.maps.file.schema import (
    COUNTED_TABLES,
    GEOPACKAGE_TABLES,
    SRS_ID,
    UNSETTLED,
    has_table,
)
from fieldgrid.maps.vector.stored_features import FOUND_KEY
from fieldgrid.maps.writing.subject import Subject

_KEY = "root_sha256"
_OTHERS = ("data_window", UNSETTLED, FOUND_KEY, _KEY)
"""Settings that it does not cover: what follows from the tiles, and what has its own digest."""

_COUNTS_ROWS = re.compile(
    r"""CREATE TRIGGER "?\w+"? AFTER (INSERT|DELETE) ON "?\w+"? BEGIN UPDATE gpkg_ogr_contents """
    r"""SET feature_count = feature_count [+-] 1 WHERE lower\(table_name\) = lower\('\w+'\); ?END"""
)

_NAMES_OURS = re.compile(rf"fieldgrid_|\b({'|'.join(COUNTED_TABLES)})\b", re.IGNORECASE)
"""Not the tables of GeoPackage: triggers of others' layers look up in them what is announced."""

_DRIVES = "The drives in this map"


class RootDigest(NamedTuple):
    """The root digest as the map's content gives it, and as it is kept in the two places."""

    of_content: str
    in_meta: str | None
    in_contents: str | None

    @property
    def sound(self) -> bool:
        """Whether all three agree."""
        return self.of_content == self.in_meta == self.in_contents

    @property
    def trusted(self) -> bool:
        """Whether one of the two places confirms the content."""
        return self.of_content in (self.in_meta, self.in_contents)


def read_root(connection: sqlite3.Connection) -> RootDigest:
    """The root digest of a map, from its content and from where it is kept."""
    hashed = hashlib.sha256()
    for query in (
        "SELECT key, value FROM fieldgrid_meta "
        f"WHERE key NOT IN ({', '.join(repr(key) for key in _OTHERS)}) ORDER BY key",
        "SELECT srs_name, srs_id, organization, organization_coordsys_id, definition, description "
        f"FROM gpkg_spatial_ref_sys WHERE srs_id = {SRS_ID}",
        "SELECT id, name, created, removed, transform, first_time_ns, last_time_ns, frames, "
        "accepted, digest FROM fieldgrid_session ORDER BY id",
    ):
        for row in connection.execute(query):
            hashed.update(_line(*row))
        hashed.update(b"\n")
    if has_table(connection, "fieldgrid_mark"):
        for row in connection.execute("SELECT * FROM fieldgrid_mark ORDER BY id"):
            hashed.update(_line(*row))
        hashed.update(b"\n")
    contents = connection.execute(
        "SELECT description FROM gpkg_contents WHERE table_name = 'fieldgrid_session'"
    ).fetchone()
    noted = None if contents is None else str(contents[0])
    return RootDigest(
        hashed.hexdigest(),
        root_in_meta(connection),
        noted if noted is None else noted.removeprefix(f"{_DRIVES} (SHA-256 ").removesuffix(")"),
    )


def check_digest(subject: Subject) -> Iterator[str]:
    """Settings, plane and sessions against the root digest in both of its places."""
    root = read_root(subject.connection)
    if not root.trusted:
        yield (
            "The settings, the plane, the list of sessions or the marks are not as they were "
            f"written: their root digest is {root.of_content}, and {root.in_meta} was kept."
        )
    elif not root.sound:
        yield "One of the two copies of the root digest is damaged; repair the map."


def root_in_meta(connection: sqlite3.Connection) -> str | None:
    """The root digest as it is kept among the settings."""
    meta = connection.execute("SELECT value FROM fieldgrid_meta WHERE key = ?", (_KEY,)).fetchone()
    return None if meta is None else str(meta[0])


def seal(connection: sqlite3.Connection) -> None:
    """Write the root digest of what the map holds now, at the end of a transaction."""
    root = read_root(connection).of_content
    connection.execute("INSERT OR REPLACE INTO fieldgrid_meta VALUES (?, ?)", (_KEY, root))
    connection.execute(
        "UPDATE gpkg_contents SET description = ? WHERE table_name = 'fieldgrid_session'",
        (f"{_DRIVES} (SHA-256 {root})",),
    )


def meddling_triggers(connection: sqlite3.Connection) -> list[tuple[str, str]]:
    """The triggers of a map that may change what is ours, each with the table that it is of:
    those of our tables, and those of any other that name one of ours. None is made by us; those by
    which GDAL counts the rows of a layer do no harm."""
    query = "SELECT name, tbl_name, sql FROM sqlite_schema WHERE type = 'trigger'"
    return [
        (shortened(name, 60), shortened(table, 60))
        for name, table, sql in connection.execute(query)
        if (str(table).lower() in GEOPACKAGE_TABLES or _NAMES_OURS.search(str(sql)))
        and not _COUNTS_ROWS.fullmatch(" ".join(str(sql).split()))
    ]


def check_root(connection: sqlite3.Connection, path: Path) -> None:
    """Raise MapError when a map is not as it was left: a change would hide that for good. So would
    a trigger that the change sets off."""
    if found := meddling_triggers(connection):
        names = ", ".join(name for name, _ in found)
        raise MapError(
            f"{path} has triggers that change its tables behind its back ({names}). "
            "Nothing was written; drop them with another program, or restore a copy of the map."
        )
    if not read_root(connection).trusted:
        raise MapError(
            f"{path} is not as it was written: its settings, its plane, its list of sessions "
            "or its marks have changed since. Nothing was written; see `fieldgrid verify`, try "
            "`fieldgrid repair`, or restore the map from a copy."
        )


@lru_cache(maxsize=4096, typed=True)  # a commit makes the digest twice, of rows that mostly stay
def _line(*row: object) -> bytes:
    """A row as it is hashed: a blob where none belongs as its hexadecimal digits."""
    return as_json([value.hex() if isinstance(value, bytes) else value for value in row])
