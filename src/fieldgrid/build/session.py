"""The main job, and the only wiring: recordings to a map, or to more sessions of one.

Pose is light and needs the whole drive, so it comes first; perception is heavy and needs no
pose, so frames are matched in parallel and meet their pose in order, one at a time. No image
and no grid stays in memory.
"""

from __future__ import annotations

import hashlib
import os
import time
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.build.perception import Perceived, perceive
from fieldgrid.build.report import Progress, SessionReport
from fieldgrid.errors import ConfigError, GnssError
from fieldgrid.geodesy import Datum
from fieldgrid.localgrid import LocalGridder
from fieldgrid.mapfile import MapFile, Session, create_map, open_map
from fieldgrid.pose import estimate_poses
from fieldgrid.recording import Recording, open_recording
from fieldgrid.recording.stored import StoredRecording
from fieldgrid.rig import Rig
from fieldgrid.settings import BuildSettings
from fieldgrid.trajectory import Pose, Status, Trajectory

NO_GROUND = "no ground was found in the image, so heights above it are not known"
"""Why a frame is rejected whose ground plane could not be refined."""


def estimate_trajectory(
    recording: Recording, settings: BuildSettings | None = None, datum: Datum | None = None
) -> Trajectory:
    """The trajectory of a recording's grid origin; `datum` is the recording's own or first fix.

    Raises GnssError when no fix can be used.
    """
    settings = settings or BuildSettings()
    return estimate_poses(
        recording.fixes(), recording.rig, datum or recording.datum_hint, settings.pose
    )


