"""A drive as it was recorded: fixes, motion and, where it is a recording, frames and their rig."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fieldgrid.core import Closing, GnssError, Int64, NoFramesError, RecordingError
from fieldgrid.geometry import Datum, FixColumns, Motion, Rig
from fieldgrid.recordings.frames.frames import Frame, FrameSource
from fieldgrid.recordings.poses.pose_files import BodyPoses
from fieldgrid.recordings.poses.pose_source import PoseBody, PoseSource
from fieldgrid.recordings.tables.fix_log import FixLog


@dataclass(frozen=True, slots=True)
class Stream:
    """One sequence of messages or rows as recorded, used or not: what an inspection looks at.

    `role` is what it is to the recording (of `options.ROLES`, or gyro, wheels), empty when it is
    not used. `stamp_ns` are the times that the messages carry, int64, in the order of the record
    and not corrected, 0 for one without; `receive_ns` when each was written down, None where
    nothing says so. Of a stream that is not used both may be empty.
    """

    name: str
    kind: str
    role: str
    count: int
    stamp_ns: Int64
    receive_ns: Int64 | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive(Closing):
    """What every drive offers, a GNSS log alone too; a context manager.

    `kind` is the name of its format. `gnss_source` says which log or topic the fixes are from,
    empty when there is none. `rig` is None where nothing says what carried the antenna.
    `datum_hint` is the datum that the drive itself asks for. `notes` are remarks, a sentence each,
    and `losses` what is lost since a file is truncated or damaged. `refusal` is why there are no
    frames, or none that can be used. `pose_source` is where the drive says that poses of another
    program are, `pose_name` what those are from that it was opened with, `body_poses` these as they
    are written, and `pose_body` what body has them.
    """

    path: Path
    name: str
    kind: str = ""
    log: FixLog = field(default_factory=lambda: FixLog(FixColumns.of([])))
    gnss_source: str = ""
    gnss_path: Path | None = None
    gnss_hash: str = ""
    rig: Rig | None = None
    datum_hint: Datum | None = None
    notes: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    topics: tuple[Stream, ...] = ()
    refusal: RecordingError | None = None
    pose_source: PoseSource | None = None
    pose_name: str = ""
    pose_body: PoseBody | None = None
    body_poses: BodyPoses | None = None
    stack: ExitStack = field(default_factory=ExitStack, repr=False)

    def fixes(self) -> FixColumns:
        """The fixes in the order of the log, none left out, not yet judged."""
        return self.log.fixes

    def motion(self) -> Motion:
        """Gyro, wheels, IMU and recorded tilt, as far as the drive has them."""
        return self.log.motion

    def gnss_sha256(self) -> str:
        """The hash of what the fixes are from, in hexadecimal; empty when that is no one log."""
        if self.gnss_path is None or not self.gnss_path.is_file():
            return self.gnss_hash
        with self.gnss_path.open("rb") as log:
            return hashlib.file_digest(log, "sha256").hexdigest()

    def streams(self) -> Sequence[Stream]:
        """Everything that was recorded, also what is not used."""
        if self.topics:
            return self.topics
        said = self.motion()
        found = (
            (self.gnss_source, "fixes", "fix", self.fixes() if self.gnss_source else None),
            ("gyro", "gyro", "gyro", said.gyro),
            ("wheels", "speed", "wheels", said.wheels),
        )
        return [
            Stream(name, kind, role, len(series.time_ns), series.time_ns)
            for name, kind, role, series in found
            if series is not None
        ]

    def recording(self) -> Recording:
        """The drive as one with frames; raises what stands against that: NoFramesError where it
        has none, another RecordingError where they cannot be used."""
        raise self.refusal or NoFramesError(
            f"{self.path} is a {self.kind or 'drive'} and has no frames, of which maps are made; "
            "give a recording with images, depths or clouds."
        )

    def close(self) -> None:
        """Release what is held open; a closed drive yields no more frames."""
        self.stack.close()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording(Drive):
    """A drive with frames and the rig that they were taken with.

    `is_mounted` is False where nothing tells how the sensor sits, and a mount stands for none.
    """

    rig: Rig
    source: FrameSource
    is_mounted: bool = True

    @property
    def frame_count(self) -> int:
        """How many frames there are."""
        return len(self.source.times_ns)

    def frame_times_ns(self) -> Int64:
        """Times of the frames as the camera stamped them, shape (frame_count,), increasing."""
        return self.source.times_ns.copy()

    def image_times_ns(self) -> Int64:
        """Times of the frames by the clock of the receiver, as the rig's offset says."""
        return self.source.times_ns + self.rig.image_time_offset_ns

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames number `start` to before `stop`, in order of time; no image is read before it is
        asked for. In another process: `source.frames`."""
        count = self.frame_count
        last = count if stop is None else min(stop, count)
        return self.source.frames(min(max(start, 0), last), last)

    def streams(self) -> Sequence[Stream]:
        """Everything that was recorded, also what is not used."""
        times_ns = self.frame_times_ns()
        frames = [
            Stream(role, "cloud" if role == "cloud" else "image", role, len(times_ns), times_ns)
            for role in self.source.roles
        ]
        return self.topics or [*frames, *Drive.streams(self)]

    def recording(self) -> Recording:
        """The drive itself."""
        return self


def no_fixes(name: str, notes: Sequence[str] = ()) -> GnssError:
    """What is said of a drive without fixes; `notes` are those of its log."""
    why = (
        f"{name} has no GNSS log, without which nothing can be placed; put the log of this "
        "drive into its folder gnss/, name it with --gnss, or give poses with --poses."
    )
    return GnssError(" ".join([why, *notes]))


def with_frames(drive: Drive, make: Callable[[Drive], Recording]) -> Drive:
    """The recording that `make` makes of a drive; where it cannot, the drive, which keeps why."""
    try:
        return make(drive)
    except RecordingError as problem:
        return replace(drive, refusal=problem)


def with_motion(drive: Drive, motion: Motion, notes: tuple[str, ...] = ()) -> Drive:
    """A drive with motion of its own, which goes before that of its log, and remarks on it."""
    of_log = drive.motion()
    own = {name: said for name, said in motion._asdict().items() if said is not None}
    log = drive.log._replace(motion=of_log._replace(**own))
    if of_log.gyro is not None and motion.gyro is not None:
        # The log spoke of the clock of its own unit, whose gyro is not used.
        fixes = replace(log.fixes, stamp_sigma_s=np.full(len(log.fixes), np.nan))
        log = log._replace(fixes=fixes)
    return replace(drive, log=log, notes=drive.notes + notes)


def as_recording(
    drive: Drive,
    rig: Rig,
    source: FrameSource,
    notes: tuple[str, ...] = (),
    *,
    is_mounted: bool = True,
) -> Recording:
    """A drive with its frames, and remarks on them before those of the drive."""
    values = {name: getattr(drive, name) for name in Drive.__dataclass_fields__}
    values |= {"rig": rig, "notes": notes + drive.notes}
    return Recording(**values, source=source, is_mounted=is_mounted)
