"""What a map keeps of a session beside its frames: its own row, its trajectory, its inputs."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import ConfigError, MapError, Quality, quoted, shortened
from fieldgrid.geometry import Datum, Trajectory
from fieldgrid.maps.file.arrays import (
    Array,
    ArrayKind,
    array_rows,
    read_arrays,
    trajectory_arrays,
    trajectory_of,
)
from fieldgrid.maps.file.digest import frame_digest, session_digest
from fieldgrid.maps.file.records import (
    MAX_DOCUMENT,
    MAX_NAME,
    MAX_TEXT,
    FrameRecord,
    SessionInfo,
    check_lengths,
    frame_values,
)
from fieldgrid.maps.writing.transform import IDENTITY, Transform, transform_of
from fieldgrid.version import software_version


class SessionMetadata(NamedTuple):
    """What is kept of a session beside its frames; the trajectory is as driven. `created` is empty
    for one of now."""

    name: str
    trajectory: Trajectory | None
    config: str
    source: str
    source_sha256: str
    inputs: Mapping[str, Array]
    software_version: str
    created: str = ""
    transform: Transform = IDENTITY

    @property
    def heading_source(self) -> str:
        """How the headings of the trajectory were found."""
        return "" if self.trajectory is None else self.trajectory.heading_source

    @property
    def arrays(self) -> dict[ArrayKind, Mapping[str, Array]]:
        """All arrays, by kind."""
        track = self.trajectory
        return {
            ArrayKind.TRAJECTORY: {} if track is None else trajectory_arrays(track),
            ArrayKind.INPUT: self.inputs,
        }


def session_metadata(
    name: str,
    trajectory: Trajectory | None,
    config: Mapping[str, Any] | None,
    source: str,
    source_sha256: str,
    inputs: Mapping[str, Array] | None,
) -> SessionMetadata:
    """A session of now; ConfigError for a name, config or array that cannot be stored."""
    check_name(name)
    metadata = SessionMetadata(
        name,
        trajectory,
        as_json(config or {}),
        source,
        source_sha256,
        {key: np.array(value) for key, value in (inputs or {}).items()},
        software_version(),
    )
    texts = dict.fromkeys((source, source_sha256, metadata.heading_source), MAX_TEXT)
    check_lengths({metadata.config: MAX_DOCUMENT} | texts)
    list(array_rows(ArrayKind.INPUT, metadata.inputs))  # which refuses what cannot be stored
    return metadata


def check_name(name: str) -> None:
    """Raise ConfigError for a name that no session can have."""
    if not (0 < len(name) <= MAX_NAME and name.isprintable()):
        raise ConfigError(
            f"A session cannot be called {quoted(name)}; give a printable name of up to {MAX_NAME} "
            "letters."
        )


class FoundSession(NamedTuple):
    """A session of a map."""

    session_id: int
    removed: str | None
    metadata: SessionMetadata


def find(connection: sqlite3.Connection, path: Path, datum: Datum, name: str) -> FoundSession:
    """A session by its name, with all that is kept beside its frames."""
    row = row_of(connection, path, name)
    session_id, removed, config, source, source_sha256, software, heading_source = row[:7]
    created, transform = row[7:]
    try:
        columns = read_arrays(connection, session_id, ArrayKind.TRAJECTORY)
        metadata = SessionMetadata(
            name=name,
            trajectory=trajectory_of(columns, datum, heading_source) if columns else None,
            config=str(config),
            source=str(source),
            source_sha256=str(source_sha256),
            inputs=read_arrays(connection, session_id, ArrayKind.INPUT),
            software_version=str(software),
            created=str(created),
            transform=transform_of(transform),
        )
    except MapError as error:
        raise MapError(f"Session {quoted(name)} of {path} is damaged: {error}") from error
    return FoundSession(int(session_id), removed, metadata)


def row_of(connection: sqlite3.Connection, path: Path, name: str) -> tuple[Any, ...]:
    """What a session's own row says; ConfigError when there is none of that name."""
    row: tuple[Any, ...] | None = connection.execute(
        "SELECT id, removed, config, source, source_sha256, software_version, heading_source, "
        "created, transform FROM fieldgrid_session WHERE name = CAST(? AS TEXT)",
        # Of a command line the name may be no UTF-8, which SQLite takes as bytes alone.
        (name.encode("utf-8", "surrogatepass"),),
    ).fetchone()
    if row is None:
        raise no_session(connection, path, name)
    return row


def no_session(connection: sqlite3.Connection, path: Path, name: str) -> ConfigError:
    """The error for a session that a map does not have."""
    rows = connection.execute("SELECT name FROM fieldgrid_session ORDER BY id LIMIT 20")
    known = shortened(", ".join(quoted(other) for (other,) in rows)) or "none"
    return ConfigError(f"{path} has no session {quoted(name)}; it has {known}.")


