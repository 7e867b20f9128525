"""Maps of older formats: read as they are, and brought to the present one by their next change.

Format 3 kept the tiles of each session, too, and all channel groups. Format 2 kept a frame's
density and mask in its own row, had no transforms and no root digest, and other tiles. Its pictures
are those of today, so a density is read from them; everything else is folded anew from the frames
until the map is upgraded.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from contextlib import suppress
from pathlib import Path

import numpy as np

from fieldgrid.core import FieldgridError, MapError, Threads, shortened
from fieldgrid.geometry import GridSpec
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.codec import BITS, EncodedChannel, cells_sha256, decode_cells
from fieldgrid.maps.file.digest import as_json, frame_digest
from fieldgrid.maps.file.header import MapHeader, check_plane, read_settings
from fieldgrid.maps.file.metadata import digest_of, find
from fieldgrid.maps.file.root import seal
from fieldgrid.maps.layers.registry import kept_groups
from fieldgrid.maps.writing.derived import rebuild
from fieldgrid.maps.writing.subject import Subject

SESSION_TILES = "fieldgrid_session_tile"
"""A table of older formats: the tiles of each session."""

_GREY = "|u1"

_VIEWS = (
    "CREATE TEMP VIEW fieldgrid_session AS SELECT *, NULL AS transform FROM main.fieldgrid_session",
    "CREATE TEMP VIEW fieldgrid_frame AS SELECT *, '' AS cells_sha256 FROM main.fieldgrid_frame",
    "CREATE TEMP VIEW fieldgrid_grid AS "
    f"SELECT id AS frame, 'density' AS channel, '{_GREY}' AS dtype, density AS data "
    "FROM main.fieldgrid_frame UNION ALL "
    f"SELECT id, 'observed', '{BITS}', observed FROM main.fieldgrid_frame",
)
"""What stands in for the tables of today while a map of format 2 is read."""

_FRAME_COLUMNS = (
    "frame_id, time_ns, east_m, north_m, up_m, heading_deg, position_sigma_m, heading_sigma_deg, "
    "speed_mps, status, reason, quality, images, images_sha256"
)
_SESSION_COLUMNS = (
    "id, name, created, removed, source, source_sha256, config, software_version, heading_source, "
    "first_time_ns, last_time_ns, frames, accepted, grid_width_m, grid_length_m, grid_cell_m, "
    "digest"
)


def read_as_is(connection: sqlite3.Connection) -> None:
    """Let a map of format 2 be read like one of today."""
    (read_only,) = connection.execute("PRAGMA query_only").fetchone()
    connection.execute("PRAGMA query_only = 0")
    for statement in _VIEWS:
        connection.execute(statement)
    connection.execute(f"PRAGMA query_only = {read_only}")


def _drop_views(connection: sqlite3.Connection) -> None:
    """Undo `read_as_is`, within the caller's transaction."""
    for name in ("fieldgrid_session", "fieldgrid_frame", "fieldgrid_grid"):
        connection.execute(f"DROP VIEW IF EXISTS temp.{name}")


def as_it_is_now(connection: sqlite3.Connection, path: Path, header: MapHeader) -> MapHeader:
    """The settings of a map that is about to be changed, whatever other programs have made of it
    since `header` was read; within the caller's transaction."""
    now = read_settings(connection, path)
    if header.has_other_tables and not now.has_other_tables:
        _drop_views(connection)
    return now


def upgraded(header: MapHeader) -> MapHeader:
    """The settings of a map once it is of the present format: then its tiles hold the core."""
    if not header.is_old:
        return header
    groups = tuple(
        name for name in kept_groups() if name in header.groups or header.has_other_tables
    )
    return header._replace(groups=groups, version=schema.FORMAT_VERSION)


def drop_what_is_folded(connection: sqlite3.Connection, header: MapHeader) -> MapHeader:
    """Bring a map of format 3 to the present one, within the caller's transaction: the tiles of
    sessions go, and those channel groups that are folded from the frames when they are read.
    Returns its settings then."""
    now = upgraded(header)
    connection.execute(f"DROP TABLE {SESSION_TILES}")
    connection.execute(
        "DELETE FROM fieldgrid_tile WHERE channels NOT IN (SELECT value FROM json_each(?)) "
        "OR zoom < (SELECT max(zoom) FROM fieldgrid_tile)",
        (json.dumps(now.groups),),
    )
    connection.execute("INSERT INTO fieldgrid_meta VALUES (?, 'later')", (schema.UNSETTLED,))
    schema.set_groups(connection, now.groups)
    _set_version(connection)
    return now


def _set_version(connection: sqlite3.Connection) -> None:
    connection.execute(
        "UPDATE fieldgrid_meta SET value = ? WHERE key = 'format_version'",
        (str(schema.FORMAT_VERSION),),
    )


def upgraded_copy(
    connection: sqlite3.Connection, path: Path, header: MapHeader
) -> sqlite3.Connection:
    """A map of format 2 as it would be after an upgrade, in a temporary database; to be closed."""
    copy = sqlite3.connect("", isolation_level=None, check_same_thread=False)
    try:
        connection.backup(copy)
        copy.execute("PRAGMA trusted_schema = OFF")
        upgrade(copy, path, header)
        seal(copy)
    except BaseException:
        copy.close()
        raise
    return copy


