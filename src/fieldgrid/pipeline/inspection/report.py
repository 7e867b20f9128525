"""What an inspection brings: the drive in numbers, and the findings."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import Any

from fieldgrid.core import Finding, Severity
from fieldgrid.geometry import Rig, Trajectory
from fieldgrid.perception import Misalignment
from fieldgrid.pipeline.checks.camera_scale import CameraScale
from fieldgrid.pipeline.inspection.coverage import ExpectedMap
from fieldgrid.pipeline.inspection.fixes import FixSummary, Sync
from fieldgrid.pipeline.inspection.measures import PairMeasures
from fieldgrid.pipeline.inspection.streams import StreamSummary
from fieldgrid.pipeline.mounting.estimate import MountEstimate
from fieldgrid.poses import ClockOffset


@dataclass(frozen=True, slots=True)
class Inspection:
    """What is in a recording and what would go wrong with it.

    Whatever could not be found out is None or empty; `frames` are None where images lie there that
    cannot be opened as frames. `looked` frames were looked at closely and
    `followed` ones for the camera's motion, of `frames`. `reasons` count the frames that would
    have no usable pose; `declared_offset_s` is what image times are moved by already.
    """

    path: str
    kind: str
    name: str
    findings: tuple[Finding, ...]
    duration_s: float | None = None
    streams: tuple[StreamSummary, ...] = ()
    gnss_source: str = ""
    rig: Rig | None = None
    frames: int | None = 0
    looked: int = 0
    followed: int = 0
    camera_steps: int = 0
    camera_pairs: int = 0
    declared_offset_s: float = 0.0
    fixes: FixSummary | None = None
    sync: Sync | None = None
    clock: ClockOffset | None = None
    reasons: Counter[str] = field(default_factory=Counter)
    looks: tuple[PairMeasures, ...] = ()
    misalignment: Misalignment | None = None
    mount: MountEstimate | None = None
    scale: CameraScale | None = None
    coverage: ExpectedMap | None = None
    trajectory: Trajectory | None = None

    @property
    def builds(self) -> bool:
        """Whether `build` would make a map of it, as far as was looked at, and nothing accepted."""
        return all(finding.severity is not Severity.ERROR for finding in self.findings)

    @property
    def frames_usable(self) -> int | None:
        """How many frames would have a usable pose."""
        if self.frames is None or self.trajectory is None:
            return None
        return self.frames - self.reasons.total()

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is unknown is null."""
        known: dict[str, Any] = _known(
            {
                "path": self.path,
                "kind": self.kind,
                "name": self.name,
                "builds": self.builds,
                "findings": [finding.as_dict() for finding in self.findings],
                "duration_s": self.duration_s,
                "streams": [stream._asdict() for stream in self.streams],
                "gnss": self.gnss_source,
                "rig": None
                if self.rig is None
                else {"sensor_kind": type(self.rig.sensor).__name__, **asdict(self.rig)},
                "frames": self.frames,
                "frames_looked_at": self.looked,
                "frames_followed": self.followed,
                "camera_steps": self.camera_steps,
                "camera_pairs": self.camera_pairs,
                "declared_offset_s": self.declared_offset_s,
                "fixes": None if self.fixes is None else self.fixes.as_dict(),
                "image_to_fix": None if self.sync is None else self.sync._asdict(),
                "clock_offset": None if self.clock is None else self.clock._asdict(),
                "frames_usable": self.frames_usable,
                "frames_rejected": dict(self.reasons.most_common()),
                "images": [look.as_dict() for look in self.looks],
                "vertical": None if self.misalignment is None else self.misalignment.as_dict(),
                "mount": None if self.mount is None else self.mount.as_dict(),
                "scale": None if self.scale is None else self.scale._asdict(),
                "coverage": None if self.coverage is None else self.coverage._asdict(),
            }
        )
        return known


def _known(value: Any) -> Any:
    """A value for JSON, with None in place of numbers that JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _known(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_known(inner) for inner in value]
    return value
