"""A recording on its way into a map, as a session.

Perception is heavy and needs no pose, so frames are matched in parallel; each gives a grid and
the camera's motion since the one before. Pose needs the whole drive, that motion included, so
the grids wait for it on disk and meet it in order, one at a time. No image and no grid stays in
memory.
"""

from __future__ import annotations

import os
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import BuildSettings, CalibrationError, RecordingError, info
from fieldgrid.geometry import Datum, GridSpec, Rig, Status, Steps, StereoCamera, Trajectory
from fieldgrid.maps import (
    MapFile,
    Session,
    check_cell_sizes,
)
from fieldgrid.perception import LocalGridder, OriginTrack
from fieldgrid.pipeline.checks.agreement import (
    agreement_findings,
    denied_share,
    opposed_findings,
    opposed_share,
)
from fieldgrid.pipeline.checks.camera_scale import camera_scale, scale_findings, tells_heights
from fieldgrid.pipeline.checks.contradictions import FramePose
from fieldgrid.pipeline.checks.doubt import (
    after_findings,
    camera_findings,
    has_sweeps,
    misalignment,
    probed_images,
    row_findings,
    sensor_findings,
    sweep_findings,
)
from fieldgrid.pipeline.checks.format_hints import format_hints, hint_sentence
from fieldgrid.pipeline.checks.mirrored import mirror_findings
from fieldgrid.pipeline.checks.sensor_yaw import sensor_yaw, sensor_yaw_findings
from fieldgrid.pipeline.checks.stuck import StuckCamera
from fieldgrid.pipeline.inputs import Inputs, to_arrays
from fieldgrid.pipeline.inspection.images import image_findings
from fieldgrid.pipeline.poses import (
    check_images,
    check_poses,
    estimate_drive,
    no_ground,
    none_usable,
    settled,
    told_of,
)
from fieldgrid.pipeline.report import BadFrame, Progress, SessionReport
from fieldgrid.pipeline.staging.drive_start import DriveStart, recording_digest
from fieldgrid.pipeline.staging.kept_frames import KeptDrive
from fieldgrid.pipeline.staging.parts import DriveParts
from fieldgrid.pipeline.staging.perception import follows_camera
from fieldgrid.pipeline.staging.shares import DriveWork
from fieldgrid.pipeline.targets import check_names, is_in_map
from fieldgrid.poses import GIVEN, Attitude, Estimate, levelling_attitude
from fieldgrid.recordings import Recording

BAD_KEPT = 1000
"""Frames that could not be read which a session names; it counts all of them."""