def put_arrays(
    connection: sqlite3.Connection, session_id: int, arrays: Mapping[ArrayKind, Mapping[str, Array]]
) -> None:
    """Store arrays with a session in place of those of the same kind."""
    for kind, named in arrays.items():
        connection.execute(
            "DELETE FROM fieldgrid_array WHERE session_id = ? AND kind = ?",
            (session_id, kind.value),
        )
        connection.executemany(
            "INSERT INTO fieldgrid_array VALUES (?, ?, ?, ?, ?, ?, ?)",
            ((session_id, *row) for row in array_rows(kind, named)),
        )


_COUNTED = (
    "(frames, accepted, first_time_ns, last_time_ns) = "
    "(SELECT count(*), coalesce(sum(status = 'ok'), 0), min(time_ns), max(time_ns) "
    "FROM fieldgrid_frame WHERE session_id = :id)"
)
"""What a session's own row says of its frames."""


def count_frames(connection: sqlite3.Connection, session_id: int) -> None:
    """Bring what a session's own row says of its frames up to date."""
    connection.execute(
        f"UPDATE fieldgrid_session SET {_COUNTED} WHERE id = :id", {"id": session_id}
    )


def sum_up(connection: sqlite3.Connection, session_id: int, metadata: SessionMetadata) -> None:
    """Bring a session's own row up to date with its frames and arrays."""
    (*grid, heading_source) = connection.execute(
        "SELECT grid_width_m, grid_length_m, grid_cell_m, heading_source FROM fieldgrid_session "
        "WHERE id = ?",
        (session_id,),
    ).fetchone()
    frames = connection.execute(
        "SELECT digest FROM fieldgrid_frame WHERE session_id = ?", (session_id,)
    )
    digest = digest_of(metadata, grid, heading_source, [row[0] for row in frames])
    connection.execute(
        f"UPDATE fieldgrid_session SET digest = :digest, {_COUNTED} WHERE id = :id",
        {"id": session_id, "digest": digest},
    )


def digest_of(
    metadata: SessionMetadata,
    grid: Sequence[float | None],
    heading_source: str,
    frames: Sequence[str],
) -> str:
    """The digest of a session; `grid` is its width, length and cell, or three times None."""
    values = (
        metadata.source, metadata.source_sha256, metadata.config, metadata.software_version,
        heading_source, *grid,
    )  # fmt: skip
    return session_digest(values, metadata.arrays, frames)


def check_session(
    connection: sqlite3.Connection,
    path: Path,
    datum: Datum,
    info: SessionInfo,
    records: Sequence[FrameRecord],
) -> None:
    """Raise MapError where what is kept of a session beside its frames, or the list of these, is
    not as it was stored."""
    times_ns = [record.pose.time_ns for record in records]
    counts = (
        *(len(times_ns), sum(record.accepted for record in records)),
        *(min(times_ns, default=None), max(times_ns, default=None)),
    )
    spec, metadata = info.grid, find(connection, path, datum, info.name).metadata
    grid = (None, None, None) if spec is None else (spec.width_m, spec.length_m, spec.cell_m)
    frames = [record.digest for record in records]
    digest = digest_of(metadata, grid, info.heading_source, frames)
    kept = info.frames, info.accepted, info.first_time_ns, info.last_time_ns
    if (digest, counts) != (info.digest, kept):
        raise MapError(
            f"Session {quoted(info.name)} is not as it was stored: its settings, trajectory, "
            "inputs or list of frames have changed."
        )


def is_row_as_written(record: FrameRecord) -> bool:
    """Whether the row of a frame is the one that was stored; its cells are not looked at."""
    values = frame_values(
        record.driven,
        record.frame_id,
        record.quality,
        record.images,
        record.images_sha256,
        record.cells_sha256,
    )
    return frame_digest(values) == record.digest


def quality_at(track: Trajectory | None, time_ns: int) -> int | None:
    """The quality of the accepted fix nearest in time, None where there is none.

    Poses between fixes, whose quality is that of an estimate, are not asked.
    """
    if track is None:
        return None
    accepted = np.flatnonzero(track.accepted & (track.quality != Quality.ESTIMATED))
    if accepted.size == 0:
        return None
    times_ns = track.time_ns[accepted]
    after = int(np.searchsorted(times_ns, time_ns))
    near = [k for k in (after - 1, after) if 0 <= k < accepted.size]
    nearest = min(near, key=lambda k: abs(int(times_ns[k]) - time_ns))
    return int(track.quality[accepted[nearest]])


def name_is_taken(name: str, path: Path, *, removed: bool = False) -> ConfigError:
    """The error for a second session of one name."""
    if removed:
        return ConfigError(
            f"{path} has a session {quoted(name)} that was removed; put it back with --restore, or "
            "give another name with --name."
        )
    return ConfigError(
        f"{path} has a session {quoted(name)} already; give another name with --name."
    )


def as_json(config: Mapping[str, Any]) -> str:
    """A session's config as it is stored; ConfigError when it is no JSON."""
    try:
        return json.dumps(dict(config), ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"The session's config cannot be stored as JSON ({error}); "
            "use numbers, texts, lists and dictionaries."
        ) from error