def upgrade(
    connection: sqlite3.Connection, path: Path, header: MapHeader, without: str | None = None
) -> None:
    """Bring a map of format 2 to the present one, within the caller's transaction. A session that
    it is `without` gets no tiles: it is about to be removed.

    What was damaged stays so: it keeps a digest that does not fit. Raises MapError when the frames
    of another active session cannot be read, or the datum is not that of the map's plane: format 2
    has nothing else that confirms it.
    """
    check_plane(connection, path, header.datum)
    _drop_views(connection)
    # Other tables keep referring to the sessions by the name that the new table takes.
    connection.execute("PRAGMA legacy_alter_table = ON")
    for name in ("session", "frame"):
        connection.execute(f"ALTER TABLE fieldgrid_{name} RENAME TO fieldgrid_{name}_2")
    connection.execute("PRAGMA legacy_alter_table = OFF")
    for name in (*schema.DERIVED_TABLES, SESSION_TILES):
        connection.execute(f"DROP TABLE {name}")
    as_before = "CREATE TABLE fieldgrid_meta", "CREATE TABLE fieldgrid_array"
    for statement in schema.OWN.split(";\n"):
        if not statement.startswith(as_before):
            connection.execute(statement)
    connection.execute(
        f"INSERT INTO fieldgrid_session ({_SESSION_COLUMNS}) "
        f"SELECT {_SESSION_COLUMNS} FROM fieldgrid_session_2 ORDER BY id"
    )
    damaged = _copy_frames(connection)
    sessions = connection.execute(
        "SELECT id, name, digest, heading_source, grid_width_m, grid_length_m, grid_cell_m "
        "FROM fieldgrid_session ORDER BY id"
    ).fetchall()
    for session_id, name, digest, heading_source, *grid in sessions:
        if session_id in damaged:
            continue
        with suppress(MapError):
            metadata = find(connection, path, header.datum, name).metadata
            before, now = (
                digest_of(metadata, grid, heading_source, [row[0] for row in rows.fetchall()])
                for rows in (
                    connection.execute(
                        f"SELECT digest FROM {table} WHERE session_id = {session_id}"
                    )
                    for table in ("fieldgrid_frame_2", "fieldgrid_frame")
                )
            )
            if before == digest:
                connection.execute(
                    "UPDATE fieldgrid_session SET digest = ? WHERE id = ?", (now, session_id)
                )
    for name in ("frame", "session"):
        connection.execute(f"DROP TABLE fieldgrid_{name}_2")
    _set_version(connection)
    removed = "UPDATE fieldgrid_session SET removed = ? WHERE name = ? AND removed IS ?"
    connection.execute(removed, ("now", without, None))
    try:
        rebuild(Subject(connection, path, upgraded(header), Threads()))
    except MapError as error:
        raise MapError(
            f"{path} cannot be brought up to date, which each change of it begins with: "
            f"{shortened(error)} Nothing was changed. Take that session out with `fieldgrid "
            "sessions --remove`, which keeps its frames, or restore a copy of the map."
        ) from error
    connection.execute(removed, (None, without, "now"))


def _copy_frames(connection: sqlite3.Connection) -> set[int]:
    """Copy the frames; returns the sessions with one that is not as it had been stored."""
    damaged = set[int]()
    rows = connection.execute(
        "SELECT f.id, f.session_id, s.grid_width_m, s.grid_length_m, s.grid_cell_m, f.digest, "
        f"{', '.join('f.' + name for name in _FRAME_COLUMNS.split(', '))} FROM fieldgrid_frame_2 "
        "AS f JOIN fieldgrid_session_2 AS s ON s.id = f.session_id ORDER BY f.id"
    ).fetchall()
    for frame, session_id, width_m, length_m, cell_m, digest, *values in rows:
        density, observed = connection.execute(
            "SELECT density, observed FROM fieldgrid_frame_2 WHERE id = ?", (frame,)
        ).fetchone()
        channels = (
            EncodedChannel("density", _GREY, density),
            EncodedChannel("observed", BITS, observed),
        )
        sha256, renewed = "", str(digest)
        with suppress(FieldgridError, TypeError, ValueError):
            cells = decode_cells(GridSpec(width_m, length_m, cell_m), channels, "frame")
            hashed = hashlib.sha256(as_json(values))
            hashed.update(cells.grid.density.tobytes())
            hashed.update(np.packbits(cells.grid.observed).tobytes())
            sha256 = cells_sha256(cells)
            if hashed.hexdigest() == digest:
                renewed = frame_digest((*values, sha256))
        if renewed == str(digest):
            damaged.add(session_id)
        connection.execute(
            f"INSERT INTO fieldgrid_frame VALUES (?, ?{', ?' * 16})",
            (frame, session_id, *values, sha256, renewed),
        )
        connection.executemany(
            "INSERT INTO fieldgrid_grid VALUES (?, ?, ?, ?)",
            [(frame, *channel) for channel in channels],
        )
    return damaged
