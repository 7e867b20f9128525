"""Poses estimated again, from what the map itself keeps: no image and no recording is needed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from fieldgrid.core import (
    BuildSettings,
    CalibrationError,
    ConfigError,
    FieldgridError,
    Finding,
    MapError,
    Severity,
    info,
    quoted,
    shortened,
)
from fieldgrid.geometry import GridSpec, Lidar, Pose, Rig, Status, Trajectory, wrap_deg
from fieldgrid.maps import MapFile, Patience, SessionInfo, open_map
from fieldgrid.perception import OriginTrack, Sweep
from fieldgrid.pipeline.inputs import Inputs, from_arrays
from fieldgrid.pipeline.poses import cell_budget, frame_poses
from fieldgrid.poses import Attitude, Estimate, estimate_poses

SWEEP_S = 0.1
"""How long the sweep of a lidar usually takes."""


@dataclass(frozen=True, slots=True)
class ReposeReport:
    """What estimating a session's poses again has changed.

    `moved_m` and `turned_deg` are the medians and largest changes of the frames used both
    before and after; None where there are none.
    """

    session: str
    frames: int
    used_before: int
    used: int
    heading_source: str
    heading_sigma_deg: float | None
    moved_m: tuple[float, float] | None
    turned_deg: tuple[float, float] | None
    reasons: Mapping[str, int]
    findings: tuple[Finding, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **asdict(self),
            "reasons": dict(self.reasons),
            "findings": [one.as_dict() for one in self.findings],
        }


def repose_map(
    path: str | Path,
    pose_settings: Mapping[str, Any] | None = None,
    name: str | None = None,
    *,
    patience: Patience | None = None,
) -> list[ReposeReport]:
    """Estimate the poses of one or all active sessions of a map again.

    Each keeps the settings it was built with, but for those of `pose_settings`. A session is
    changed as a whole or not at all; those before a failing one stay changed.
    `patience` is how long another writer of the map is waited for.
    """
    with open_map(path, writable=True, patience=patience or Patience()) as universal:
        sessions = [s for s in universal.sessions() if s.removed is None]
        if name is not None:
            sessions = [session for session in sessions if session.name == name]
            if not sessions:
                raise ConfigError(
                    f"{path} has no active session {quoted(name)}; fieldgrid sessions lists them."
                )
        return [_repose(universal, session, pose_settings or {}) for session in sessions]


class Attitudes(NamedTuple):
    """Roll and pitch by session, and why those of others cannot be estimated."""

    by_session: dict[str, Attitude]
    left_out: dict[str, str]


def attitudes_of(universal: MapFile) -> Attitudes:
    """Roll and pitch of the active sessions that tell them, estimated again from what the map
    keeps, and why those of others cannot be estimated, both by session. Sessions without their
    fixes are passed over; one that cannot be estimated again, as of settings that this version does
    not take, is left out, and the reason given."""
    by_session, left_out = dict[str, Attitude](), dict[str, str]()
    for session in universal.sessions():
        try:
            arrays = universal.session_inputs(session.name) if session.active else {}
            if "fix.time_ns" in arrays:
                inputs, settings = from_arrays(arrays), _settings(session, {})
                attitude = _estimate(universal, session, inputs, settings).report.attitude
                if attitude is not None:
                    by_session[session.name] = attitude
        except FieldgridError as error:
            left_out[session.name] = str(error)
    return Attitudes(by_session, left_out)


def _repose(
    universal: MapFile, session: SessionInfo, pose_settings: Mapping[str, Any]
) -> ReposeReport:
    settings = _settings(session, pose_settings)
    inputs = from_arrays(universal.session_inputs(session.name))
    rig = _rig(session)
    estimate = _estimate(universal, session, inputs, settings)
    found = dict(zip(inputs.frame_ns.tolist(), inputs.ground_found.tolist(), strict=True))
    frames = sorted(universal.frames(session.name), key=lambda frame: frame.driven.time_ns)
    before = {frame.frame_id: frame.driven for frame in frames}
    seen = (
        (one.driven.time_ns, found.get(one.driven.time_ns, True), one.images_sha256)
        for one in frames
    )
    after = dict(zip(before, frame_poses(estimate.trajectory, rig, seen), strict=True))
    config = {**session.config, "settings": settings.model_dump(mode="json")}
    # What would stop a build stops no new poses of a drive that is in the map.
    findings = tuple(
        replace(one, severity=Severity.WARNING) if one.severity is Severity.ERROR else one
        for one in estimate.report.findings
    )
    if isinstance(rig.sensor, Lidar):
        driven = universal.trajectory(session.name, as_driven=True)
        used_ns = [pose.time_ns for pose in after.values() if pose.status is Status.OK]
        findings += (_of_sweeps(driven, estimate.trajectory, used_ns, settings),)
    universal.repose(session.name, after, estimate.trajectory, config)
    return _report(session.name, before, after, estimate, findings)


def _of_sweeps(
    old: Trajectory, new: Trajectory, frame_ns: list[int], settings: BuildSettings
) -> Finding:
    """What the new poses change of the motion within a sweep, whose points the map does not have
    any more."""
    ways = OriginTrack.of(old), OriginTrack.of(new)
    reach_m, cell_m = GridSpec.of(settings.grid).reach_m, settings.grid.cell_m
    sides = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], dtype=np.float32)
    ends = Sweep(np.float32(reach_m) * sides, np.full(3, SWEEP_S, dtype=np.float32))
    off_m = 0.0
    for time_ns in frame_ns:
        before, after = (way.carried(ends, time_ns, np.eye(3)) for way in ways)
        off_m = max(off_m, float(np.linalg.norm(after - before, axis=1).max()))
    end = "which is less than half a cell"
    if off_m > cell_m / 2.0:
        end = "so build the drive again to have them there"
    return info(
        "sweep",
        f"The points of a sweep stay where they were put by the poses of before; by the new ones "
        f"the last of {SWEEP_S} s would lie up to {off_m:.3f} m elsewhere, {end}.",
    )


def _settings(session: SessionInfo, pose_settings: Mapping[str, Any]) -> BuildSettings:
    stored = session.config.get("settings", {})
    pose = {**stored.get("pose", {}), **pose_settings}
    # Older versions had a limit of the climb, too.
    gates = {name: one for name, one in pose.get("gnss", {}).items() if name != "max_climb_mps"}
    tables = {**stored, "pose": {**pose, "gnss": gates}}
    try:
        return BuildSettings.model_validate(tables)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"Session {quoted(session.name)} was built with settings that this version does not "
            f"take: {'.'.join(str(part) for part in first['loc'])} = "
            f"{shortened(repr(first['input']), 60)}."
        ) from error


def _rig(session: SessionInfo) -> Rig:
    """The rig of a session; MapError where its config does not describe one."""
    try:
        return Rig.from_dict(session.config.get("rig", {}))
    except CalibrationError as error:
        raise MapError(
            f"Session {quoted(session.name)} does not say what rig it was driven with ({error}); "
            "build it again from its recording."
        ) from error


def _estimate(
    universal: MapFile, session: SessionInfo, inputs: Inputs, settings: BuildSettings
) -> Estimate:
    motion, rig = inputs.motion, _rig(session)
    if not settings.pose.uses_camera:
        motion = motion._replace(steps=None)
    return estimate_poses(
        inputs.fixes,
        rig,
        universal.datum,
        settings.pose,
        motion,
        cell_budget(rig, settings),
        frame_ns=inputs.frame_ns,
        level_grids=bool(session.config.get("level_grids", False)),
    )


def _report(
    name: str,
    before: Mapping[str, Pose],
    after: Mapping[str, Pose],
    estimate: Estimate,
    findings: tuple[Finding, ...],
) -> ReposeReport:
    used = [key for key, pose in after.items() if pose.status is Status.OK]
    both = [(before[k], after[k]) for k in used if before[k].status is Status.OK]
    moved = [np.hypot(b.east_m - a.east_m, b.north_m - a.north_m) for a, b in both]
    turned = [abs(float(wrap_deg(b.heading_deg - a.heading_deg))) for a, b in both]
    sigmas = [after[key].heading_sigma_deg for key in used]
    return ReposeReport(
        session=name,
        frames=len(after),
        used_before=sum(pose.status is Status.OK for pose in before.values()),
        used=len(used),
        heading_source=estimate.trajectory.heading_source,
        heading_sigma_deg=float(np.median(sigmas)) if sigmas else None,
        moved_m=_middle_and_most(moved),
        turned_deg=_middle_and_most(turned),
        reasons=Counter(p.reason for p in after.values() if p.status is not Status.OK),
        findings=findings,
    )


def _middle_and_most(values: list[float]) -> tuple[float, float] | None:
    return (float(np.median(values)), float(np.max(values))) if values else None
