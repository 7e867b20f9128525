"""What an inspection says of a drive, step by step in the order of a build.

Each step gives the report with what it has found out, and adds to the findings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from fieldgrid.build.camera_scale import (
    camera_scale,
    doubted_scale,
    scale_notes,
    tells_heights,
)
from fieldgrid.build.doubt import doubted_cameras
from fieldgrid.build.format_hints import format_hints, hint_sentence
from fieldgrid.build.mirrored import doubted_mirror
from fieldgrid.build.perception import follows_camera
from fieldgrid.build.poses import (
    BuildDoubt,
    check_images,
    check_poses,
    doubted_frames,
    doubted_imu,
    doubted_jump,
    doubted_yaw,
    estimate_drive,
    imu_notes,
)
from fieldgrid.build.report import SessionReport
from fieldgrid.choices import StopCode
from fieldgrid.grids import GridSpec
from fieldgrid.inspection.clocks import clock_findings, clock_unknown
from fieldgrid.inspection.coverage import coverage, coverage_findings
from fieldgrid.inspection.findings import Finding, error, info, warning
from fieldgrid.inspection.fixes import (
    fix_findings,
    pose_findings,
    rejections,
    summarise_fixes,
    sync_findings,
    synchronisation,
)
from fieldgrid.inspection.frame_pass import FramePass, Tell, look_at
from fieldgrid.inspection.images import (
    image_findings,
    misalignment_findings,
    unread_findings,
)
from fieldgrid.inspection.refusals import noted, refusal
from fieldgrid.inspection.report import Inspection
from fieldgrid.inspection.rigs import ground_seen, mount_findings
from fieldgrid.inspection.sampling import sample_every, stretches
from fieldgrid.localgrid import LocalGridder
from fieldgrid.pose import Estimate, unseen_sentence
from fieldgrid.pose.camera_yaw import yaw_notes
from fieldgrid.pose.report import NO_AXLE, clock_notes
from fieldgrid.pose.unseen import SLOW_ERRORS
from fieldgrid.recording import Drive, Recording
from fieldgrid.rig import StereoCamera
from fieldgrid.settings import BuildSettings
from fieldgrid.vertical import drive_misalignment

GROUND_SHARE = 0.7
"""Ground is found in nearly all frames of a sensor that is mounted as its mounting says."""


def with_fixes(
    found: Inspection, estimate: Estimate, drive: Drive, findings: list[Finding]
) -> Inspection:
    """The report with the fixes of a drive, judged, and the poses from them."""
    fixes = drive.fixes().in_order()
    accepted = estimate.trajectory.accepted[estimate.fix_row]
    summary = summarise_fixes(fixes, accepted, estimate.report.conditioning)
    findings += fix_findings(summary)
    return replace(found, fixes=summary, trajectory=estimate.trajectory)


def pose_notes(estimate: Estimate) -> Iterator[Finding]:
    """What a build notes of the poses, but for what has findings of its own."""
    report = estimate.report
    if not estimate.trajectory.accepted.any():
        return
    own = {*clock_notes(report.clock)}
    if report.camera_yaw is not None:
        own.update(yaw_notes(report.camera_yaw))
    for note in report.notes:
        if note not in own and not note.startswith(NO_AXLE):
            kind = info if note.startswith(SLOW_ERRORS) else warning
            yield _with_remedy(kind, "poses", note)
    if report.unseen:
        yield info("unseen", unseen_sentence(report.unseen))


def _with_remedy(kind: Callable[[str, str, str], Finding], code: str, note: str) -> Finding:
    """A note of a build, whose remedy follows a semicolon."""
    what, _, remedy = note.partition("; ")
    return kind(code, f"{what.removesuffix('.')}.", remedy[:1].upper() + remedy[1:])


def with_frames(
    recording: Recording,
    settings: BuildSettings,
    found: Inspection,
    findings: list[Finding],
    tell: Tell | None,
) -> Inspection:
    """A whole recording, in the order of a build."""
    found = replace(
        found,
        frames=recording.frame_count,
        declared_offset_s=recording.rig.image_time_offset_ns / 1e9,
    )
    images_ns = recording.frame_times_ns() + recording.rig.image_time_offset_ns
    fixes_alone: Estimate | None = None
    with noted(findings):
        fixes_alone = estimate_drive(recording, settings)
        found = with_fixes(found, fixes_alone, recording, findings)
        found = replace(found, reasons=rejections(images_ns, fixes_alone.trajectory))
        with noted(findings, "no-overlap"):
            check_images(recording, fixes_alone.trajectory)
    with noted(findings):
        gridder = LocalGridder(
            recording.rig, GridSpec.of(settings.grid), settings.stereo, settings.density
        )
        seen, found = _looked(recording, settings, gridder, fixes_alone, found, findings, tell)
        if fixes_alone is not None:
            found = _with_poses(recording, settings, gridder, fixes_alone, seen, found, findings)
        ground = ground_seen(seen.grounds, recording.rig.mount)
        findings += mount_findings(ground, recording.rig.mount, found.scale)
        found = replace(found, ground=ground)
    return found


def _looked(
    recording: Recording,
    settings: BuildSettings,
    gridder: LocalGridder,
    fixes_alone: Estimate | None,
    found: Inspection,
    findings: list[Finding],
    tell: Tell | None,
) -> tuple[FramePass, Inspection]:
    """The one pass over the frames, and what it says of images and cameras."""
    every = sample_every(recording.frame_count)
    times_ns, heading_deg = np.zeros(0, dtype=np.int64), np.zeros(0)
    if fixes_alone is not None:
        track = fixes_alone.trajectory
        times_ns, heading_deg = track.time_ns, track.heading_deg
    images_ns = recording.frame_times_ns() + recording.rig.image_time_offset_ns
    follow = follows_camera(recording.rig, settings)
    runs = stretches(images_ns, times_ns, heading_deg) if follow else []
    seen = look_at(recording, gridder, every, runs, tell)
    looked = len(seen.grounds)
    findings += unread_findings(seen.unread, looked + len(seen.unread))
    findings += image_findings(seen.looks)
    rows, camera = None, recording.rig.sensor
    if isinstance(camera, StereoCamera):
        rows = drive_misalignment(
            [look.shifts for look in seen.looks], (camera.width_px, camera.height_px)
        )
        findings += misalignment_findings(rows)
    if not seen.unread and looked:
        findings += _camera_findings(recording, gridder, seen, every)
    return seen, replace(
        found,
        looked=looked,
        followed=seen.followed,
        camera_steps=0 if seen.steps is None else len(seen.steps.start_ns),
        camera_pairs=seen.tried,
        looks=seen.looks,
        misalignment=rows,
    )


def _camera_findings(
    recording: Recording, gridder: LocalGridder, seen: FramePass, every: int
) -> Iterator[Finding]:
    """What a build would refuse these cameras for, were all frames like those looked at."""
    ground = sum(one.refined for one in seen.grounds)
    steps = 0 if seen.steps is None else len(seen.steps.start_ns)
    report = SessionReport(recording.name, camera_steps=steps, camera_refusals=seen.tried - steps)
    doubted = doubted_cameras(recording, report, ground, every)
    if doubted is not None:
        yield refusal(doubted.error, doubted.code)
        return
    if ground == 0:
        readings = format_hints(recording, gridder, every)
        yield error(
            "no-ground",
            f"No ground was found in any of {len(seen.grounds)} frames that were looked at, so "
            "heights above it are not known.",
            hint_sentence(readings)
            if readings
            else "Check height and tilt in mounting.json; `fieldgrid mount` measures them.",
        )
    elif ground < GROUND_SHARE * len(seen.grounds):
        mount = recording.rig.mount
        yield warning(
            "ground-missing",
            f"The ground was found in {ground} of {len(seen.grounds)} frames that were looked at.",
            f"Check the height of {mount.height_m:g} m and the tilt of {mount.tilt_deg:g}° in "
            "mounting.json; `fieldgrid mount` measures them.",
        )


def _with_poses(
    recording: Recording,
    settings: BuildSettings,
    gridder: LocalGridder,
    fixes_alone: Estimate,
    seen: FramePass,
    found: Inspection,
    findings: list[Finding],
) -> Inspection:
    """The poses that frames will have, and the clocks that they depend on."""
    with_camera, clock = None, None
    if seen.steps is not None and len(seen.steps.start_ns):
        with_camera = estimate_drive(recording, settings, steps=seen.steps)
        clock = with_camera.report.clock
    off = clock is not None and clock.is_certain
    apart = any(finding.code == "no-overlap" for finding in findings)
    by_way, mirrored = None, None
    if with_camera is not None:
        mirrored = doubted_mirror(recording, with_camera.trajectory, seen.steps)
    if mirrored is not None:  # what else the camera contradicts follows from that
        findings += _refusals(mirrored)
    elif seen.steps is not None:
        off_ns = round(clock.offset_s * 1e9) if clock is not None and off else 0
        heights = tells_heights(recording.fixes())
        track = fixes_alone.trajectory
        by_way = camera_scale(seen.steps, track, off_ns, heights_told=heights)
        findings += _refusals(doubted_scale(by_way, recording.rig))
        notes = scale_notes(by_way, recording.rig)
        findings += [_with_remedy(warning, StopCode.SCALE.value, note) for note in notes]
    if with_camera is not None and mirrored is None:
        _told_by_camera(recording, with_camera, findings)
    if clock is not None and off:
        findings += clock_findings(clock, recording, fixes_alone.trajectory)
    elif clock is None and seen.followed and not (apart or (by_way is not None and by_way.is_off)):
        findings.append(clock_unknown(seen.followed))
    # With a wrong clock the camera's motion would be laid beside that of other moments.
    estimate = fixes_alone if with_camera is None or off else with_camera
    if mirrored is None and not off:
        findings += pose_notes(estimate)
    track = estimate.trajectory
    images_ns = recording.frame_times_ns() + recording.rig.image_time_offset_ns
    at_fixes = estimate.fix_row[track.accepted[estimate.fix_row]]
    found = replace(
        found,
        sync=synchronisation(images_ns, track.time_ns[at_fixes]),
        clock=clock,
        scale=by_way,
        reasons=rejections(images_ns, track),
        trajectory=track,
    )
    if apart:
        return found
    return _with_map(recording, settings, gridder, found, findings, clocks_agree=not off)


def _with_map(
    recording: Recording,
    settings: BuildSettings,
    gridder: LocalGridder,
    found: Inspection,
    findings: list[Finding],
    *,
    clocks_agree: bool,
) -> Inspection:
    """The frames that will be used, and what they cover; of clocks that do not agree that says
    nothing, and is no finding."""
    track = found.trajectory
    assert track is not None
    images_ns = recording.frame_times_ns() + recording.rig.image_time_offset_ns
    told: list[Finding] = []
    with noted(findings, "no-pose"):
        check_poses(recording, track)
        found = replace(
            found,
            coverage=coverage(
                images_ns,
                track,
                recording.rig,
                GridSpec.of(settings.grid),
                gridder.max_range_m,
                settings.stereo.disparity_sigma_px,
            ),
        )
        told += pose_findings(recording.frame_count, found.reasons)
        told += coverage_findings(
            found.coverage, settings.universal_cell_m, settings.map.cell_m is not None
        )
    if found.sync is not None:
        told += sync_findings(found.sync)
    findings += told if clocks_agree else []
    return found


def _refusals(*doubts: BuildDoubt | None) -> list[Finding]:
    return [refusal(one.error, one.code.value) for one in doubts if one is not None]


def _told_by_camera(recording: Recording, estimate: Estimate, findings: list[Finding]) -> None:
    """A clock that jumps, images of other moments than stamped, a camera that looks elsewhere."""
    askew = doubted_yaw(recording, estimate)
    findings += _refusals(
        doubted_jump(recording, estimate),
        doubted_frames(recording, estimate),
        doubted_imu(estimate),
        askew,
    )
    findings += [warning(StopCode.IMU_TURNED.value, note) for note in imu_notes(estimate)]
    yaw = estimate.report.camera_yaw
    if yaw is not None and askew is None:
        code = StopCode.CAMERA_YAW.value if yaw.moved is None else "camera-moved"
        findings += [warning(code, note) for note in yaw_notes(yaw)]
