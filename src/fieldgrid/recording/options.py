"""What a user says about a drive that it leaves open itself, or says wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fieldgrid.errors import CalibrationError, ConfigError, quoted
from fieldgrid.recording.columns import Columns
from fieldgrid.recording.mounting import Mounting, missing_mounting, read_mounting
from fieldgrid.recording.pose_source import PoseSource
from fieldgrid.rig import LeverArm, Mount

ROLES = (
    *("left", "right", "left_info", "right_info"),
    *("disparity", "depth", "depth_info", "cloud"),
    *("fix", "nmea", "imu", "odometry"),
)
"""What a topic can be to a recording."""

MAX_OFFSET_S = 86_400
"""Time zones and a wrong date put a clock off by up to a day; beyond that it is no clock."""

NO_MOUNTING = Mounting(Mount(1.0, 0.0), LeverArm(0.0, 0.0, 0.0), source="no mounting")

_FLAGS = {
    "gnss": "--gnss",
    "columns": "--columns",
    "topics": "--topic",
    "mounting": "--mounting",
    "image_time_offset_ns": "--time-offset",
}


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """How to open a drive; every format takes all of it, or refuses what it cannot use with a
    sentence.

    `gnss` picks one of several GNSS logs by file name, or gives the path of another; `columns`
    says what the columns of a table of fixes are; `topics` names topics by their role (`ROLES`);
    `mounting` is another `mounting.json`, or what stands for it; `image_time_offset_ns` is added
    to image times to give GNSS time and outranks the recording's own; `poses` are those that
    another program estimated, and outrank what the recording says of them. With `unmounted`, a
    sensor of which nothing tells how it sits gets `NO_MOUNTING`. With `incomplete`, files of frames
    may be missing: it is the frame that then cannot be read.
    """

    gnss: str | Path | None = None
    columns: Columns | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    mounting: str | Path | Mounting | None = None
    image_time_offset_ns: int | None = None
    poses: PoseSource | None = None
    unmounted: bool = False
    incomplete: bool = False

    def __post_init__(self) -> None:
        for role in self.topics:
            if role not in ROLES:
                raise ConfigError(
                    f"{quoted(role)} is nothing that a topic can be; known are {', '.join(ROLES)}."
                )
        offset_ns = self.image_time_offset_ns
        if offset_ns is not None and abs(offset_ns) > MAX_OFFSET_S * 1_000_000_000:
            raise ConfigError(
                f"An image time offset of {offset_ns / 1e9} s is beyond a day; give the seconds "
                "that an image time must be moved by to be GNSS time."
            )

    def refuse(self, why: str, *names: str) -> None:
        """Raise ConfigError, with `why`, for options of these names that were given."""
        for name in names:
            value = getattr(self, name)
            if value is not None and value != {}:
                what = f"{_FLAGS[name]} {next(iter(value))}" if name == "topics" else _FLAGS[name]
                raise ConfigError(f"{why}; leave {what} out.")

    def refuse_topics(self, path: Path) -> None:
        """Raise ConfigError for topics of a drive that has none."""
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
