"""What a map tells of its sessions and frames."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fieldgrid.core import (
    ConfigError,
    DatumError,
    FieldgridError,
    MapError,
    notebook,
    parse_json,
    quoted,
    shortened,
)
from fieldgrid.geometry import MAX_DISTANCE_M, GridSpec, LocalGrid, Pose, Status
from fieldgrid.maps.file.codec import EncodedChannel, cells_sha256, decode_cells
from fieldgrid.maps.layers.frame import FrameCells
from fieldgrid.maps.writing.staging import StagedFrame
from fieldgrid.maps.writing.transform import IDENTITY, Transform, transform_of

SESSION_SQL = (
    "SELECT name, created, source, config, software_version, heading_source, first_time_ns, "
    "last_time_ns, frames, accepted, grid_width_m, grid_length_m, grid_cell_m, removed, "
    "source_sha256, digest, transform FROM fieldgrid_session"
)

FRAME_SQL = (
    "SELECT f.id, s.name, s.grid_width_m, s.grid_length_m, s.grid_cell_m, f.frame_id, f.time_ns, "
    "f.east_m, f.north_m, f.up_m, f.heading_deg, f.position_sigma_m, f.heading_sigma_deg, "
    "f.speed_mps, f.status, f.reason, f.quality, f.images, f.images_sha256, "
    "f.cells_sha256, f.digest, s.transform "
    "FROM fieldgrid_frame AS f JOIN fieldgrid_session AS s ON s.id = f.session_id"
)


MAX_NAME = 255
"""Letters of the name of a session, and of a frame."""

MAX_TEXT = 1000
"""Letters of a reason or a source."""

MAX_DOCUMENT = 4 << 20
"""Letters of any text: settings, lists and transforms as JSON."""

_NOWHERE = Pose(0, *(math.nan,) * 7)


@dataclass(frozen=True, slots=True)
class SessionInfo:
    """One drive in the map.

    `created` is ISO 8601 in UTC, and so is `removed`, None while the session is in the universal
    grid. The times are those of the first and the last frame; None, like `grid`, in a session
    without frames. `accepted` counts the frames that are in the universal grid. `digest` is the
    SHA-256 of the evidence, the same under any name and transform. `transform` puts the drive into
    its place in the map.
    """

    name: str
    created: str
    source: str
    config: Mapping[str, Any]
    software_version: str
    heading_source: str
    first_time_ns: int | None
    last_time_ns: int | None
    frames: int
    accepted: int
    grid: GridSpec | None
    removed: str | None = None
    source_sha256: str = ""
    digest: str = ""
    transform: Transform = IDENTITY

    @property
    def driven(self) -> str:
        """The UTC day on which the drive ended, a dash when it has no frames."""
        if self.last_time_ns is None:
            return "-"
        return str(np.datetime_as_string(np.datetime64(self.last_time_ns, "ns"), unit="D"))

    def _repr_html_(self) -> str:
        """What is known of it, for a notebook."""
        return sessions_html([self])

    @property
    def active(self) -> bool:
        """Whether the session is in the universal grid, or was removed."""
        return self.removed is None


def sessions_html(infos: Sequence[SessionInfo]) -> str:
    """A table of sessions, for a notebook."""
    rows = [
        (
            info.name, info.driven, f"{info.accepted} of {info.frames}", info.source,
            "" if info.active else "removed",
        )
        for info in infos
    ]  # fmt: skip
    return notebook.table(rows, ("session", "driven", "frames used", "GNSS", ""))


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One frame as the map keeps it: where it was, the verdict, and what it saw.

    `pose` is as placed in the map, `driven` as it was before the session's transform. `quality` is
    that of the accepted fix nearest in time (of GGA), None where there is none. `images_sha256` are
    the hashes of the files named in `images`, as far as they are known; `cells_sha256` is that of
    what the frame saw.
    """

    session: str
    frame_id: str
    pose: Pose
    images: tuple[str, ...]
    spec: GridSpec
    load: Callable[[], tuple[EncodedChannel, ...]] = field(repr=False, compare=False)
    quality: int | None = None
    images_sha256: tuple[str, ...] = ()
    cells_sha256: str = ""
    digest: str = ""
    driven: Pose = field(default_factory=lambda: _NOWHERE, repr=False)

    @property
    def status(self) -> Status:
        """The verdict on the pose; only `ok` is in the universal grid."""
        return self.pose.status

    @property
    def reason(self) -> str:
        """Why it is not in the universal grid; empty when it is."""
        return self.pose.reason

    @property
    def accepted(self) -> bool:
        """Whether the frame is in the universal grid."""
        return is_accepted(self.pose)

    def grid(self) -> LocalGrid:
        """The local grid, decompressed at each call; its channels alone."""
        own = [channel for channel in self.load() if channel.name in ("density", "observed")]
        return self.cells(own).grid

    def cells(self, stored: Sequence[EncodedChannel] | None = None) -> FrameCells:
        """The local grid and all further channels, decompressed at each call; or some that are
        `stored`."""
        what = f"grid of frame {quoted(self.frame_id)} of session {quoted(self.session)}"
        return decode_cells(self.spec, self.load() if stored is None else stored, what)

    def staged(self) -> StagedFrame:
        """What the frame saw, as it is stored: for another map."""
        return StagedFrame(
            self.frame_id,
            self.pose.time_ns,
            self.spec,
            self.load(),
            self.cells_sha256 or cells_sha256(self.cells()),  # maps of format 2 have none
            self.images,
            self.images_sha256,
        )


def is_accepted(pose: Pose) -> bool:
    """The one rule for what enters the universal grid."""
    return pose.status is Status.OK


