"""Whether a map is sound: its file, its evidence, and everything that follows from that.

A map that keeps sums of its rows, and is as it was written, is sound. Of any other, and where it is
asked for, the tiles are made again from the frames, level by level, and compared with what is
stored; so a map that passes says what its frames say. `repairing` makes them in the map itself.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path

from fieldgrid.core import ClusterError, FieldgridError, MapError, Runner, Threads, shortened
from fieldgrid.maps.file.arrays import ArrayKind, read_arrays
from fieldgrid.maps.file.codec import cells_sha256
from fieldgrid.maps.file.database import alone
from fieldgrid.maps.file.digest import frame_digest
from fieldgrid.maps.file.evidence import frames_of
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.metadata import digest_of, find
from fieldgrid.maps.file.records import SESSION_SQL, frame_values, session_info
from fieldgrid.maps.file.root import check_digest
from fieldgrid.maps.file.upgrade import upgraded, upgraded_copy
from fieldgrid.maps.health.feature_check import check_announced, check_features
from fieldgrid.maps.health.file_check import (
    MAX_PROBLEMS,
    check_file,
    check_layout,
    check_pages,
    check_types,
    orphans,
)
from fieldgrid.maps.health.row_digest import of_rows
from fieldgrid.maps.health.row_sums import SUMMED_TABLES, fits, kept_sums
from fieldgrid.maps.health.shared_sums import sharing_sums
from fieldgrid.maps.health.tile_check import check_extent, check_tiles
from fieldgrid.maps.layers.registry import GROUPS
from fieldgrid.maps.vector.marks import check_marks
from fieldgrid.maps.vector.stored_features import check_stored
from fieldgrid.maps.writing.subject import PickledByArguments, Subject

# Whether a map is what its writers made of it: every byte is read, nothing is made again.
#
# The sums of its rows tell; with them go the file itself, the root digest, and what follows from
# little. What is wrong is found out by `verification`, from the frames.


_LONG = ("fieldgrid_grid", "fieldgrid_tile")
"""The tables that take most of the time; begun first, so that no process is left with one."""


def is_as_written(subject: Subject) -> bool:
    """Whether a map that keeps sums is what its writers made of it."""
    connection = subject.connection
    tables = (*_LONG, *(table for table in SUMMED_TABLES if table not in _LONG))
    try:
        kept = kept_sums(connection)
        if not kept:
            return False
        # While texts are read as bytes, no other thread may read them.
        with alone(connection), sharing_sums(connection, tables, subject.runner.here) as sums:
            return all(next(check(subject), None) is None for check in _CHECKS) and all(
                fits(kept.get(table), total) for table, total in sums.finish().items()
            )
    except (FieldgridError, sqlite3.DatabaseError, UnicodeDecodeError):
        return False


def check_sums(subject: Subject) -> Iterator[str]:
    """The sums of all tables, where they are those of the map as it is."""
    kept = kept_sums(subject.connection)
    for table in SUMMED_TABLES if kept else ():
        if not fits(kept.get(table), of_rows(subject.connection, table)):
            yield (
                f"The rows of {table} are not those that were written, although they fit the "
                "frames, or the sum that is kept of them is damaged; repair the map."
            )


def _check_references(subject: Subject) -> Iterator[str]:
    """References of rows that no sum is kept of; those of the others are as they were written."""
    query = "SELECT name FROM sqlite_schema WHERE type = 'table'"
    for (table,) in subject.connection.execute(query).fetchall():
        if table not in SUMMED_TABLES:
            yield from orphans(subject.connection, f"'{table.replace(chr(39), chr(39) * 2)}'")


def _check_sessions(subject: Subject) -> Iterator[str]:
    for row in subject.connection.execute(f"{SESSION_SQL} ORDER BY id"):
        session_info(row)
    yield from ()


_CHECKS: tuple[Callable[[Subject], Iterator[str]], ...] = (
    check_pages,
    _check_references,
    check_layout,
    check_digest,
    check_marks,
    check_stored,
    _check_sessions,
    check_announced,
    check_extent,
)


LONGEST_PROBLEM = 1000

_FRAMES_TOGETHER = 64


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
    deep: bool
    """Whether everything was made again from the frames."""

    @property
    def sound(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


def verify(
    connection: sqlite3.Connection,
    path: Path,
    header: MapHeader,
    runner: Runner,
    *,
    deep: bool = False,
    rebuilt: bool = False,
) -> HealthReport:
    """Check everything, within the caller's reading; `deep` without trust in the map's sums.

    Where a map was `rebuilt` in the same transaction, of evidence that was checked, that is not
    read again, nor folded once more: the tiles of sessions are what was made of it just now, and
    so are the sums.
    """
    subject = Subject(connection, path, header, runner)
    problems, notes = list[str](), list[str]()
    if not (deep or header.has_other_tables):
        if is_as_written(subject):
            return HealthReport((), (), *_counts(connection), False)
        notes += _why_deep(connection)
    checks: tuple[Callable[[Subject], Iterator[str]], ...] = (
        *(check_file, check_layout, check_types, check_digest, check_marks, check_stored),
        *(() if rebuilt else (check_evidence,)),
        *(check_features, partial(check_tiles, folded=rebuilt)),
        *(() if rebuilt else (check_sums,)),
    )
    if header.has_other_tables:
        checks = (check_file, check_features, _upgraded)
        notes.append(
            f"The map is of format {header.version}: its frames and pictures were checked by "
            "upgrading a copy. `fieldgrid repair --upgrade` brings the map itself up to date."
        )
    unknown = [name for name in header.groups if name not in GROUPS]
    if unknown:
        notes.append(
            f"The tiles of {', '.join(unknown)} were not checked: no imported module knows them."
        )
    for check in checks:
        before = len(problems)
        if check is check_sums and before:
            break  # they cannot fit, which says nothing more
        try:
            problems += islice(check(subject), MAX_PROBLEMS - len(problems))
        except ClusterError:
            raise  # which says nothing of the map
        except FieldgridError as error:
            problems.append(str(error))
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            problems.append(f"The file is damaged: {shortened(error)}.")
        if check is check_types and len(problems) > before:
            notes.append("Nothing else was checked: the tables hold what they cannot.")
            break
        if len(problems) >= MAX_PROBLEMS:
            break
    said = dict.fromkeys(shortened(problem, LONGEST_PROBLEM) for problem in problems)
    return HealthReport(tuple(said), tuple(notes), *_counts(connection), True)


def _why_deep(connection: sqlite3.Connection) -> Iterator[str]:
    """Why a map could not be verified by its sums, where it has none."""
    try:
        if kept_sums(connection):
            return
    except (sqlite3.DatabaseError, UnicodeDecodeError):
        return
    yield (
        "The map keeps no sums of its rows, or those of another state, so that everything was "
        "made again from the frames; `fieldgrid repair` adds them."
    )


def _counts(connection: sqlite3.Connection) -> tuple[int, int, int, int]:
    """Sessions, those that were removed, frames and pictures."""
    return (
        _counted(connection, "fieldgrid_session"),
        _counted(connection, "fieldgrid_session WHERE removed IS NOT NULL"),
        _counted(connection, "fieldgrid_frame"),
        _counted(connection, "density"),
    )


def _counted(connection: sqlite3.Connection, table: str) -> int:
    """The rows of a table; 0 where it is so damaged that they cannot be counted."""
    try:
        return int(connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0])
    except sqlite3.DatabaseError:
        return 0


def check_evidence(subject: Subject, which: str = "") -> Iterator[str]:
    """Every frame and session, or those of `which`, against its own digest."""
    connection, path, header, runner, _ = subject
    sessions = connection.execute(
        "SELECT id, name, digest, frames, accepted, first_time_ns, last_time_ns, grid_width_m, "
        f"grid_length_m, grid_cell_m, heading_source FROM fieldgrid_session {which} ORDER BY id"
    ).fetchall()
    for session_id, name, digest, *counts, width_m, length_m, cell_m, heading_source in sessions:
        try:
            session_info(
                connection.execute(f"{SESSION_SQL} WHERE id = ?", (session_id,)).fetchone()
            )
            check = _FrameCheck(subject, session_id)
        except MapError as error:
            yield str(error)
            continue
        records = check.records
        problems = runner.in_order(check, range(len(records)), _FRAMES_TOGETHER)
        yield from (problem for problem in problems if problem)
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
            read_arrays(connection, session_id, ArrayKind.INPUT)
            metadata = find(connection, path, header.datum, name).metadata
        except FieldgridError as error:
            yield str(error)
            continue
        frames = [record.digest for record in records]
        if digest_of(metadata, (width_m, length_m, cell_m), heading_source, frames) != digest:
            yield (
                f"Session {name!r} is not as it was stored: its settings, trajectory, inputs or "
                "list of frames have changed."
            )


def _upgraded(subject: Subject) -> Iterator[str]:
    """The evidence of a map of an older format, and its pictures, which are all that is read of
    what follows from that."""
    connection, path, header, runner, _ = subject
    with closing(upgraded_copy(connection, path, header)) as copy:
        anew = Subject(copy, path, upgraded(header), Threads(runner.here))
        wrong = list(islice(chain(check_types(anew), check_evidence(anew)), MAX_PROBLEMS))
        yield from wrong
        if not wrong:
            # The pictures are those of today: put into the copy, they must be those of its tiles.
            copy.execute("DELETE FROM density")
            copy.executemany(
                "INSERT INTO density VALUES (?, ?, ?, ?, ?)",
                connection.execute("SELECT * FROM density"),
            )
            yield from check_tiles(anew)


class _FrameCheck(PickledByArguments):
    """Compares frames of a session, by their numbers, with their digests."""

    def __init__(self, subject: Subject, session_id: int) -> None:
        self._of = subject, session_id
        self.records = frames_of(subject.connection, session_id)

    def __call__(self, number: int) -> str:
        """What is wrong with a frame; empty when it is as it was stored."""
        record = self.records[number]
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
                    f"Frame {record.frame_id!r} of session {record.session!r} is not as it was "
                    "stored."
                )
        except MapError as error:
            return f"Session {record.session!r}: {error}"
        return ""
