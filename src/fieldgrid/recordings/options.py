"""What a user says about a drive that it leaves open itself, or says wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from fieldgrid.core import CalibrationError, ConfigError, LackingError, RecordingError, quoted
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.recordings.calibration.mounting import Mounting, missing_mounting, read_mounting
from fieldgrid.recordings.drive import Drive, Recording, with_frames
from fieldgrid.recordings.poses.pose_source import PoseSource
from fieldgrid.recordings.tables.columns import Columns
from fieldgrid.recordings.tables.fix_log import FixLog

ROLES = (
    *("left", "right", "left_info", "right_info"),
    *("disparity", "depth", "depth_info", "cloud"),
    *("fix", "nmea", "imu", "odometry", "attitude"),
)
"""What a topic can be to a recording."""

MAX_OFFSET_S = 86_400
"""Time zones and a wrong date put a clock off by up to a day; what is further off by itself
counts from when a sensor was switched on."""

MAX_GIVEN_OFFSET_S = 40 * 365 * 86_400
"""A computer without a battery for its clock may be years off; nanoseconds given for seconds are
beyond."""

NO_MOUNTING = Mounting(Mount(1.0, 0.0), LeverArm(0.0, 0.0, 0.0), source="no mounting")

Found = TypeVar("Found")
Made = TypeVar("Made")

_FLAGS = {
    "gnss": "--gnss",
    "columns": "--columns",
    "topics": "--topic",
    "mounting": "--mounting",
    "image_time_offset_ns": "--time-offset",
    "gnss_offset_ns": "--gnss-offset",
    "epoch_ns": "--epoch",
}


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """How to open a drive; every format takes all of it, or refuses what it cannot use with a
    sentence.

    `gnss` picks one of several GNSS logs by file name, or gives the path of another; `columns`
    says what the columns of a table of fixes are; `topics` names topics by their role (`ROLES`);
    `mounting` is another `mounting.json`, or what stands for it; `image_time_offset_ns` is added
    to image times to give GNSS time and outranks the recording's own, `gnss_offset_ns` to the
    times of the GNSS log to give the time of images, gyro and wheels; `poses` are those that
    another program estimated, and outrank what the recording says of them; `epoch_ns` is the UTC
    from which a clock without a date counts: that of a bag, or of NMEA sentences, for which the day
    is enough. With `unmounted`, a
    sensor of which nothing tells how it sits gets `NO_MOUNTING`. With `incomplete`, files of frames
    may be missing: it is the frame that then cannot be read. `from_ns` and `until_ns` cut the drive
    (`cutting.cut`).
    """

    gnss: str | Path | None = None
    columns: Columns | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    mounting: str | Path | Mounting | None = None
    image_time_offset_ns: int | None = None
    gnss_offset_ns: int | None = None
    poses: PoseSource | None = None
    unmounted: bool = False
    incomplete: bool = False
    epoch_ns: int | None = None
    from_ns: int | None = None
    until_ns: int | None = None

    def __post_init__(self) -> None:
        for role in self.topics:
            if role not in ROLES:
                raise ConfigError(
                    f"{quoted(role)} is nothing that a topic can be; known are {', '.join(ROLES)}."
                )
        for offset_ns, what, goal in (
            (self.image_time_offset_ns, "An image", "GNSS time"),
            (self.gnss_offset_ns, "A GNSS", "the time of images, gyro and wheels"),
        ):
            if offset_ns is not None and abs(offset_ns) > MAX_GIVEN_OFFSET_S * 1_000_000_000:
                raise ConfigError(
                    f"{what} time offset of {offset_ns / 1e9} s is beyond 40 years; give "
                    f"the seconds that a time of it must be moved by to be {goal}."
                )

    def refuse(self, why: str, *names: str) -> None:
        """Raise ConfigError, with `why`, for options of these names that were given."""
        for name in names:
            value = getattr(self, name)
            if value is not None and value != {}:
                what = f"{_FLAGS[name]} {next(iter(value))}" if name == "topics" else _FLAGS[name]
                raise ConfigError(f"{why}; leave {what} out.")

    def refuse_topics(self, path: Path) -> None:
        """Raise ConfigError for topics of a drive that is no bag."""
        self.refuse(f"{path} is no bag and has no topics", "topics")

    def find_mounting(self, usual: Path, recording: Path) -> Mounting:
        """The mounting that was given, else the one at its usual place.

        Raises CalibrationError when there is neither, ConfigError when the one that was given
        cannot be read: a drive is fine without frames, but not without what the user asks for.
        """
        if isinstance(self.mounting, Mounting):
            return self.mounting
        if self.mounting is not None:
            try:
                return read_mounting(Path(self.mounting))
            except CalibrationError as problem:
                raise ConfigError(str(problem)) from problem
        if not usual.exists():
            if self.unmounted:
                return NO_MOUNTING
            raise missing_mounting(usual, recording)
        return read_mounting(usual)

    def offset_or(self, own_ns: int) -> int:
        """The offset of image times that was given, else the recording's own."""
        return own_ns if self.image_time_offset_ns is None else self.image_time_offset_ns

    def in_time(self, log: FixLog, own_ns: int = 0) -> FixLog:
        """A GNSS log moved by the offset that was given, else by the recording's own."""
        return log.moved(own_ns if self.gnss_offset_ns is None else self.gnss_offset_ns)


def mounted(
    drive: Drive, find: Callable[[], Mounting], make: Callable[[Mounting], Recording]
) -> Drive:
    """The recording that is made of a drive with its mounting; where it cannot be, the drive, which
    keeps why."""

    def made(mounting: Mounting) -> Recording:
        return replace(make(mounting), is_mounted=mounting is not NO_MOUNTING)

    return with_frames(drive, lambda _: together(find, NO_MOUNTING, made))


def together(find: Callable[[], Found], stand_in: Found, make: Callable[[Found], Made]) -> Made:
    """What is made of what is found. Where nothing is found, it is made of a stand-in, so that all
    that is missing is told in one error: what is needed to find the rest first."""
    found, missing = stand_in, None
    try:
        found = find()
    except RecordingError as problem:
        missing = problem
    try:
        made = make(found)
    except RecordingError as problem:
        if missing is None:
            raise
        raise LackingError(problem, missing) from problem
    if missing is not None:
        raise missing
    return made