def check_pose(pose: Pose) -> None:
    """Raise for an accepted pose that cannot be folded: without numbers, or far from the datum."""
    if not is_accepted(pose):
        return
    if not all(math.isfinite(v) for v in (pose.east_m, pose.north_m, pose.heading_deg)):
        raise ConfigError(
            f"A pose at east {pose.east_m}, north {pose.north_m}, heading {pose.heading_deg} "
            "is marked ok; reject it, or give it numbers."
        )
    # A height may be unknown.
    up_m = 0.0 if math.isnan(pose.up_m) else pose.up_m
    if max(abs(pose.east_m), abs(pose.north_m), abs(up_m)) > MAX_DISTANCE_M:
        raise DatumError(
            f"A pose {pose.east_m:.6g} m east, {pose.north_m:.6g} m north and {up_m:.6g} m up is "
            f"over {MAX_DISTANCE_M / 1000:.0f} km from the map's datum; start another map there."
        )


def frame_values(
    pose: Pose,
    frame_id: str,
    quality: int | None,
    images: Sequence[str],
    images_sha256: Sequence[str],
    cells_sha256: str,
) -> tuple[Any, ...]:
    """What is stored of a frame before its digest; the pose is as driven. ConfigError for a text
    that is too long."""
    documents = json.dumps(list(images), ensure_ascii=False), json.dumps(list(images_sha256))
    check_lengths(
        {frame_id: MAX_NAME, pose.reason: MAX_TEXT} | dict.fromkeys(documents, MAX_DOCUMENT)
    )
    return (
        frame_id,
        int(pose.time_ns),
        float(pose.east_m),
        float(pose.north_m),
        float(pose.up_m),
        float(pose.heading_deg),
        float(pose.position_sigma_m),
        float(pose.heading_sigma_deg),
        float(pose.speed_mps),
        pose.status.value,
        pose.reason,
        quality,
        *documents,
        cells_sha256,
    )


def frame_record(
    row: tuple[Any, ...], load: Callable[[], tuple[EncodedChannel, ...]]
) -> FrameRecord:
    """A frame from a row of `FRAME_SQL`; `load` fetches its stored channels."""
    _, session, width_m, length_m, cell_m, frame_id, time_ns, *pose = row[:14]
    status, reason, quality, images, images_sha256, cells_sha256, digest, transform = row[14:]
    try:
        driven = Pose(
            time_ns=_whole(time_ns),
            east_m=_number(pose[0]),
            north_m=_number(pose[1]),
            up_m=_number(pose[2]),
            heading_deg=_number(pose[3]),
            position_sigma_m=_number(pose[4]),
            heading_sigma_deg=_number(pose[5]),
            speed_mps=_number(pose[6]),
            status=Status(_text(status)),
            reason=_text(reason),
        )
        placed = transform_of(transform).pose(driven)
        check_pose(placed)
        return FrameRecord(
            session=_text(session, MAX_NAME),
            frame_id=_text(frame_id, MAX_NAME),
            pose=placed,
            images=tuple(str(name) for name in _json(images)),
            spec=GridSpec(width_m, length_m, cell_m),
            load=load,
            quality=None if quality is None else _whole(quality),
            images_sha256=tuple(str(value) for value in _json(images_sha256)),
            cells_sha256=_text(cells_sha256),
            digest=_text(digest),
            driven=driven,
        )
    except (TypeError, ValueError, FieldgridError) as error:
        what = f"Frame {quoted(frame_id)} of session {quoted(session)}"
        raise MapError(f"{what} is damaged: {shortened(error).rstrip('.')}.") from error


def session_info(row: tuple[Any, ...]) -> SessionInfo:
    """A session from a row of `SESSION_SQL`."""
    name, created, source, config, software, heading_source, first, last, *counts = row[:13]
    removed, source_sha256, digest, transform = row[13:]
    frames, accepted, width_m, length_m, cell_m = counts
    try:
        return SessionInfo(
            name=_text(name, MAX_NAME),
            created=_text(created),
            source=_text(source),
            config=dict(_json(config)),
            software_version=_text(software),
            heading_source=_text(heading_source),
            first_time_ns=None if first is None else _whole(first),
            last_time_ns=None if last is None else _whole(last),
            frames=_whole(frames),
            accepted=_whole(accepted),
            grid=None if cell_m is None else GridSpec(width_m, length_m, cell_m),
            removed=None if removed is None else _text(removed),
            source_sha256=_text(source_sha256),
            digest=_text(digest),
            transform=transform_of(transform),
        )
    except (TypeError, ValueError, FieldgridError) as error:
        raise MapError(
            f"Session {quoted(name)} is damaged: {shortened(error).rstrip('.')}."
        ) from error


def _number(value: Any) -> float:
    """A stored number; SQLite has no NaN and keeps NULL in its place."""
    if value is not None and not isinstance(value, int | float):
        raise TypeError(f"{quoted(value)} is no number")
    return math.nan if value is None else float(value)


def _whole(value: Any) -> int:
    if not isinstance(value, int):
        raise TypeError(f"{quoted(value)} is no whole number")
    return value


def _text(value: Any, most: int = MAX_TEXT) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{quoted(value)} is no text")
    if len(value) > most:
        raise ValueError(f"a text of {len(value)} letters begins with {quoted(value)}")
    return value


def _json(value: Any) -> Any:
    return parse_json(_text(value, MAX_DOCUMENT))


def check_lengths(texts: Mapping[str, int]) -> None:
    """Raise ConfigError for a text that has more letters than a map takes of it."""
    for text, most in texts.items():
        if len(text) > most:
            raise ConfigError(
                f"{quoted(text)} has {len(text)} letters, and a map takes {most}; give a shorter "
                "text."
            )
