"""Repairing a map: all that follows from its evidence is made again in it, and verified before it
counts."""

from __future__ import annotations

import sqlite3
from contextlib import ExitStack, closing
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING

from fieldgrid.core import ConfigError, MapError, Runner, Threads, shortened
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.database import connect
from fieldgrid.maps.file.header import MapHeader, read_header
from fieldgrid.maps.file.metadata import count_frames
from fieldgrid.maps.file.root import check_digest, read_root, seal
from fieldgrid.maps.file.upgrade import SESSION_TILES, drop_what_is_folded
from fieldgrid.maps.health.feature_check import check_announced, check_features
from fieldgrid.maps.health.file_check import (
    MAX_PROBLEMS,
    check_counts,
    check_layout,
    check_pages,
    check_references,
    check_types,
    damaged_pages,
    renew_file,
)
from fieldgrid.maps.health.row_sums import begin_sums, drop_sums
from fieldgrid.maps.health.verification import LONGEST_PROBLEM, Check, check_evidence, problems
from fieldgrid.maps.vector.marks import TABLE, announce_marks, check_marks, read_marks
from fieldgrid.maps.vector.stored_features import check_stored
from fieldgrid.maps.writing import derived
from fieldgrid.maps.writing.subject import Subject

if TYPE_CHECKING:
    pass


def repair(
    connection: sqlite3.Connection, path: Path, header: MapHeader, run: Runner, copy: Path | None
) -> tuple[str, ...]:
    """Rebuild everything that follows from the evidence, within the caller's transaction; the
    tiles hold the channel groups of the header.

    The workers of a cluster read `copy`, the map as it was: what a change does nobody else sees
    before it is committed. Returns what is still wrong with the evidence of sessions that were
    taken out, of which nothing is read, and with features that were found.

    Raises MapError when the evidence itself is damaged, of which nothing can be made, and when
    `verify` would still find something else; ConfigError when the workers of a cluster cannot read
    a map of this format, ClusterError when they cannot read this one.
    """
    with ExitStack() as stack:
        there = None
        if copy is not None:
            there = stack.enter_context(closing(connect(copy, copy, writable=False)))
        if there is not None and read_header(there, path).has_other_tables:
            raise ConfigError(
                f"{path} is of format {schema.OTHER_TABLES_VERSION}, which the workers of a "
                "cluster cannot fold; bring it up to date with `fieldgrid repair --upgrade`, or "
                "leave out --scheduler."
            )
        subject = Subject(connection, path, header, run, there)
        if not read_root(connection).trusted:
            # Rows that follow from others, although the root digest covers them.
            connection.execute(_REPLACE_SYSTEM, schema.reference_systems(header.datum)[-1])
            for (session_id,) in connection.execute("SELECT id FROM fieldgrid_session").fetchall():
                count_frames(connection, session_id)
            if not read_root(connection).trusted:
                raise MapError(
                    f"{path} is not as it was written, and cannot be repaired: its settings, "
                    "plane, list of sessions or marks have changed since, and nothing tells what "
                    "they were. Nothing was written; restore a copy of the map."
                )
        if schema.has_table(connection, SESSION_TILES):
            drop_what_is_folded(connection, header)
        damaged = next(
            chain(damaged_pages(connection), check_evidence(subject, "WHERE removed IS NULL")), None
        )
        if damaged is not None:
            raise MapError(
                f"{path} cannot be repaired, because its evidence is damaged: "
                f"{shortened(damaged, LONGEST_PROBLEM)} Take "
                "that session out with `fieldgrid sessions --remove`, or restore a copy of the map."
            )
        # The map's own plane is under the root digest: another PROJ may word it in another way.
        connection.executemany(_REPLACE_SYSTEM, schema.reference_systems(header.datum)[:-1])
        if schema.has_table(connection, TABLE):
            read_marks(connection, removed=True)
            announce_marks(connection)
        derived.rebuild(subject)
        renew_file(connection)
        seal(connection)
        begin_sums(connection)
        # What was made is seen here only, until it is committed.
        anew = Subject(connection, path, header, Threads(run.here))
        for problem in problems(anew, _REPAIRED):
            raise MapError(
                f"{path} cannot be repaired, because this does not follow from its evidence: "
                f"{problem} Nothing was changed; restore a copy of the map."
            )
        left = tuple(islice(dict.fromkeys(problems(subject, _REMOVED)), MAX_PROBLEMS))
        if left:  # which sums would call sound
            drop_sums(connection)
        return (*left, *check_stored(subject))


_REPAIRED: tuple[Check, ...] = (
    *(check_pages, check_counts, check_layout, check_types, check_digest, check_marks),
    *(check_announced, check_features),
)
"""What must be right in the end. Of evidence all that is needed was checked before."""

_REMOVED: tuple[Check, ...] = (
    partial(check_evidence, which="WHERE removed IS NOT NULL"),
    check_references,
)
"""What may be wrong with sessions that were removed."""


_REPLACE_SYSTEM = "INSERT OR REPLACE INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)"
