"""Changing what a map says of a session: taking it out, putting it back, moving its frames.

Each is one transaction. The evidence of a session that is taken out stays in the file.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.mapfile import derived
from fieldgrid.mapfile.arrays import Kind, read_arrays, trajectory_of
from fieldgrid.mapfile.digest import frame_digest
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.records import (
    FRAME_SQL,
    FrameRecord,
    frame_record,
    frame_values,
    is_accepted,
)
from fieldgrid.mapfile.schema import NOW_SQL
from fieldgrid.mapfile.session import (
    About,
    as_json,
    check_pose,
    put_arrays,
    quality_at,
    sum_up,
)
from fieldgrid.mapfile.staging import SessionFold, Staging
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.trajectory import Pose, Trajectory


class _Found(NamedTuple):
    """A session that is to be changed."""

    session_id: int
    removed: str | None
    about: About


def remove(connection: sqlite3.Connection, path: Path, header: Header, name: str) -> None:
    """Take a session out of the map, within the caller's transaction."""
    # Its evidence is not looked at: a session may be taken out because that is damaged.
    session_id, removed, *_ = _row_of(connection, path, name)
    if removed is not None:
        raise ConfigError(f"Session {name!r} of {path} is removed already; --restore puts it back.")
    connection.execute(
        f"UPDATE fieldgrid_session SET removed = {NOW_SQL} WHERE id = ?", (session_id,)
    )
    derived.hide(connection, TileMatrixSet(header.lattice), session_id, name)


def restore(connection: sqlite3.Connection, path: Path, header: Header, name: str) -> None:
    """Put a session back that was taken out, within the caller's transaction."""
    found = find(connection, path, header.datum, name)
    if found.removed is None:
        raise ConfigError(f"Session {name!r} of {path} is not removed; there is nothing to do.")
    connection.execute(
        "UPDATE fieldgrid_session SET removed = NULL WHERE id = ?", (found.session_id,)
    )
    matrices = TileMatrixSet(header.lattice)
    fold = derived.fold_evidence(connection, matrices, header.transfer, found.session_id)
    try:
        derived.show(connection, matrices, found.session_id, name, found.about.trajectory, fold)
    finally:
        fold.close()


def repose(
    connection: sqlite3.Connection,
    path: Path,
    header: Header,
    name: str,
    poses: Mapping[str, Pose],
    trajectory: Trajectory | None,
    config: Mapping[str, Any] | None,
) -> None:
    """Give the frames of a session other poses, within the caller's transaction."""
    session_id, removed, about = find(connection, path, header.datum, name)
    if trajectory is not None:
        about = about._replace(trajectory=trajectory)
        connection.execute(
            "UPDATE fieldgrid_session SET heading_source = ? WHERE id = ?",
            (trajectory.heading_source, session_id),
        )
        put_arrays(connection, session_id, {Kind.TRAJECTORY: about.arrays[Kind.TRAJECTORY]})
    if config is not None:
        about = about._replace(config=as_json(config))
        connection.execute(
            "UPDATE fieldgrid_session SET config = ? WHERE id = ?", (about.config, session_id)
        )
    rows = connection.execute(
        f"{FRAME_SQL} WHERE f.session_id = ? ORDER BY f.id", (session_id,)
    ).fetchall()
    _check_complete(path, name, [str(row[5]) for row in rows], poses)
    fold = SessionFold(header.lattice, header.transfer, Staging())
    try:
        for row in rows:
            record = frame_record(row, derived.blobs_of(connection, row[0]))
            _move(connection, row[0], record, poses[record.frame_id], about.trajectory, fold)
        sum_up(connection, session_id, about)
        if removed is None:
            matrices = TileMatrixSet(header.lattice)
            derived.show(connection, matrices, session_id, name, about.trajectory, fold)
    finally:
        fold.close()


def _move(
    connection: sqlite3.Connection,
    row_id: int,
    record: FrameRecord,
    pose: Pose,
    track: Trajectory | None,
    fold: SessionFold,
) -> None:
    check_pose(pose)
    grid = record.grid()
    quality = quality_at(track, pose.time_ns)
    values = frame_values(pose, record.frame_id, quality, record.images, record.images_sha256)
    connection.execute(
        "UPDATE fieldgrid_frame SET (frame_id, time_ns, east_m, north_m, up_m, heading_deg, "
        "position_sigma_m, heading_sigma_deg, speed_mps, status, reason, quality, images, "
        f"images_sha256, digest) = (?{', ?' * 14}) WHERE id = ?",
        (*values, frame_digest(values, grid), row_id),
    )
    if is_accepted(pose):
        fold.add(grid, pose)


def _check_complete(path: Path, name: str, frames: list[str], poses: Mapping[str, Pose]) -> None:
    missing = [frame for frame in frames if frame not in poses]
    if missing:
        raise ConfigError(
            f"Poses are missing for {len(missing)} of the {len(frames)} frames of session "
            f"{name!r}, the first {missing[0]!r}; give each frame one, marked rejected if need be."
        )
    strange = sorted(poses.keys() - set(frames))
    if strange:
        raise ConfigError(
            f"Session {name!r} of {path} has no frame {strange[0]!r}; give poses of its own frames."
        )


def find(connection: sqlite3.Connection, path: Path, datum: Datum, name: str) -> _Found:
    """A session by its name, with all that is kept beside its frames."""
    session_id, removed, config, source, source_sha256, software, heading_source, created = _row_of(
        connection, path, name
    )
    try:
        columns = read_arrays(connection, session_id, Kind.TRAJECTORY)
        about = About(
            name=name,
            trajectory=trajectory_of(columns, datum, heading_source) if columns else None,
            config=str(config),
            source=str(source),
            source_sha256=str(source_sha256),
            inputs=read_arrays(connection, session_id, Kind.INPUT),
            software_version=str(software),
            created=str(created),
        )
    except MapError as error:
        raise MapError(f"Session {name!r} of {path} is damaged: {error}") from error
    return _Found(int(session_id), removed, about)


def _row_of(connection: sqlite3.Connection, path: Path, name: str) -> tuple[Any, ...]:
    """What a session's own row says; ConfigError when there is none of that name."""
    row = connection.execute(
        "SELECT id, removed, config, source, source_sha256, software_version, heading_source, "
        "created FROM fieldgrid_session WHERE name = ?",
        (name,),
    ).fetchone()
    if row is None:
        known = connection.execute("SELECT name FROM fieldgrid_session ORDER BY id")
        raise ConfigError(
            f"{path} has no session {name!r}; it has "
            f"{', '.join(repr(other) for (other,) in known) or 'none'}."
        )
    found: tuple[Any, ...] = row
    return found
