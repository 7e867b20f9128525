"""The main job, and the only wiring: recordings to a map, or to more sessions of one.

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
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.attitude import Attitude
from fieldgrid.build.doubt import camera_notes, doubted_cameras, doubted_rows, sensor_notes
from fieldgrid.build.inputs import Inputs, to_arrays
from fieldgrid.build.perception import CameraMotion, follows_camera, perceive
from fieldgrid.build.poses import (
    check_images,
    check_poses,
    doubted_clock,
    estimate_drive,
    estimate_trajectory,
    no_ground,
    none_usable,
    settle,
)
from fieldgrid.build.report import Progress, SessionReport
from fieldgrid.build.rig_config import rig_to_config
from fieldgrid.errors import ConfigError
from fieldgrid.geodesy import Datum
from fieldgrid.localgrid import LocalGridder
from fieldgrid.mapfile import MapFile, Session, StageFile, create_map, open_map, stage
from fieldgrid.motion import Steps
from fieldgrid.pose import GIVEN, tells_attitude
from fieldgrid.publish import refuse_input
from fieldgrid.recording import DriveOptions, Recording, open_drive
from fieldgrid.rig import Rig, StereoCamera
from fieldgrid.settings import BuildSettings
from fieldgrid.trajectory import Pose, Status, Trajectory
from fieldgrid.transfer import check_cell_sizes


def add_recording(
    universal: MapFile,
    recording: Recording,
    trajectory: Trajectory | None = None,
    settings: BuildSettings | None = None,
    *,
    name: str | None = None,
    every: int = 1,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> SessionReport:
    """Add one drive to an open map as a session: all of it, or nothing.

    Without a `trajectory` it is estimated here, from all that the drive carries and, if the
    settings ask for it, from the motion that the camera saw. Takes every `every`-th frame. The
    map's bits do not depend on `jobs`, the number of threads that decode and match (all cores
    if None).
    """
    settings = settings or BuildSettings()
    started = time.perf_counter()
    gridder = LocalGridder(recording.rig, settings.grid.spec(), settings.stereo, settings.density)
    report = SessionReport(
        session=recording.name if name is None else name,
        max_range_m=gridder.max_range_m,
        notes=(
            *recording.losses,
            *recording.notes,
            *sensor_notes(recording, settings, gridder.max_range_m),
        ),
    )
    # Before the first image is read: the map itself would ask after the last one.
    check_cell_sizes(universal.cell_m, gridder.spec.cell_m)
    check_names([report.session], [info.name for info in universal.sessions()])
    report.notes += settle(doubted_rows(recording, every), settings)
    with StageFile.temporary(universal.path) as staged:
        look = trajectory is None and follows_camera(recording.rig, settings)
        look = look and not recording.pose_name
        attitude = None
        if trajectory is None and tells_attitude(recording.motion()):
            attitude = estimate_drive(recording, settings, universal.datum).report.attitude
        perceiving = _Perceiving(
            recording, gridder, attitude, every, jobs or os.cpu_count() or 1, progress
        )
        steps = perceiving(staged, report, odometry=look)
        found = sum(entry.ground_found for entry in staged.entries)
        report.notes += settle(doubted_cameras(recording, report, found, every), settings)
        if trajectory is None:
            trajectory = _estimated(recording, settings, universal.datum, steps, report)
        else:
            report.fixes, report.fixes_accepted = _fixes_in(recording, trajectory)
        report.heading_source = trajectory.heading_source
        with universal.add_session(
            report.session,
            trajectory=trajectory,
            config=session_config(
                settings,
                recording.rig,
                gridder,
                every,
                level_grids=attitude is not None,
                poses=recording.pose_name if trajectory.heading_source == GIVEN else "",
            ),
            source=recording.gnss_source,
            source_sha256=recording.gnss_sha256(),
            inputs=to_arrays(_inputs(recording, steps, staged)),
        ) as session:
            _place(staged, session, trajectory, recording.rig, report)
            report.notes += tuple(camera_notes(recording, report))
            placed = time.perf_counter()
    report.stages.map_s += time.perf_counter() - placed
    report.wall_s = time.perf_counter() - started
    return report


class _Perceiving(NamedTuple):
    """The first half of a session: every frame to a grid, and its motion since the last one."""

    recording: Recording
    gridder: LocalGridder
    attitude: Attitude | None
    every: int
    jobs: int
    progress: Callable[[Progress], None] | None

    def __call__(self, staged: StageFile, report: SessionReport, *, odometry: bool) -> Steps | None:
        recording, stages = self.recording, report.stages
        total = len(range(0, recording.frame_count, self.every))
        frames = (frame for k, frame in enumerate(recording.frames()) if k % self.every == 0)
        motion = CameraMotion(recording.rig) if odometry else None
        self._tell(report.session, 0, total, motion)
        perceived = perceive(
            frames, self.gridder, self.jobs, odometry=odometry, attitude=self.attitude
        )
        # A traceback that somebody keeps would keep its threads.
        with closing(perceived):
            for seen in perceived:
                start = time.thread_time()
                frame = seen.frame
                time_ns = frame.time_ns + recording.rig.image_time_offset_ns
                names = tuple(source.name for source in frame.sources)
                staged.append(
                    stage(
                        seen.grid,
                        frame.frame_id,
                        time_ns,
                        images=names,
                        images_sha256=seen.sources_sha256,
                        ground_found=seen.ground.refined,
                        channels=seen.ground.channels(),
                    )
                )
                written = time.thread_time()
                if motion is not None and seen.features is not None:
                    motion.add(time_ns, seen.features)
                stages.decode_s += seen.decode_s
                stages.match_s += seen.match_s
                stages.grid_s += seen.grid_s
                stages.map_s += written - start
                stages.odometry_s += seen.odometry_s + time.thread_time() - written
                self._tell(report.session, len(staged), total, motion)
        if motion is None:
            return None
        steps = motion.steps()
        report.camera_steps, report.camera_refusals = len(steps.start_ns), motion.refusals.total()
        report.camera_refusal_reasons = motion.refusals
        return steps

    def _tell(self, session: str, done: int, total: int, motion: CameraMotion | None) -> None:
        if self.progress is not None:
            distance_m = None if motion is None else motion.distance_m
            self.progress(Progress(session, done, total, distance_m))


def _estimated(
    recording: Recording,
    settings: BuildSettings,
    datum: Datum,
    steps: Steps | None,
    report: SessionReport,
) -> Trajectory:
    start = time.perf_counter()
    estimate = estimate_drive(recording, settings, datum, steps)
    report.stages.pose_s += time.perf_counter() - start
    report.notes += estimate.report.notes
    report.fixes = len(estimate.fix_row)
    report.fixes_accepted = int(estimate.trajectory.accepted[estimate.fix_row].sum())
    report.notes += settle(doubted_clock(recording, estimate), settings)
    check_poses(recording, estimate.trajectory)
    return estimate.trajectory


def _fixes_in(recording: Recording, trajectory: Trajectory) -> tuple[int, int]:
    """How many fixes a drive has, and how many of them a trajectory accepts: it has rows of
    other instants, too."""
    times_ns = recording.fixes().time_ns
    accepted_ns = trajectory.time_ns[trajectory.accepted]
    return len(times_ns), int(np.isin(accepted_ns, times_ns).sum())


def _place(
    staged: StageFile, session: Session, trajectory: Trajectory, rig: Rig, report: SessionReport
) -> None:
    """The second half: every staged frame meets its pose."""
    placed: Pose | None = None
    heading_sigma_deg, position_sigma_m = array("d"), array("d")
    start = time.thread_time()
    for k, entry in enumerate(staged.entries):
        pose = trajectory.at(entry.time_ns)
        if pose.status is Status.OK and not entry.ground_found:
            pose = replace(pose, status=Status.REJECTED, reason=no_ground(rig))
        session.add_staged(staged, pose, k)
        report.frames += 1
        report.ground_refined += entry.ground_found
        if pose.status is not Status.OK:
            report.rejected += 1
            report.reasons[pose.reason] += 1
            continue
        report.used += 1
        report.distance_m += _step_m(placed, pose)
        heading_sigma_deg.append(pose.heading_sigma_deg)
        position_sigma_m.append(pose.position_sigma_m)
        placed = pose
    if report.used == 0:
        raise none_usable(report.session, report.reasons, rig)
    report.heading_sigma_deg = _median(heading_sigma_deg)
    report.position_sigma_m = _median(position_sigma_m)
    report.stages.map_s += time.thread_time() - start


def _inputs(recording: Recording, steps: Steps | None, staged: StageFile) -> Inputs:
    motion = recording.motion()._replace(steps=steps)
    times_ns = np.array([entry.time_ns for entry in staged.entries], dtype=np.int64)
    found = np.array([entry.ground_found for entry in staged.entries], dtype=np.bool_)
    return Inputs(recording.fixes(), motion, times_ns, found)


def session_config(
    settings: BuildSettings,
    rig: Rig,
    gridder: LocalGridder,
    every: int,
    *,
    level_grids: bool = False,
    poses: str = "",
) -> dict[str, Any]:
    """The resolved settings and the rig, as they are kept with the session; `level_grids` says
    whether the columns of its local grids are vertical, `poses` what given poses are from."""
    searched = isinstance(rig.sensor, StereoCamera)
    return {
        "settings": settings.model_dump(mode="json"),
        "rig": rig_to_config(rig),
        "max_range_m": gridder.max_range_m,
        **({"search": gridder.region._asdict()} if searched else {}),
        "every": every,
        "level_grids": level_grids,
        **({"poses": poses} if poses else {}),
    }


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _step_m(last: Pose | None, pose: Pose) -> float:
    if last is None:
        return 0.0
    return float(np.hypot(pose.east_m - last.east_m, pose.north_m - last.north_m))


def check_names(names: Sequence[str], taken: Sequence[str]) -> None:
    """Raise before any work is done when a session could not get its name."""
    for k, name in enumerate(names):
        if name in taken:
            raise ConfigError(f"The map has a session {name!r} already; give another with --name.")
        if name in names[:k]:
            raise ConfigError(
                f"Two of the recordings are called {name!r}; build them one after the other, the "
                "second with --append and a --name."
            )


def check_output(path: Path, *, append: bool, overwrite: bool) -> None:
    """Raise before any work is done when the output cannot be what was asked for."""
    if append and overwrite:
        raise ConfigError("--append and --overwrite exclude each other; give one of them.")
    if append and not path.exists():
        raise ConfigError(f"There is no map {path} to append to; leave out --append to make it.")


def build_map(
    paths: Sequence[str | Path],
    out: str | Path,
    settings: BuildSettings,
    options: DriveOptions | None = None,
    *,
    datum: Datum | None = None,
    append: bool = False,
    overwrite: bool = False,
    name: str | None = None,
    every: int = 1,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> list[SessionReport]:
    """Make the map `out` from recordings, a session each, or append them to it.

    Each is opened with `options` as by `open_drive`.
    What can be checked is checked before the first image is read. On any error a new map does
    not come to be and an existing one stays as it was, but for the sessions already appended.
    """
    out = Path(out)
    check_output(out, append=append, overwrite=overwrite)
    if not append:
        refuse_input(out, [Path(path) for path in paths])
    with ExitStack() as open_things:
        recordings = [
            open_things.enter_context(open_drive(path, options)).recording() for path in paths
        ]
        if append:
            with open_map(out) as existing:
                datum = datum or existing.datum
            universal = open_things.enter_context(
                open_map(
                    out, datum=datum, cell_m=settings.map.cell_m, transfer=settings.map.transfer
                )
            )
        taken = [info.name for info in universal.sessions()] if append else []
        check_names([name or recording.name for recording in recordings], taken)
        datum = _checked(recordings, settings, datum)
        if not append:
            universal = open_things.enter_context(
                create_map(
                    out,
                    datum,
                    cell_m=settings.universal_cell_m,
                    transfer=settings.map.transfer,
                    overwrite=overwrite,
                )
            )
        return [
            add_recording(
                universal,
                recording,
                None,
                settings,
                name=name,
                every=every,
                jobs=jobs,
                progress=progress,
            )
            for recording in recordings
        ]


def _checked(
    recordings: Sequence[Recording], settings: BuildSettings, datum: Datum | None
) -> Datum:
    """The datum of the map, after a look at what can be known before the first image is read."""
    for recording in recordings:
        trajectory = estimate_trajectory(recording, settings, datum)
        datum = datum or trajectory.datum
        check_images(recording, trajectory)
        if recording.pose_name or not follows_camera(recording.rig, settings):
            check_poses(recording, trajectory)
    assert datum is not None  # there is at least one recording
    return datum
