"""Whether a map is sound: its file, its evidence, and everything that follows from that.

A map that keeps sums of its rows, and is as it was written, is sound. Of any other, and where it is
asked for, the tiles are made again from the frames, level by level, and compared with what is
stored; so a map that passes says what its frames say. `repairing` makes them in the map itself.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

from fieldgrid.core import (
    ClusterError,
    ConfigError,
    FieldgridError,
    MapError,
    Runner,
    Threads,
    quoted,
    shortened,
)
from fieldgrid.maps.file.codec import cells_sha256
from fieldgrid.maps.file.evidence import frames_of
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.metadata import check_session, is_row_as_written
from fieldgrid.maps.file.records import SESSION_SQL, session_info
from fieldgrid.maps.file.root import check_digest
from fieldgrid.maps.file.upgrade import upgraded, upgraded_copy
from fieldgrid.maps.health.feature_check import check_announced, check_features
from fieldgrid.maps.health.file_check import (
    MAX_PROBLEMS,
    check_counts,
    check_layout,
    check_pages,
    check_references,
    check_types,
)
from fieldgrid.maps.health.row_sums import check_sums, kept_sums
from fieldgrid.maps.health.tile_check import check_pictures, check_tiles
from fieldgrid.maps.layers.registry import GROUPS
from fieldgrid.maps.vector.marks import check_marks
from fieldgrid.maps.vector.stored_features import check_stored
from fieldgrid.maps.writing.subject import PickledByArguments, Subject

Check = Callable[[Subject], Iterator[str]]
"""Looks at a part of a map, and says what is wrong with it, a sentence each."""

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
) -> HealthReport:
    """Check everything, within the caller's reading; `deep` without trust in the map's sums."""
    subject = Subject(connection, path, header, runner)
    notes = list[str]()
    has_sums = _has_sums(subject)
    if not deep and has_sums and next(problems(subject, _AS_WRITTEN), None) is None:
        return HealthReport((), (), *_counts(connection), False)
    if not deep and not has_sums:
        notes.append(
            "The map keeps no sums of its rows, or those of another state, so that everything was "
            "made again from the frames; `fieldgrid repair` adds them."
        )
    if header.has_other_tables:
        notes.append(
            f"The map is of format {header.version}: its frames and pictures were checked by "
            "upgrading a copy. `fieldgrid repair --upgrade` brings the map itself up to date."
        )
    unknown = [name for name in header.groups if name not in GROUPS]
    if unknown:
        notes.append(
            f"The tiles of {shortened(', '.join(unknown))} were not checked: no imported module "
            "knows them."
        )
    checks = _OLD if header.has_other_tables else _EVERYTHING
    found = dict.fromkeys(islice(problems(subject, checks), MAX_PROBLEMS))
    return HealthReport(tuple(found), tuple(notes), *_counts(connection), True)


def problems(subject: Subject, checks: Sequence[Check]) -> Iterator[str]:
    """What checks find, a sentence each. Where the tables hold what they cannot, the others are
    left out; and so are the sums where anything is wrong: they cannot fit."""
    found = 0
    for check in checks:
        before = found
        if check is check_sums and found:
            return
        try:
            for problem in check(subject):
                found += 1
                yield shortened(problem, LONGEST_PROBLEM)
        except ClusterError:
            raise  # which says nothing of the map
        except FieldgridError as error:
            found += 1
            yield shortened(error, LONGEST_PROBLEM)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
                raise  # of the place for temporary files, which says nothing of the map
            found += 1
            yield f"The file is damaged: {shortened(error)}."
        if check is check_types and found > before:
            return


def check_sessions(subject: Subject) -> Iterator[str]:
    """The rows of the sessions alone."""
    for row in subject.connection.execute(f"{SESSION_SQL} ORDER BY id"):
        session_info(row)
    yield from ()


def _has_sums(subject: Subject) -> bool:
    try:
        return bool(kept_sums(subject.connection))
    except (sqlite3.DatabaseError, UnicodeDecodeError):
        return False


def _counts(connection: sqlite3.Connection) -> tuple[int, int, int, int]:
    """Sessions, those that were removed, frames and pictures; 0 where they cannot be counted."""
    try:
        found = connection.execute(
            "SELECT count(*), count(removed), (SELECT count(*) FROM fieldgrid_frame), "
            "(SELECT count(*) FROM density) FROM fieldgrid_session"
        ).fetchone()
    except sqlite3.DatabaseError:
        return 0, 0, 0, 0
    sessions, removed, frames, pictures = map(int, found)
    return sessions, removed, frames, pictures


def check_evidence(subject: Subject, which: str = "") -> Iterator[str]:
    """Every frame and session, or those of `which`, against its own digest."""
    connection, path, header, runner, _ = subject
    query = f"SELECT id FROM fieldgrid_session {which} ORDER BY id"
    for (session_id,) in connection.execute(query).fetchall():
        row = connection.execute(f"{SESSION_SQL} WHERE id = ?", (session_id,)).fetchone()
        try:
            info, check = session_info(row), _FrameCheck(subject, session_id)
            numbers = range(len(check.records))
            yield from filter(None, runner.in_order(check, numbers, _FRAMES_TOGETHER))
            check_session(connection, path, header.datum, info, check.records)
        except (MapError, ConfigError) as error:
            yield str(error)


def _check_upgraded(subject: Subject) -> Iterator[str]:
    """The evidence of a map of an older format, and its pictures, which are all that is read of
    what follows from that."""
    connection, path, header, runner, _ = subject
    with closing(upgraded_copy(connection, path, header)) as copy:
        anew = Subject(copy, path, upgraded(header), Threads(runner.here))
        wrong = list(islice(chain(check_types(anew), check_evidence(anew)), MAX_PROBLEMS))
        yield from wrong
        if not wrong:
            yield from check_pictures(connection, anew.tables)


class _FrameCheck(PickledByArguments):
    """Compares frames of a session, by their numbers, with their digests."""

    def __init__(self, subject: Subject, session_id: int) -> None:
        self._of = subject, session_id
        self.records = list(frames_of(subject.connection, session_id))

    def __call__(self, number: int) -> str:
        """What is wrong with a frame; empty when it is as it was stored."""
        record = self.records[number]
        try:
            if not is_row_as_written(record) or (
                cells_sha256(record.cells()) != record.cells_sha256
            ):
                return (
                    f"Frame {quoted(record.frame_id)} of session {quoted(record.session)} is not "
                    "as it was stored."
                )
        except MapError as error:
            return str(error)
        return ""


_AS_WRITTEN: tuple[Check, ...] = (
    *(check_pages, check_references, check_counts, check_layout, check_digest, check_marks),
    *(check_stored, check_sessions, check_announced, check_sums),
)
"""What tells that a map is as its writers made it: every byte is read, nothing is made again."""

_EVERYTHING: tuple[Check, ...] = (
    *(check_pages, check_references, check_counts, check_layout, check_types, check_digest),
    *(check_marks, check_stored, check_evidence, check_announced, check_features),
    *(check_tiles, check_sums),
)

_OLD: tuple[Check, ...] = (check_pages, check_references, _check_upgraded)
"""Of a map of an older format."""
