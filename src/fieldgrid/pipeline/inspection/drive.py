"""What an inspection says of a drive, step by step in the order of a build.

Each step gives the report with what it has found out, and adds to the findings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fieldgrid.core import (
    BuildSettings,
    FieldgridError,
    Finding,
    Int64,
    StopCode,
    error,
    info,
    warning,
)
from fieldgrid.geometry import GridSpec, Trajectory
from fieldgrid.perception import LocalGridder, Misalignment
from fieldgrid.pipeline.checks.camera_scale import camera_scale, scale_findings, tells_heights
from fieldgrid.pipeline.checks.doubt import camera_findings, misalignment, row_findings
from fieldgrid.pipeline.checks.format_hints import format_hints, hint_sentence
from fieldgrid.pipeline.checks.mirrored import mirror_findings
from fieldgrid.pipeline.inspection.coverage import coverage, coverage_findings
from fieldgrid.pipeline.inspection.fixes import (
    pose_findings,
    rejections,
    summarise_fixes,
    sync_findings,
    synchronisation,
)
from fieldgrid.pipeline.inspection.frame_pass import FramePass, Tell, look_at
from fieldgrid.pipeline.inspection.images import (
    image_findings,
    texture_findings,
    unread_findings,
)
from fieldgrid.pipeline.inspection.refusals import noted
from fieldgrid.pipeline.inspection.report import Inspection
from fieldgrid.pipeline.inspection.rigs import mount_findings
from fieldgrid.pipeline.mounting.estimate import measure_mount
from fieldgrid.pipeline.poses import check_images, check_poses, estimate_drive
from fieldgrid.pipeline.report import SessionReport
from fieldgrid.pipeline.staging.perception import follows_camera
from fieldgrid.poses import Estimate
from fieldgrid.recordings import Drive, Recording

# Which frames an inspection looks at: a few over the whole drive closely, and stretches of
# neighbours for the camera's own motion.


MOST_SAMPLES = 24
"""Pairs that are looked at closely."""

MOST_FOLLOWED = 320
"""Frames that the camera's motion is told from: all of a short drive."""

STRETCHES = 8


def sample_every(frame_count: int) -> int:
    """Every how many-th frame is looked at closely."""
    return max(1, math.ceil(frame_count / MOST_SAMPLES))