def add_recording(
    universal: MapFile,
    recording: Recording,
    trajectory: Trajectory,
    settings: BuildSettings | None = None,
    *,
    name: str | None = None,
    every: int = 1,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> SessionReport:
    """Add one drive to an open map as a session: all of it, or nothing.

    Takes every `every`-th frame. The map's bits do not depend on `jobs`, the number of
    threads that decode and match (all cores if None).
    """
    settings = settings or BuildSettings()
    started = time.perf_counter()
    check_poses(recording, trajectory)
    gridder = LocalGridder(recording.rig, settings.grid.spec(), settings.stereo, settings.density)
    report = _opening_report(
        recording.name if name is None else name, recording, trajectory, gridder
    )
    total = len(range(0, recording.frame_count, every))
    frames = (frame for k, frame in enumerate(recording.frames()) if k % every == 0)
    placed: Pose | None = None
    heading_sigma_deg, position_sigma_m = array("d"), array("d")
    with universal.add_session(
        report.session,
        trajectory=trajectory,
        config=session_config(settings, recording.rig, gridder, every),
        source=recording.gnss_source,
        source_sha256=_log_sha256(recording),
    ) as session:
        if progress is not None:
            progress(Progress(report.session, 0, total, 0.0))
        for perceived in perceive(frames, gridder, jobs or os.cpu_count() or 1):
            pose = trajectory.at(perceived.frame.time_ns + recording.rig.image_time_offset_ns)
            if pose.status is Status.OK and not perceived.ground.refined:
                pose = replace(pose, status=Status.REJECTED, reason=NO_GROUND)
            _add_frame(session, perceived, pose, report)
            if pose.status is Status.OK:
                report.distance_m += _step_m(placed, pose)
                heading_sigma_deg.append(pose.heading_sigma_deg)
                position_sigma_m.append(pose.position_sigma_m)
                placed = pose
            if progress is not None:
                progress(Progress(report.session, report.frames, total, report.distance_m))
        _check_any_used(report)
        closing = time.perf_counter()
    report.stages.map_s += time.perf_counter() - closing
    report.wall_s = time.perf_counter() - started
    report.heading_sigma_deg = _median(heading_sigma_deg)
    report.position_sigma_m = _median(position_sigma_m)
    return report


def _add_frame(session: Session, perceived: Perceived, pose: Pose, report: SessionReport) -> None:
    start = time.thread_time()
    frame = perceived.frame
    session.add(
        perceived.grid,
        pose,
        frame_id=frame.frame_id,
        images=(frame.left.name, frame.right.name),
        images_sha256=perceived.images_sha256,
    )
    stages = report.stages
    stages.decode_s += perceived.decode_s
    stages.match_s += perceived.match_s
    stages.grid_s += perceived.grid_s
    stages.map_s += time.thread_time() - start
    report.frames += 1
    report.ground_refined += perceived.ground.refined
    if pose.status is Status.OK:
        report.used += 1
    else:
        report.rejected += 1
        report.reasons[pose.reason] += 1


def check_poses(recording: Recording, trajectory: Trajectory) -> None:
    """Raise GnssError when no image has a usable pose, before the first one is read."""
    if recording.frame_count == 0:
        raise ConfigError(f"Recording {recording.name} holds no frame; record images with it.")
    offset_ns = recording.rig.image_time_offset_ns
    images = recording.frame_times_ns() + offset_ns
    fixes = trajectory.time_ns[trajectory.accepted]
    if fixes.size == 0:
        commonest = Counter(trajectory.reason).most_common(1)[0][0]
        raise GnssError(
            f"None of the {len(trajectory)} fixes gives a pose, mostly because: {commonest}; "
            "choose another log with --gnss or another --heading."
        )
    if images[-1] < fixes[0] or images[0] > fixes[-1]:
        raise GnssError(
            f"Images ({_clock(images[0])} to {_clock(images[-1])}) and fixes "
            f"({_clock(fixes[0])} to {_clock(fixes[-1])}) do not overlap in time; choose the log "
            "of this drive with --gnss, or set image_time_offset_s in recording.toml."
        )
    poses = (trajectory.at(time_ns) for time_ns in images.tolist())
    reasons: Counter[str] = Counter()
    for pose in poses:
        if pose.status is Status.OK:
            return
        reasons[pose.reason] += 1
    raise _none_usable(recording.name, reasons)


def session_config(
    settings: BuildSettings, rig: Rig, gridder: LocalGridder, every: int
) -> dict[str, Any]:
    """The resolved settings and the rig, as they are kept with the session."""
    return {
        "settings": settings.model_dump(mode="json"),
        "rig": asdict(rig),
        "max_range_m": gridder.max_range_m,
        "search": gridder.region._asdict(),
        "every": every,
    }


def _log_sha256(recording: Recording) -> str:
    """The hash of the log of fixes where that is a file, else nothing."""
    if not (isinstance(recording, StoredRecording) and recording.gnss_source):
        return ""
    log = recording.folder / recording.gnss_source
    return hashlib.sha256(log.read_bytes()).hexdigest() if log.is_file() else ""


def _opening_report(
    name: str, recording: Recording, trajectory: Trajectory, gridder: LocalGridder
) -> SessionReport:
    return SessionReport(
        session=name,
        fixes=len(trajectory),
        fixes_accepted=int(trajectory.accepted.sum()),
        heading_source=trajectory.heading_source,
        max_range_m=gridder.max_range_m,
        notes=tuple(recording.notes),
    )


def _check_any_used(report: SessionReport) -> None:
    if report.used == 0:
        raise _none_usable(report.session, report.reasons)


def _none_usable(name: str, reasons: Counter[str]) -> GnssError:
    reason = reasons.most_common(1)[0][0]
    advice = (
        "check the camera's height and tilt in the mounting"
        if reason == NO_GROUND
        else "choose another log with --gnss or another --heading"
    )
    return GnssError(
        f"None of the {reasons.total()} frames of {name} has a usable pose, mostly because: "
        f"{reason}; {advice}."
    )


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _step_m(last: Pose | None, pose: Pose) -> float:
    if last is None:
        return 0.0
    return float(np.hypot(pose.east_m - last.east_m, pose.north_m - last.north_m))


def _clock(time_ns: int) -> str:
    moment = np.datetime64(int(time_ns), "ns")
    return str(np.datetime_as_string(moment, unit="ms")) + "Z"


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
    paths: Sequence[Path],
    out: Path,
    settings: BuildSettings,
    *,
    gnss: str | None = None,
    datum: Datum | None = None,
    append: bool = False,
    overwrite: bool = False,
    name: str | None = None,
    every: int = 1,
    jobs: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> list[SessionReport]:
    """Make the map `out` from recordings, a session each, or append them to it.

    What can be checked is checked before the first image is read. On any error a new map does
    not come to be and an existing one stays as it was, but for the sessions already appended.
    """
    check_output(out, append=append, overwrite=overwrite)
    with ExitStack() as open_things:
        recordings = [open_things.enter_context(open_recording(path, gnss)) for path in paths]
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
        tracks: list[Trajectory] = []
        for recording in recordings:
            tracks.append(estimate_trajectory(recording, settings, datum))
            datum = tracks[0].datum
            check_poses(recording, tracks[-1])
        if not append:
            universal = open_things.enter_context(
                create_map(
                    out,
                    tracks[0].datum,
                    cell_m=settings.universal_cell_m,
                    transfer=settings.map.transfer,
                    overwrite=overwrite,
                )
            )
        return [
            add_recording(
                universal,
                recording,
                track,
                settings,
                name=name,
                every=every,
                jobs=jobs,
                progress=progress,
            )
            for recording, track in zip(recordings, tracks, strict=True)
        ]
