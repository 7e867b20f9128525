"""What a user says about a recording that the recording itself leaves open, or says wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from fieldgrid.errors import ConfigError
from fieldgrid.recording.columns import Columns
from fieldgrid.recording.mounting import Mounting, missing_mounting, read_mounting

ROLES = (
    *("left", "right", "left_info", "right_info"),
    *("disparity", "depth", "depth_info", "cloud"),
    *("fix", "nmea", "imu", "odometry"),
)
"""What a topic can be to a recording."""

MAX_OFFSET_S = 86_400
"""Time zones and a wrong date put a clock off by up to a day; beyond that it is no clock."""


@dataclass(frozen=True, slots=True)
class Options:
    """How to open a recording; every kind of recording takes all of it, or refuses what it
    cannot use with a sentence.

    `gnss` picks one of several GNSS logs by file name, or gives the path of another; `columns`
    says what the columns of a table of fixes are; `topics` names topics by their role (`ROLES`);
    `mounting` is another `mounting.json`, or what stands for it; `image_time_offset_ns` is added
    to image times to give GNSS time and outranks the recording's own.
    """

    gnss: str | Path | None = None
    columns: Columns | None = None
    topics: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    mounting: Path | Mounting | None = None
    image_time_offset_ns: int | None = None

    def __post_init__(self) -> None:
        for role in self.topics:
            if role not in ROLES:
                raise ConfigError(
                    f"{role!r} is nothing that a topic can be; known are {', '.join(ROLES)}."
                )
        offset_ns = self.image_time_offset_ns
        if offset_ns is not None and abs(offset_ns) > MAX_OFFSET_S * 1_000_000_000:
            raise ConfigError(
                f"An image time offset of {offset_ns / 1e9} s is beyond a day; give the seconds "
                "that an image time must be moved by to be GNSS time."
            )

    def refuse_topics(self, path: Path) -> None:
        """Raise ConfigError for topics of a recording that has none."""
        if self.topics:
            raise ConfigError(
                f"{path} is no bag and has no topics; leave --topic {next(iter(self.topics))} out."
            )

    def find_mounting(self, usual: Path, recording: Path) -> Mounting:
        """The mounting that was given, else the one at its usual place.

        Raises CalibrationError when there is neither.
        """
        if isinstance(self.mounting, Mounting):
            return self.mounting
        if self.mounting is None and not usual.exists():
            raise missing_mounting(usual, recording)
        return read_mounting(self.mounting or usual)

    def offset_or(self, own_ns: int) -> int:
        """The offset of image times that was given, else the recording's own."""
        return own_ns if self.image_time_offset_ns is None else self.image_time_offset_ns