def stretches(frame_ns: Int64, track: Trajectory | None) -> list[range]:
    """Runs of neighbouring frames: all in one where they are few, else half of them spread over
    the drive and half where it turns most, which tells clocks apart.

    `track` is what is known of the drive before the images are seen.
    """
    count = len(frame_ns)
    if count <= MOST_FOLLOWED:
        return [range(count)]
    length = MOST_FOLLOWED // STRETCHES
    starts = range(0, count - length + 1, length)
    spread = np.linspace(0, len(starts) - 1, STRETCHES // 2).round().astype(int).tolist()
    at = np.zeros(count)
    if track is not None:
        turn = np.abs(np.diff(np.unwrap(np.radians(np.nan_to_num(track.heading_deg)))))
        at = np.interp(frame_ns, track.time_ns, np.append(0.0, np.cumsum(turn)))
    by_turn = np.argsort([-(at[start + length - 1] - at[start]) for start in starts]).tolist()
    chosen = list(dict.fromkeys([*spread, *by_turn]))[:STRETCHES]
    return [range(starts[k], starts[k] + length) for k in sorted(chosen)]


_OF_CAMERA = {
    StopCode.CLOCK_OFFSET,
    StopCode.CLOCK_JUMP,
    StopCode.FRAMES_MISPLACED,
    StopCode.CAMERA_YAW,
}
"""What the camera tells of a drive whose poses cannot be used, too: the rest may follow from it."""

GROUND_SHARE = 0.7
"""Ground is found in nearly all frames of a sensor that is mounted as its mounting says."""


def told_of_poses(estimate: Estimate) -> tuple[Finding, ...]:
    """What is told of poses of which some can be used."""
    return estimate.report.findings if estimate.trajectory.accepted.any() else ()


def with_fixes(found: Inspection, estimate: Estimate, drive: Drive) -> Inspection:
    """The report with the fixes of a drive, judged by an estimate, and its poses."""
    fixes = summarise_fixes(drive.fixes(), estimate)
    return replace(found, fixes=fixes, trajectory=estimate.trajectory)


def with_frames(
    recording: Recording,
    settings: BuildSettings,
    found: Inspection,
    findings: list[Finding],
    tell: Tell | None,
) -> Inspection:
    """A whole recording, in the order of a build."""
    times_ns = recording.image_times_ns()
    found = replace(
        found,
        frames=recording.frame_count,
        declared_offset_s=recording.rig.image_time_offset_ns / 1e9,
    )
    fixes_alone: Estimate | None = None
    with noted(findings):
        fixes_alone = estimate_drive(recording, settings)
        reasons = rejections(times_ns, fixes_alone.trajectory)
        found = replace(with_fixes(found, fixes_alone, recording), reasons=reasons)
        with noted(findings, "no-overlap"):
            check_images(recording, fixes_alone.trajectory)
    with noted(findings):
        gridder = LocalGridder(
            recording.rig, GridSpec.of(settings.grid), settings.stereo, settings.density
        )
        runs = []
        if follows_camera(recording.rig, settings):
            runs = stretches(times_ns, found.trajectory)
        every = sample_every(recording.frame_count)
        seen = look_at(recording, gridder, every, runs, tell)
        rows = misalignment(recording, [look.images for look in seen.looks])
        findings += _frame_findings(recording, gridder, seen, rows, every)
        found = replace(
            found,
            looked=len(seen.grounds),
            followed=seen.followed,
            camera_steps=len(seen.steps.start_ns),
            camera_pairs=seen.tried,
            looks=tuple(seen.looks),
            misalignment=rows,
        )
        if fixes_alone is not None:
            found = _with_poses(recording, settings, fixes_alone, seen, found, findings)
        # By other frames than those: by the ones of `fieldgrid mount`, to the same numbers.
        with suppress(FieldgridError):
            found = replace(found, mount=measure_mount(recording, progress=tell))
        findings += mount_findings(found.mount, found.scale)
    return found


def _frame_findings(
    recording: Recording,
    gridder: LocalGridder,
    seen: FramePass,
    rows: Misalignment | None,
    every: int,
) -> Iterator[Finding]:
    """What the frames say of images and cameras, and what a build would refuse these cameras for,
    were all frames like those looked at."""
    looked = len(seen.grounds)
    yield from unread_findings(seen.unread, looked + len(seen.unread))
    yield from image_findings([look.images for look in seen.looks])
    yield from texture_findings(seen.looks)
    yield from row_findings(recording, every, rows)
    if seen.unread or not looked:
        return
    ground = sum(one.refined for one in seen.grounds)
    steps = len(seen.steps.start_ns)
    report = SessionReport(recording.name, camera_steps=steps, camera_refusals=seen.tried - steps)
    unfit = tuple(camera_findings(recording, report, ground, every))
    yield from unfit
    if not unfit and ground == 0:
        readings = format_hints(recording, gridder, every)
        yield error(
            "no-ground",
            f"No ground was found in any of {looked} frames that were looked at, so heights above "
            "it are not known.",
            hint_sentence(readings)
            if readings
            else "Check height and tilt in mounting.json; `fieldgrid mount` measures them.",
        )
    elif not unfit and ground < GROUND_SHARE * looked:
        mount = recording.rig.mount
        yield warning(
            "ground-missing",
            f"The ground was found in {ground} of {looked} frames that were looked at.",
            f"Check the height of {mount.height_m:g} m and the tilt of {mount.tilt_deg:g}° in "
            "mounting.json; `fieldgrid mount` measures them.",
        )


def _with_poses(
    recording: Recording,
    settings: BuildSettings,
    fixes_alone: Estimate,
    seen: FramePass,
    found: Inspection,
    findings: list[Finding],
) -> Inspection:
    """The poses that frames will have, and the clocks that they depend on."""
    estimate, steps, times_ns = fixes_alone, None, recording.image_times_ns()
    clock, by_way, clock_off, mirrored = None, None, False, list[Finding]()
    apart = any(finding.code == "no-overlap" for finding in findings)
    if len(seen.steps.start_ns):
        with_camera = estimate_drive(recording, settings, steps=seen.steps)
        clock = with_camera.report.clock
        clock_off = clock is not None and clock.is_certain
        mirrored += mirror_findings(recording, with_camera.trajectory, seen.steps)
        findings += mirrored
        if not mirrored:  # what else the camera contradicts follows from that
            off_ns = round(clock.offset_s * 1e9) if clock is not None and clock_off else 0
            heights = tells_heights(recording.fixes())
            track = fixes_alone.trajectory
            by_way = camera_scale(seen.steps, track, off_ns, heights_told=heights)
            findings += scale_findings(by_way, recording.rig)
            findings += [one for one in with_camera.report.findings if one.code in _OF_CAMERA]
        # With a wrong clock the camera's motion would be laid beside that of other moments.
        if not clock_off:
            estimate, steps = with_camera, seen.steps
    if clock is None and seen.followed and not (apart or (by_way is not None and by_way.is_off)):
        findings.append(
            info(
                "clock-unknown",
                f"The clock offset of the images cannot be estimated from {seen.followed} frames: "
                "the drive is too uniform, too short, or has poor images.",
                "Start a drive with a few turns.",
            )
        )
    if not (mirrored or clock_off):
        findings += told_of_poses(estimate)
    track = estimate.trajectory
    at_fixes = estimate.fix_row[track.accepted[estimate.fix_row]]
    sync = synchronisation(times_ns, track.time_ns[at_fixes])
    found = replace(
        with_fixes(found, estimate, recording),
        sync=sync,
        clock=clock,
        scale=by_way,
        reasons=rejections(times_ns, track),
    )
    if apart:
        return found
    told = list[Finding]()
    with noted(findings, "no-pose"):
        told += pose_findings(recording, settings, steps, found.reasons)
        check_poses(recording, track)
        expected = coverage(recording, settings, track)
        found = replace(found, coverage=expected)
        told += coverage_findings(expected, settings)
    if sync is not None:
        told += sync_findings(sync)
    # Of clocks that do not agree all that says nothing.
    findings += [] if clock_off else told
    return found
