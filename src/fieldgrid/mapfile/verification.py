"""Whether a map is sound: its file, its evidence, and everything that follows from that.

The tiles are made again from the frames, level by level, and compared with what is stored; so a
map that passes says what its frames say. `repair` makes them in the map itself.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from fieldgrid.errors import MapError
from fieldgrid.layers import GROUPS
from fieldgrid.mapfile import derived, schema
from fieldgrid.mapfile.arrays import Kind, read_arrays
from fieldgrid.mapfile.codec import cells_sha256
from fieldgrid.mapfile.digest import frame_digest
from fieldgrid.mapfile.evidence import frames_of
from fieldgrid.mapfile.feature_check import check_features
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.metadata import count_frames, digest_of, find
from fieldgrid.mapfile.records import FrameRecord, frame_values
from fieldgrid.mapfile.root import check_root, read_root
from fieldgrid.mapfile.subject import Subject
from fieldgrid.mapfile.tile_check import check_tiles
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.workers import in_order

MAX_PROBLEMS = 100
"""Problems that are listed; a map with so many needs no longer list."""


@dataclass(frozen=True, slots=True)
class HealthReport:
    """What `verify` found: a sentence a problem, none in a sound map, and what was looked at.

    `notes` say what could not be looked at.
    """

    problems: tuple[str, ...]
    notes: tuple[str, ...]
    sessions: int
    removed: int
    frames: int
    tiles: int

    @property
    def sound(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


def verify(
    connection: sqlite3.Connection, path: Path, header: Header, jobs: int | None = None
) -> HealthReport:
    """Check everything, within the caller's reading."""
    subject = Subject(connection, path, header, jobs)
    problems, notes = list[str](), list[str]()
    checks: tuple[Callable[[Subject], Iterator[str]], ...]
    checks = (_file, _root, _evidence, check_features, check_tiles)
    if header.version < schema.FORMAT_VERSION:
        checks = (_pages_and_orphans,)
        notes.append(
            f"The map is of format {header.version}, whose evidence is checked when it is "
            "upgraded: run `fieldgrid repair --upgrade`."
        )
    unknown = [name for name in header.groups if name not in GROUPS]
    if unknown:
        notes.append(
            f"The tiles of {', '.join(unknown)} were not checked: no imported module knows them."
        )
    for check in checks:
        try:
            problems += islice(check(subject), MAX_PROBLEMS - len(problems))
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
            "density",
        )
    )
    return HealthReport(tuple(problems), tuple(notes), sessions, removed, frames, tiles)


def _file(subject: Subject) -> Iterator[str]:
    """The file as SQLite and GeoPackage see it, and the layout of its tables."""
    yield from _pages_and_orphans(subject)
    expected = sqlite3.connect("")
    try:
        matrices = TileMatrixSet(subject.header.lattice)
        schema.create(expected, subject.header.datum, matrices, subject.header.transfer, ())
        query = "SELECT type, name, tbl_name, sql FROM sqlite_schema WHERE sql IS NOT NULL"
        ours, known = set(subject.connection.execute(query)), set(expected.execute(query))
        tables = {row[2] for row in known}
    finally:
        expected.close()
    for kind, name, _, _ in sorted(known - ours):
        yield f"The {kind} {name} is not laid out as in a map."
    for kind, name, table, _ in sorted(ours - known):
        if kind == "trigger" and table in tables:
            yield f"A trigger {name} changes {table} behind the map's back; drop it."


def _pages_and_orphans(subject: Subject) -> Iterator[str]:
    yield from _pages(subject.connection)
    yield from _orphans(subject.connection)


def _pages(connection: sqlite3.Connection) -> Iterator[str]:
    for (line,) in connection.execute(f"PRAGMA integrity_check({MAX_PROBLEMS})"):
        if line != "ok":
            yield f"The file is damaged: {line}."


def _orphans(connection: sqlite3.Connection, table: str = "") -> Iterator[str]:
    """Rows of a table, or of all, that belong to nothing."""
    check = f"foreign_key_check({table})" if table else "foreign_key_check"
    for name, row_id, parent, _ in connection.execute(f"PRAGMA {check}"):
        yield f"Row {row_id} of {name} has no counterpart in {parent}."


