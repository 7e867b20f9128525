"""Whether a map is sound: its file, its evidence, and everything that follows from that.

What follows from the evidence is made anew in a temporary database and compared; so a map that
passes says what its frames say. `repair` makes it anew in the map itself.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.errors import MapError
from fieldgrid.mapfile import derived, schema
from fieldgrid.mapfile.arrays import Kind, read_arrays
from fieldgrid.mapfile.codec import decode_moments, decode_sums
from fieldgrid.mapfile.digest import frame_digest
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.png import decode_png
from fieldgrid.mapfile.records import FRAME_SQL, frame_record, frame_values
from fieldgrid.mapfile.revision import find
from fieldgrid.mapfile.session import digest_of
from fieldgrid.mapfile.tiling import TileMatrixSet

MAX_PROBLEMS = 100
"""Problems that are listed; a map with so many needs no longer list."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What `verify` found: a sentence a problem, none in a sound map, and what was looked at."""

    problems: tuple[str, ...]
    sessions: int
    removed: int
    frames: int
    tiles: int

    @property
    def sound(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


def verify(connection: sqlite3.Connection, path: Path, header: Header) -> Verdict:
    """Check everything, within the caller's reading."""
    problems: list[str] = []
    for check in (_file, _evidence, _derived):
        try:
            for problem in check(connection, path, header):
                problems.append(problem)
                if len(problems) == MAX_PROBLEMS:
                    break
        except (MapError, sqlite3.DatabaseError) as error:
            problems.append(str(error))
        if len(problems) >= MAX_PROBLEMS:
            break
    sessions, removed, frames, tiles = (
        connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        for table in (
            "fieldgrid_session",
            "fieldgrid_session WHERE removed IS NOT NULL",
            "fieldgrid_frame",
            "fieldgrid_tile",
        )
    )
    return Verdict(tuple(problems), sessions, removed, frames, tiles)


def repair(connection: sqlite3.Connection, path: Path, header: Header) -> None:
    """Make everything anew that follows from the evidence, within the caller's transaction.

    Raises MapError when the evidence itself is damaged: nothing can be made of that.
    """
    damaged = [
        *_pages(connection),
        *(line for table in schema.EVIDENCE_TABLES for line in _orphans(connection, table)),
        *_evidence(connection, path, header, "WHERE removed IS NULL"),
    ]
    if damaged:
        raise MapError(
            f"{path} cannot be repaired, because its evidence is damaged: {damaged[0]} Take "
            "that session out with `fieldgrid sessions --remove`, or restore a copy of the map."
        )
    for table in (*schema.DERIVED_TABLES, *schema.GEOMETRIES, "density"):
        connection.execute(f"DELETE FROM {table}")
    connection.execute("DELETE FROM gpkg_tile_matrix WHERE table_name = 'density'")
    connection.execute("DELETE FROM fieldgrid_meta WHERE key = 'data_window'")
    schema.announce_layers(connection, TileMatrixSet(header.lattice))
    _derive(connection, path, header, connection)


def _derive(
    source: sqlite3.Connection, path: Path, header: Header, target: sqlite3.Connection
) -> None:
    """Make the derived tables of `target` from the evidence in `source`."""
    matrices = TileMatrixSet(header.lattice)
    sessions = source.execute(
        "SELECT id, name FROM fieldgrid_session WHERE removed IS NULL ORDER BY id"
    ).fetchall()
    for session_id, name in sessions:
        track = find(source, path, header.datum, name).about.trajectory
        fold = derived.fold_evidence(source, matrices, header.transfer, session_id)
        try:
            derived.show(target, matrices, session_id, name, track, fold, evidence=source)
        finally:
            fold.close()


def _file(connection: sqlite3.Connection, path: Path, header: Header) -> Iterator[str]:
    """The file as SQLite and GeoPackage see it."""
    yield from _pages(connection)
    yield from _orphans(connection)


def _pages(connection: sqlite3.Connection) -> Iterator[str]:
    for (line,) in connection.execute(f"PRAGMA integrity_check({MAX_PROBLEMS})"):
        if line != "ok":
            yield f"The file is damaged: {line}."


def _orphans(connection: sqlite3.Connection, table: str = "") -> Iterator[str]:
    """Rows of a table, or of all, that belong to nothing."""
    check = f"foreign_key_check({table})" if table else "foreign_key_check"
    for name, row_id, parent, _ in connection.execute(f"PRAGMA {check}"):
        yield f"Row {row_id} of {name} has no counterpart in {parent}."


def _evidence(
    connection: sqlite3.Connection, path: Path, header: Header, which: str = ""
) -> Iterator[str]:
    """Every frame and session, or those of `which`, against its own digest."""
    sessions = connection.execute(
        "SELECT id, name, digest, frames, grid_width_m, grid_length_m, grid_cell_m, "
        f"heading_source FROM fieldgrid_session {which} ORDER BY id"
    ).fetchall()
    for session_id, name, digest, count, *grid, heading_source in sessions:
        frames: list[str] = []
        yield from _frames(connection, session_id, name, frames)
        if len(frames) != count:
            yield f"Session {name!r} has {len(frames)} frames, but should have {count}."
        try:
            read_arrays(connection, session_id, Kind.INPUT)
            about = find(connection, path, header.datum, name).about
        except MapError as error:
            yield str(error)
            continue
        if digest_of(about, grid, heading_source, frames) != digest:
            yield (
                f"Session {name!r} is not as it was stored: its settings, trajectory, inputs or "
                "list of frames have changed."
            )


def _frames(
    connection: sqlite3.Connection, session_id: int, name: str, digests: list[str]
) -> Iterator[str]:
    rows = connection.execute(
        f"{FRAME_SQL} WHERE f.session_id = ? ORDER BY f.id", (session_id,)
    ).fetchall()
    for row in rows:
        digests.append(str(row[-1]))
        try:
            record = frame_record(row, derived.blobs_of(connection, row[0]))
            values = frame_values(
                record.pose, record.frame_id, record.quality, record.images, record.images_sha256
            )
            if frame_digest(values, record.grid()) != record.digest:
                yield f"Frame {record.frame_id!r} of session {name!r} is not as it was stored."
        except MapError as error:
            yield f"Session {name!r}: {error}"


def _derived(connection: sqlite3.Connection, path: Path, header: Header) -> Iterator[str]:
    """Everything that follows from the evidence, against the same made anew."""
    scratch = sqlite3.connect("", isolation_level=None)
    try:
        scratch.execute("PRAGMA journal_mode = OFF")
        scratch.execute("PRAGMA synchronous = OFF")
        schema.create(scratch, header.datum, TileMatrixSet(header.lattice), header.transfer)
        _derive(connection, path, header, scratch)
        for what, query, decode in _COMPARED:
            yield from _differences(what, connection.execute(query), scratch.execute(query), decode)
    finally:
        scratch.close()


def _differences(
    what: str,
    here: Iterator[Any],
    anew: Iterator[Any],
    decode: Callable[[Any], Any] | None,
) -> Iterator[str]:
    """How the rows of two queries differ; both are in the order of their keys."""
    while True:
        mine, theirs = next(here, None), next(anew, None)
        if mine is None and theirs is None:
            return
        if mine is None or theirs is None:
            surplus = "lacks" if mine is None else "has, beyond what follows from its frames,"
            yield f"The map {surplus} {what} {_key(theirs if mine is None else mine)}."
            return
        if mine != theirs and not _same(mine, theirs, decode):
            yield f"The {what} {_key(mine)} is not what follows from the frames."
            if mine[:-1] != theirs[:-1]:
                return


def _same(mine: Any, theirs: Any, decode: Callable[[Any], Any] | None) -> bool:
    """Whether rows differ in nothing but how their last column was compressed."""
    if decode is None or mine[:-1] != theirs[:-1]:
        return False
    try:
        return bool(np.array_equal(decode(mine[-1]), decode(theirs[-1])))
    except MapError:
        return False


def _key(row: Any) -> str:
    shown = [value for value in row if not isinstance(value, bytes)][:4]
    return " ".join(str(value) for value in shown)


_COMPARED: tuple[tuple[str, str, Callable[[Any], Any] | None], ...] = (
    (
        "tile of session (its id, north, east)",
        "SELECT session_id, ty, tx, moments FROM fieldgrid_session_tile ORDER BY 1, 2, 3",
        lambda blob: decode_moments(blob, "session tile"),
    ),
    (
        "tile (level, north, east)",
        "SELECT zoom, ty, tx, sums FROM fieldgrid_tile ORDER BY 1, 2, 3",
        lambda blob: decode_sums(blob, "tile"),
    ),
    (
        "picture (level, column, row)",
        "SELECT zoom_level, tile_column, tile_row, tile_data FROM density ORDER BY 1, 2, 3",
        lambda blob: decode_png(blob, "picture"),
    ),
    (
        "zoom level",
        "SELECT zoom_level, matrix_width, matrix_height, tile_width, tile_height, pixel_x_size, "
        "pixel_y_size FROM gpkg_tile_matrix WHERE table_name = 'density' ORDER BY 1",
        None,
    ),
    (
        "tile matrix set",
        "SELECT min_x, min_y, max_x, max_y FROM gpkg_tile_matrix_set WHERE table_name = 'density'",
        None,
    ),
    ("data window", "SELECT value FROM fieldgrid_meta WHERE key = 'data_window'", None),
    (
        "extent of layer",
        "SELECT table_name, min_x, min_y, max_x, max_y, data_type FROM gpkg_contents "
        f"WHERE table_name IN ({', '.join(repr(layer) for layer in schema.LAYERS)}) ORDER BY 1",
        None,
    ),
    (
        "fix",
        "SELECT session, time_ns, status, reason, geom, up_m, heading_deg, heading_sigma_deg, "
        "position_sigma_m, speed_mps, gear, quality FROM trajectory ORDER BY session, time_ns, "
        "status, reason, geom, up_m, heading_deg",
        None,
    ),
    (
        "frame position",
        "SELECT session, frame_id, time_ns, status, reason, geom, heading_deg, quality "
        "FROM frame_position ORDER BY session, frame_id",
        None,
    ),
    (
        "footprint",
        "SELECT session, frame_id, time_ns, status, geom FROM footprint ORDER BY session, frame_id",
        None,
    ),
)


def as_dict(path: Path, verdict: Verdict) -> dict[str, Any]:
    """A verdict for JSON."""
    return {
        "map": str(path),
        "sound": verdict.sound,
        "problems": list(verdict.problems),
        "sessions": verdict.sessions,
        "removed": verdict.removed,
        "frames": verdict.frames,
        "tiles": verdict.tiles,
    }
