"""Changing what a map says of a session: out, back in, other poses, another place.

Each is one transaction. The evidence of a session that is taken out stays in the file.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fieldgrid.core import ConfigError, quoted
from fieldgrid.geometry import Pose, Trajectory
from fieldgrid.maps.file.arrays import ArrayKind
from fieldgrid.maps.file.digest import frame_digest
from fieldgrid.maps.file.evidence import frames_of
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.metadata import (
    as_json,
    check_name,
    find,
    put_arrays,
    quality_at,
    row_of,
    sum_up,
)
from fieldgrid.maps.file.records import check_pose, frame_values
from fieldgrid.maps.file.schema import NOW_SQL
from fieldgrid.maps.vector.features import FEATURE_LAYERS
from fieldgrid.maps.writing import derived
from fieldgrid.maps.writing.transform import IDENTITY, Transform, transform_of


def remove(connection: sqlite3.Connection, path: Path, header: MapHeader, name: str) -> None:
    """Take a session out of the map, within the caller's transaction."""
    # Its evidence is not looked at: a session may be taken out because that is damaged.
    session_id, removed, *_ = row_of(connection, path, name)
    if removed is not None:
        raise ConfigError(
            f"Session {quoted(name)} of {path} is removed already; --restore puts it back."
        )
    with derived.moving(connection, header, session_id, name, path) as place:
        connection.execute(
            f"UPDATE fieldgrid_session SET removed = {NOW_SQL} WHERE id = ?", (session_id,)
        )
        place(None)


def restore(connection: sqlite3.Connection, path: Path, header: MapHeader, name: str) -> None:
    """Put a session back that was taken out, within the caller's transaction."""
    found = find(connection, path, header.datum, name)
    if found.removed is None:
        raise ConfigError(
            f"Session {quoted(name)} of {path} is not removed; there is nothing to do."
        )
    with derived.moving(connection, header, found.session_id, name, path) as place:
        connection.execute(
            "UPDATE fieldgrid_session SET removed = NULL WHERE id = ?", (found.session_id,)
        )
        place(found.metadata)


def rename(connection: sqlite3.Connection, path: Path, name: str, to: str) -> None:
    """Give a session, removed or not, another name."""
    check_name(to)
    session_id, *_ = row_of(connection, path, name)
    if (
        to != name
        and connection.execute("SELECT 1 FROM fieldgrid_session WHERE name = ?", (to,)).fetchone()
    ):
        raise ConfigError(
            f"{path} has a session {quoted(to)} already, removed or not; give another."
        )
    connection.execute("UPDATE fieldgrid_session SET name = ? WHERE id = ?", (to, session_id))
    for layer in FEATURE_LAYERS:
        connection.execute(f"UPDATE {layer} SET session = ? WHERE session = ?", (to, name))
    # Those that were aligned to it know it by its name.
    aligned = connection.execute(
        "SELECT id, transform FROM fieldgrid_session WHERE transform IS NOT NULL"
    ).fetchall()
    for other_id, text in aligned:
        stored = transform_of(text)
        other = stored.speaking_of({name: to})
        if other != stored:
            connection.execute(
                "UPDATE fieldgrid_session SET transform = ? WHERE id = ?",
                (other.to_text(), other_id),
            )
    derived.touch(connection)


def transform(
    connection: sqlite3.Connection, path: Path, header: MapHeader, name: str, to: Transform
) -> None:
    """Put a session elsewhere in the map, in place of any transform that it had."""
    found = find(connection, path, header.datum, name)
    if to.is_identity and to.aligned is None:
        to = IDENTITY
    for record in frames_of(connection, found.session_id):
        check_pose(to.pose(record.driven))
    with derived.moving(
        connection, header, found.session_id, name, path, is_out=found.removed is not None
    ) as place:
        connection.execute(
            "UPDATE fieldgrid_session SET transform = ? WHERE id = ?",
            (to.to_text(), found.session_id),
        )
        place(found.metadata._replace(transform=to))


def middle_m(connection: sqlite3.Connection, path: Path, name: str) -> tuple[float, float]:
    """The middle of a session's accepted frames as driven, east and north."""
    session_id, *_ = row_of(connection, path, name)
    poses = [r.driven for r in frames_of(connection, session_id) if r.accepted]
    if not poses:
        return 0.0, 0.0
    east_m, north_m = [pose.east_m for pose in poses], [pose.north_m for pose in poses]
    return (min(east_m) + max(east_m)) / 2.0, (min(north_m) + max(north_m)) / 2.0


def repose(
    connection: sqlite3.Connection,
    path: Path,
    header: MapHeader,
    name: str,
    poses: Mapping[str, Pose],
    trajectory: Trajectory | None,
    config: Mapping[str, Any] | None,
) -> None:
    """Give the frames of a session other poses as driven, within the caller's transaction."""
    found = find(connection, path, header.datum, name)
    session_id, _, metadata = found
    with derived.moving(
        connection, header, session_id, name, path, is_out=found.removed is not None
    ) as place:
        if (aligned := metadata.transform.aligned) is not None:
            # What the alignment left was said of the poses that are replaced.
            unsure = replace(aligned, sigma_m=None, turn_sigma_deg=None, beside=())
            metadata = metadata._replace(transform=replace(metadata.transform, aligned=unsure))
            connection.execute(
                "UPDATE fieldgrid_session SET transform = ? WHERE id = ?",
                (metadata.transform.to_text(), session_id),
            )
        if trajectory is not None:
            metadata = metadata._replace(trajectory=trajectory)
            connection.execute(
                "UPDATE fieldgrid_session SET heading_source = ? WHERE id = ?",
                (trajectory.heading_source, session_id),
            )
            put_arrays(
                connection,
                session_id,
                {ArrayKind.TRAJECTORY: metadata.arrays[ArrayKind.TRAJECTORY]},
            )
        if config is not None:
            metadata = metadata._replace(config=as_json(config))
            connection.execute(
                "UPDATE fieldgrid_session SET config = ? WHERE id = ?",
                (metadata.config, session_id),
            )
        records = list(frames_of(connection, session_id))
        frames = [record.frame_id for record in records]
        missing = [frame for frame in frames if frame not in poses]
        if missing:
            raise ConfigError(
                f"Poses are missing for {len(missing)} of the {len(frames)} frames of session "
                f"{quoted(metadata.name)}, the first {quoted(missing[0])}; give each frame one, "
                "marked rejected if need be."
            )
        strange = sorted(poses.keys() - set(frames))
        if strange:
            raise ConfigError(
                f"Session {quoted(metadata.name)} of {path} has no frame {quoted(strange[0])}; "
                "give poses of its own frames."
            )
        for record in records:
            pose = poses[record.frame_id]
            check_pose(metadata.transform.pose(pose))
            values = frame_values(
                pose,
                record.frame_id,
                quality_at(metadata.trajectory, pose.time_ns),
                record.images,
                record.images_sha256,
                record.cells_sha256,
            )
            connection.execute(
                "UPDATE fieldgrid_frame SET (frame_id, time_ns, east_m, north_m, up_m, "
                "heading_deg, position_sigma_m, heading_sigma_deg, speed_mps, status, reason, "
                f"quality, images, images_sha256, cells_sha256, digest) = (?{', ?' * 15}) "
                "WHERE session_id = ? AND frame_id = ?",
                (*values, frame_digest(values), session_id, record.frame_id),
            )
        sum_up(connection, session_id, metadata)
        place(metadata)