def _root(subject: Subject) -> Iterator[str]:
    """Settings, plane and sessions against the root digest in both of its places."""
    root = read_root(subject.connection)
    if not root.trusted:
        yield (
            "The settings, the plane or the list of sessions are not as they were written: their "
            f"root digest is {root.of_content}, and {root.in_meta} was kept."
        )
    elif not root.sound:
        yield "One of the two copies of the root digest is damaged; repair the map."


def _evidence(subject: Subject, which: str = "") -> Iterator[str]:
    """Every frame and session, or those of `which`, against its own digest."""
    connection, path, header, jobs = subject
    sessions = connection.execute(
        "SELECT id, name, digest, frames, accepted, first_time_ns, last_time_ns, grid_width_m, "
        f"grid_length_m, grid_cell_m, heading_source FROM fieldgrid_session {which} ORDER BY id"
    ).fetchall()
    for session_id, name, digest, *counts, width_m, length_m, cell_m, heading_source in sessions:
        frames = [
            row[0]
            for row in connection.execute(
                "SELECT digest FROM fieldgrid_frame WHERE session_id = ?", (session_id,)
            )
        ]
        try:
            records = frames_of(connection, session_id)
        except MapError as error:
            yield f"Session {name!r}: {error}"
            continue
        yield from (problem for problem in in_order(_frame_problem, records, jobs) if problem)
        times_ns = [record.pose.time_ns for record in records]
        found = [
            len(records),
            sum(record.accepted for record in records),
            min(times_ns, default=None),
            max(times_ns, default=None),
        ]
        if counts != found:
            yield (
                f"Session {name!r} should have {counts[0]} frames, {counts[1]} of them used, from "
                f"{counts[2]} to {counts[3]} ns; there are {found[0]}, {found[1]} used, from "
                f"{found[2]} to {found[3]}."
            )
        try:
            read_arrays(connection, session_id, Kind.INPUT)
            metadata = find(connection, path, header.datum, name).metadata
        except MapError as error:
            yield str(error)
            continue
        if digest_of(metadata, (width_m, length_m, cell_m), heading_source, frames) != digest:
            yield (
                f"Session {name!r} is not as it was stored: its settings, trajectory, inputs or "
                "list of frames have changed."
            )


def _frame_problem(record: FrameRecord) -> str:
    """What is wrong with a frame; empty when it is as it was stored."""
    values = frame_values(
        record.driven,
        record.frame_id,
        record.quality,
        record.images,
        record.images_sha256,
        record.cells_sha256,
    )
    try:
        if frame_digest(values) != record.digest or (
            cells_sha256(record.cells()) != record.cells_sha256
        ):
            return (
                f"Frame {record.frame_id!r} of session {record.session!r} is not as it was stored."
            )
    except MapError as error:
        return f"Session {record.session!r}: {error}"
    return ""


def repair(
    connection: sqlite3.Connection, path: Path, header: Header, jobs: int | None = None
) -> tuple[str, ...]:
    """Rebuild everything that follows from the evidence, within the caller's transaction.

    Returns the channel groups that the tiles hold now. Raises MapError when the evidence itself is
    damaged: nothing can be made of that.
    """
    subject = Subject(connection, path, header, jobs)
    if not read_root(connection).trusted:
        _renew_rows(connection, header)
        check_root(connection, path)
    damaged = [
        *_pages(connection),
        *(
            line
            for name in ("frame", "array")
            for line in _orphans(connection, f"fieldgrid_{name}")
        ),
        *_evidence(subject, "WHERE removed IS NULL"),
    ]
    if damaged:
        raise MapError(
            f"{path} cannot be repaired, because its evidence is damaged: {damaged[0]} Take "
            "that session out with `fieldgrid sessions --remove`, or restore a copy of the map."
        )
    # The map's own plane is under the root digest: another PROJ may word it in another way.
    _replace_systems(connection, schema.reference_systems(header.datum)[:-1])
    derived.rebuild(connection, path, header, tuple(GROUPS), jobs)
    return tuple(GROUPS)


def _renew_rows(connection: sqlite3.Connection, header: Header) -> None:
    """Bring rows up to date that follow from others, although the root digest covers them."""
    *_, own_plane = schema.reference_systems(header.datum)
    _replace_systems(connection, [own_plane])
    for (session_id,) in connection.execute("SELECT id FROM fieldgrid_session").fetchall():
        count_frames(connection, session_id)


def _replace_systems(
    connection: sqlite3.Connection, rows: Sequence[tuple[str, int, str, int, str, str]]
) -> None:
    connection.executemany(
        "INSERT OR REPLACE INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", rows
    )
