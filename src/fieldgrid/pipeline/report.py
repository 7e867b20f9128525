"""What a build says of itself: while it runs, and when it is done."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

from fieldgrid.core import DatumError, FieldgridError, Finding, GnssError, RecordingError

DRIVE_ERRORS = (RecordingError, GnssError, DatumError)
"""Errors that say something of one drive; others end the build."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a build is: what a progress line shows. The distance is the camera's, None
    where it is not followed."""

    session: str
    frames_done: int
    frames_total: int
    distance_m: float | None = None


class PartlyBuiltError(FieldgridError):
    """Some drives of a build are not in the map, or none is. `reports` are of those that are,
    `failed` names the others, with the reason."""

    def __init__(self, reports: Sequence[SessionReport], failed: Sequence[tuple[str, str]]) -> None:
        self.reports, self.failed = tuple(reports), tuple(failed)
        count = len(self.reports) + len(self.failed)
        which = f"{len(self.reports)} of {count} drives are in the map"
        if not reports:
            which = f"None of {count} drives can be built"
        reasons = " ".join(f"{name}: {reason}" for name, reason in self.failed)
        super().__init__(f"{which}. {reasons}")


class BadFrame(NamedTuple):
    """A frame that could not be read, and why."""

    frame_id: str
    reason: str


@dataclass(slots=True)
class StageTimes:
    """Seconds of processor time by stage, summed over threads."""

    decode_s: float = 0.0
    match_s: float = 0.0
    grid_s: float = 0.0
    odometry_s: float = 0.0
    pose_s: float = 0.0
    map_s: float = 0.0

    def add(self, other: StageTimes) -> None:
        """Count those of another part of the work, too."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


@dataclass(slots=True)
class SessionReport:
    """What one recording gave to the map."""

    session: str
    frames: int = 0
    used: int = 0
    rejected: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    ground_refined: int = 0
    fixes: int = 0
    fixes_accepted: int = 0
    distance_m: float = 0.0
    wall_s: float = 0.0
    camera_steps: int = 0
    camera_refusals: int = 0
    camera_refusal_reasons: Counter[str] = field(default_factory=Counter)
    heading_source: str = ""
    heading_sigma_deg: float | None = None
    position_sigma_m: float | None = None
    max_range_m: float = 0.0
    denied_share: float | None = None
    opposed_share: float | None = None
    bad: tuple[BadFrame, ...] = ()
    findings: tuple[Finding, ...] = ()
    stages: StageTimes = field(default_factory=StageTimes)

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.findings))

    @property
    def frames_per_s(self) -> float:
        """Frames read, matched and mapped per second of wall time."""
        return self.frames / self.wall_s if self.wall_s > 0.0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **asdict(self),
            "reasons": dict(self.reasons.most_common()),
            "camera_refusal_reasons": dict(self.camera_refusal_reasons.most_common()),
            "bad": [bad._asdict() for bad in self.bad],
            "findings": [one.as_dict() for one in self.findings],
            "frames_per_s": self.frames_per_s,
        }
