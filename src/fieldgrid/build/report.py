"""What a build says of itself: while it runs, and when it is done."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a build is: what a progress line shows. The distance is the camera's, None
    where it is not followed."""

    session: str
    frames_done: int
    frames_total: int
    distance_m: float | None = None


@dataclass(slots=True)
class StageTimes:
    """Seconds of processor time by stage, summed over threads."""

    decode_s: float = 0.0
    match_s: float = 0.0
    grid_s: float = 0.0
    odometry_s: float = 0.0
    pose_s: float = 0.0
    map_s: float = 0.0


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
    notes: tuple[str, ...] = ()
    stages: StageTimes = field(default_factory=StageTimes)

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
            "notes": list(self.notes),
            "frames_per_s": self.frames_per_s,
        }
