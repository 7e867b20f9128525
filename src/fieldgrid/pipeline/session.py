"""A recording on its way into a map, as a session.

Perception is heavy and needs no pose, so frames are matched in parallel; each gives a grid and
the camera's motion since the one before. Pose needs the whole drive, that motion included, so
the grids wait for it on disk and meet it in order, one at a time. No image and no grid stays in
memory.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import (
    BuildSettings,
    CalibrationError,
    Finding,
    RecordingError,
    info,
)
from fieldgrid.geometry import Datum, GridSpec, Lidar, Rig, Status, StereoCamera, Trajectory
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
    cell_findings,
    misalignment,
    probed_images,
    row_findings,
    sensor_findings,
    sweep_findings,
)
from fieldgrid.pipeline.checks.format_hints import format_hints, hint_sentence
from fieldgrid.pipeline.checks.mirrored import mirror_findings
from fieldgrid.pipeline.checks.sensor_yaw import sensor_yaw, sensor_yaw_findings
from fieldgrid.pipeline.inputs import Inputs, to_arrays
from fieldgrid.pipeline.inspection.images import image_findings
from fieldgrid.pipeline.poses import (
    check_images,
    check_poses,
    estimate_drive,
    frame_poses,
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
from fieldgrid.pipeline.targets import check_names, exists_already, is_in_map
from fieldgrid.poses import GIVEN, levelling_attitude
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
    session = NewSession(recording, settings or BuildSettings(), universal.datum, name)
    check_names([session.name], [one.name for one in universal.sessions()])
    session.check(universal)
    with session.parts(universal.path, universal.datum, progress) as parts:
        try:
            parts.tell()
            parts.stage(jobs or os.cpu_count() or 1)
            session.put(universal, parts.staged())
        finally:
            parts.remove()
    session.report.wall_s = time.perf_counter() - started
    return session.report


class NewSession:
    """A recording on its way into a map, as a session of its own.

    Its frames are staged by whoever likes (`work`; it can be pickled), and then placed (`put`) by a
    trajectory that is estimated, of the drive and of what was staged. `datum` is that of its poses,
    `attitude` tells how the vehicle leans, if the drive does.
    """

    def __init__(
        self,
        recording: Recording,
        settings: BuildSettings,
        datum: Datum | None,
        name: str | None,
        *,
        every: int = 1,
        skip_bad: int | float = 0,
        levels: bool = True,
    ) -> None:
        """Once what the poses show, as they are known before a frame is staged, is good enough.
        Of the frames at most `skip_bad` may be bad, a number or, below 1, a share of them. Grids
        are to be level by the attitude, if it `levels` them; the points of sweeps are carried to
        their stamps by the poses."""
        self.recording, self.settings, self._skip_bad = recording, settings, skip_bad
        self.name = recording.name if name is None else name
        trajectory, _, said, _ = estimate_drive(recording, settings, datum)
        check_images(recording, trajectory)
        odometry = follows_camera(recording.rig, settings) and not recording.pose_name
        if not odometry:
            check_poses(recording, trajectory)
        settled(cell_findings(trajectory, settings), settings)
        self.datum, self.attitude = trajectory.datum, levelling_attitude(said.attitude)
        gridder = LocalGridder(
            recording.rig, GridSpec.of(settings.grid), settings.stereo, settings.density
        )
        self.work = DriveWork(
            recording.source,
            len(range(0, recording.frame_count, every)),
            gridder,
            self.attitude if levels else None,
            OriginTrack.of(trajectory) if isinstance(recording.rig.sensor, Lidar) else None,
            every,
            odometry,
            skip_bad > 0,
        )
        self.report = SessionReport(
            session=self.name,
            max_range_m=gridder.max_range_m,
            findings=(
                *told_of(recording),
                *sensor_findings(recording, settings, gridder.max_range_m),
                *sweep_findings(recording, every),
            ),
        )

    def parts(
        self, out: Path, datum: Datum, progress: Callable[[Progress], None] | None
    ) -> DriveParts:
        """What is staged of it on its way into the map `out`."""
        digest = recording_digest(self.recording, self.work.total, self.work.every)
        about = self.name, self.recording.rig, self.settings, datum
        start = DriveStart(*about, recording=digest)
        return DriveParts(out, start, self.work, self._skip_bad, progress)

    def check(self, universal: MapFile, *, adds: bool = True) -> None:
        """Raise before the drive is staged what the map would refuse at its end, and what some
        of the frames show. A map to which none `adds` has the drives that were put there, and a
        drive that is there already was checked then."""
        if self.name in [one.name for one in universal.sessions()]:
            return
        if not adds:
            raise exists_already(universal.path)
        every = self.work.every
        check_cell_sizes(universal.cell_m, self.work.gridder.spec.cell_m)
        images = tuple(probed_images(self.recording, every))
        rows = misalignment(self.recording, images)
        self._tell(*row_findings(self.recording, every, rows), *image_findings(images))

    def put(self, universal: MapFile, staged: KeptDrive) -> None:
        """Put the session into the map, with the frames that were staged: poses are estimated from
        the whole drive, and frames are placed by them. One that is there already, by an end that
        was killed, stays as it is; ConfigError where that has other frames."""
        recording, settings, report = self.recording, self.settings, self.report
        report.frames, report.bad = len(staged.frames), tuple(staged.bad.values())
        if self.name in [one.name for one in universal.sessions()]:
            if not is_in_map(universal, self.name, staged):
                check_names([self.name], [self.name])
            self._tell(info("in-map", "The drive was in the map already."))
            return
        report.stages.add(staged.times)
        if not staged.frames:
            raise RecordingError(
                f"None of the {self.work.total} frames of {self.name} can be read. "
                f"First: {report.bad[0].reason}"
            )
        steps, every, gridder = None, self.work.every, self.work.gridder
        if self.work.odometry:
            steps, report.camera_refusal_reasons = staged.steps()
            report.camera_steps = len(steps.start_ns)
            report.camera_refusals = report.camera_refusal_reasons.total()
        found = report.ground_refined = sum(frame.entry.ground_found for frame in staged.frames)
        if not found and (readings := format_hints(recording, gridder, every)):
            raise CalibrationError(
                f"No ground was found in the {len(staged.frames)} frames of {self.name}, so "
                f"heights above it are not known. {hint_sentence(readings)}"
            )
        self._tell(*camera_findings(recording, report, found, every))
        is_level, start = self.work.attitude is not None, time.perf_counter()
        estimate = estimate_drive(recording, settings, universal.datum, steps, level_grids=is_level)
        trajectory = estimate.trajectory
        report.stages.pose_s += time.perf_counter() - start
        report.fixes = len(estimate.fix_row)
        report.fixes_accepted = int(trajectory.accepted[estimate.fix_row].sum())
        scale = camera_scale(steps, trajectory, heights_told=tells_heights(recording.fixes()))
        self._tell(
            *mirror_findings(recording, trajectory, steps),
            *estimate.report.findings,
            *scale_findings(scale, recording.rig),
        )
        del estimate  # of a long drive it takes more than all that follows
        check_poses(recording, trajectory)
        report.heading_source = trajectory.heading_source
        with universal.add_session(
            self.name,
            trajectory=trajectory,
            config=session_config(
                settings,
                recording.rig,
                gridder,
                every,
                level_grids=is_level,
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
            self._tell(
                *agreement_findings(report.denied_share, recording.rig),
                *opposed_findings(report.opposed_share, report.position_sigma_m),
                *sensor_yaw_findings(yaw, recording.rig),
                *after_findings(recording, report),
            )
            placed = time.perf_counter()
        report.stages.map_s += time.perf_counter() - placed

    def _tell(self, *found: Finding) -> None:
        """Findings for the report; RecordingError for an error that is not accepted."""
        self.report.findings += settled(found, self.settings)


def _place(
    staged: KeptDrive, session: Session, trajectory: Trajectory, rig: Rig, report: SessionReport
) -> list[FramePose]:
    """The second half: every staged frame meets its pose. Returns those that are accepted."""
    accepted, start = list[FramePose](), time.thread_time()
    seen = (
        (frame.entry.time_ns, frame.entry.ground_found, staged[k].images_sha256)
        for k, frame in enumerate(staged.frames)
    )
    for k, pose in enumerate(frame_poses(trajectory, rig, seen)):
        session.add_staged(staged, pose, k)
        if pose.status is Status.OK:
            accepted.append((k, pose))
        else:
            report.reasons[pose.reason] += 1
    report.used, report.rejected = len(accepted), report.reasons.total()
    if not accepted:
        raise none_usable(report.session, report.reasons, rig)
    way = pairwise(pose for _, pose in accepted)
    report.distance_m = sum(math.hypot(b.east_m - a.east_m, b.north_m - a.north_m) for a, b in way)
    report.heading_sigma_deg = float(np.median([pose.heading_sigma_deg for _, pose in accepted]))
    report.position_sigma_m = float(np.median([pose.position_sigma_m for _, pose in accepted]))
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