def add_recording(
    universal: MapFile,
    recording: Recording,
    settings: BuildSettings | None = None,
    *,
    name: str | None = None,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> SessionReport:
    """Add one drive to an open map as a session: all of it, or nothing.

    Its trajectory is estimated from all that the drive carries and, if the settings ask for it,
    from the motion that the camera saw. The map's bits do not depend on `jobs`, the number of
    threads that decode and match (all cores if None).
    """
    started = time.perf_counter()
    session, _ = prepared(recording, settings or BuildSettings(), universal.datum, name)
    session.check(universal)
    with session.parts(universal.path, universal.datum, progress) as parts:
        try:
            parts.tell()
            parts.stage(session.work(), jobs or os.cpu_count() or 1)
            session.add(universal, parts.staged())
        finally:
            parts.remove()
    session.report.wall_s = time.perf_counter() - started
    return session.report


def prepared(
    recording: Recording,
    settings: BuildSettings,
    datum: Datum | None,
    name: str | None,
    *,
    every: int = 1,
    skips_bad: bool = False,
    levels: bool = True,
) -> tuple[NewSession, Estimate]:
    """A session of a recording, and its poses as they are known before a frame is staged, once what
    these and some images show is good enough. Grids are to be level where the drive tells how its
    vehicle leans, if it `levels` them."""
    estimate = estimate_drive(recording, settings, datum)
    trajectory = estimate.trajectory
    check_images(recording, trajectory)
    if recording.pose_name or not follows_camera(recording.rig, settings):
        check_poses(recording, trajectory)
    attitude = levelling_attitude(estimate.report.attitude) if levels else None
    session = NewSession(
        recording, settings, attitude, name, every, skips_bad=skips_bad, known=trajectory
    )
    return session, estimate


class NewSession:
    """A recording on its way into a map, as a session of its own.

    Its frames are staged by whoever likes (`work`), and then placed (`add`) by a trajectory that is
    estimated, of local grids that are levelled by the `attitude`. By `known`, the trajectory as it
    is known before a frame is staged, the points of sweeps are carried to their stamps.
    """

    def __init__(
        self,
        recording: Recording,
        settings: BuildSettings,
        attitude: Attitude | None,
        name: str | None,
        every: int = 1,
        *,
        skips_bad: bool = False,
        known: Trajectory | None = None,
    ) -> None:
        self.recording, self.settings = recording, settings
        self.name = recording.name if name is None else name
        self.total = len(range(0, recording.frame_count, every))
        self.odometry = follows_camera(recording.rig, settings) and not recording.pose_name
        self._attitude, self.every, self._skips_bad = attitude, every, skips_bad
        self._way = None
        if known is not None and has_sweeps(recording):
            self._way = OriginTrack.of(known)
        self._gridder = LocalGridder(
            recording.rig, GridSpec.of(settings.grid), settings.stereo, settings.density
        )
        self.report = SessionReport(
            session=self.name,
            max_range_m=self._gridder.max_range_m,
            findings=(
                *told_of(recording),
                *sensor_findings(recording, settings, self._gridder.max_range_m),
                *sweep_findings(recording, every, is_carried=self._way is not None),
            ),
        )

    def work(self) -> DriveWork:
        """What it takes to stage the frames; it can be pickled."""
        return DriveWork(
            self.recording.source,
            self.total,
            self._gridder,
            self._attitude,
            self._way,
            self.every,
            self.odometry,
            self._skips_bad,
        )

    def parts(
        self, out: Path, datum: Datum, progress: Callable[[Progress], None] | None
    ) -> DriveParts:
        """What is staged of it on its way into the map `out`."""
        digest = recording_digest(self.recording, self.total, self.every)
        about = self.name, self.recording.rig, self.settings, datum
        start = DriveStart(*about, recording=digest)
        return DriveParts(out, start, self.total, odometry=self.odometry, progress=progress)

    def check(self, universal: MapFile) -> None:
        """Raise before the drive is staged what the map would refuse at its end, and what some
        of the frames show."""
        check_cell_sizes(universal.cell_m, self._gridder.spec.cell_m)
        check_names([self.name], [info.name for info in universal.sessions()])
        images = tuple(probed_images(self.recording, self.every))
        rows = misalignment(self.recording, images)
        found = (*row_findings(self.recording, self.every, rows), *image_findings(images))
        self.report.findings += settled(found, self.settings)

    def add(self, universal: MapFile, staged: KeptDrive) -> None:
        """Add the session to the map, with the frames that were staged."""
        recording, settings, report = self.recording, self.settings, self.report
        report.stages.add(staged.times)
        report.bad = tuple(staged.bad.values())
        if not staged.frames:
            raise RecordingError(
                f"None of the {self.total} frames of {self.name} can be read. "
                f"First: {report.bad[0].reason}"
            )
        steps = None
        if self.odometry:
            steps, report.camera_refusal_reasons = staged.steps()
            report.camera_steps = len(steps.start_ns)
            report.camera_refusals = report.camera_refusal_reasons.total()
        found = sum(frame.entry.ground_found for frame in staged.frames)
        if not found and (readings := format_hints(recording, self._gridder, self.every)):
            raise CalibrationError(
                f"No ground was found in the {len(staged.frames)} frames of {self.name}, so "
                f"heights above it are not known. {hint_sentence(readings)}"
            )
        report.findings += settled(camera_findings(recording, report, found, self.every), settings)
        trajectory = self._estimated(universal.datum, steps)
        report.heading_source = trajectory.heading_source
        with universal.add_session(
            self.name,
            trajectory=trajectory,
            config=session_config(
                settings,
                recording.rig,
                self._gridder,
                self.every,
                level_grids=self._attitude is not None,
                poses=recording.pose_name if trajectory.heading_source == GIVEN else "",
                bad=report.bad,
            ),
            source=recording.gnss_source,
            source_sha256=recording.gnss_sha256(),
            inputs=to_arrays(
                Inputs(
                    recording.fixes(),
                    recording.motion()._replace(steps=steps),
                    np.array([frame.entry.time_ns for frame in staged.frames], dtype=np.int64),
                    np.array([frame.entry.ground_found for frame in staged.frames], dtype=np.bool_),
                )
            ),
        ) as session:
            accepted = _place(staged, session, trajectory, recording.rig, report)
            report.denied_share = denied_share(staged, accepted)
            report.opposed_share = opposed_share(staged, accepted)
            # Steps of the camera tell its yaw better.
            yaw = None if report.camera_steps else sensor_yaw(staged, accepted)
            told = (
                *agreement_findings(report.denied_share, recording.rig),
                *opposed_findings(report.opposed_share, report.position_sigma_m),
                *sensor_yaw_findings(yaw, recording.rig),
                *after_findings(recording, report),
            )
            report.findings += settled(told, settings)
            placed = time.perf_counter()
        report.stages.map_s += time.perf_counter() - placed

    def put(self, universal: MapFile, staged: KeptDrive, taken: Sequence[str]) -> None:
        """`add`, unless an end that was killed has done so: then the session is among those that
        are `taken`. ConfigError where that has other frames."""
        if self.name not in taken:
            self.add(universal, staged)
            return
        if not is_in_map(universal, self.name, staged):
            check_names([self.name], taken)
        self.report.findings += (info("in-map", "The drive was in the map already."),)
        self.report.frames = len(staged.frames)

    def _estimated(self, datum: Datum, steps: Steps | None) -> Trajectory:
        recording, report = self.recording, self.report
        start = time.perf_counter()
        estimate = estimate_drive(
            recording, self.settings, datum, steps, level_grids=self._attitude is not None
        )
        report.stages.pose_s += time.perf_counter() - start
        report.fixes = len(estimate.fix_row)
        report.fixes_accepted = int(estimate.trajectory.accepted[estimate.fix_row].sum())
        scale = camera_scale(
            steps, estimate.trajectory, heights_told=tells_heights(recording.fixes())
        )
        told = (
            *mirror_findings(recording, estimate.trajectory, steps),
            *estimate.report.findings,
            *scale_findings(scale, recording.rig),
        )
        report.findings += settled(told, self.settings)
        check_poses(recording, estimate.trajectory)
        return estimate.trajectory


def _place(
    staged: KeptDrive, session: Session, trajectory: Trajectory, rig: Rig, report: SessionReport
) -> list[FramePose]:
    """The second half: every staged frame meets its pose. Returns those that are accepted."""
    accepted: list[FramePose] = []
    heading_sigma_deg, position_sigma_m = array("d"), array("d")
    start, camera = time.thread_time(), StuckCamera()
    for k, (_, entry, *_) in enumerate(staged.frames):
        pose = trajectory.at(entry.time_ns)
        if pose.status is Status.OK and not entry.ground_found:
            pose = replace(pose, status=Status.REJECTED, reason=no_ground(rig))
        camera, pose = camera.judged(staged[k].images_sha256, pose)
        session.add_staged(staged, pose, k)
        report.frames += 1
        report.ground_refined += entry.ground_found
        if pose.status is not Status.OK:
            report.rejected += 1
            report.reasons[pose.reason] += 1
            continue
        report.used += 1
        if accepted:
            last = accepted[-1][1]
            report.distance_m += float(
                np.hypot(pose.east_m - last.east_m, pose.north_m - last.north_m)
            )
        heading_sigma_deg.append(pose.heading_sigma_deg)
        position_sigma_m.append(pose.position_sigma_m)
        accepted.append((k, pose))
    if report.used == 0:
        raise none_usable(report.session, report.reasons, rig)
    report.heading_sigma_deg = _median(heading_sigma_deg)
    report.position_sigma_m = _median(position_sigma_m)
    report.stages.map_s += time.thread_time() - start
    return accepted


def session_config(
    settings: BuildSettings,
    rig: Rig,
    gridder: LocalGridder,
    every: int,
    *,
    level_grids: bool = False,
    poses: str = "",
    bad: Sequence[BadFrame] = (),
) -> dict[str, Any]:
    """The resolved settings and the rig, as they are kept with the session; `level_grids` says
    whether the columns of its local grids are vertical, `poses` what given poses are from, `bad`
    which frames were left out since they cannot be read."""
    searched = isinstance(rig.sensor, StereoCamera)
    return {
        "settings": settings.model_dump(mode="json"),
        "rig": rig.as_dict(),
        "max_range_m": gridder.max_range_m,
        **({"search": gridder.region._asdict()} if searched else {}),
        "every": every,
        "level_grids": level_grids,
        **({"poses": poses} if poses else {}),
        **({"bad_frames": len(bad), "bad": [list(one) for one in bad[:BAD_KEPT]]} if bad else {}),
    }


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
