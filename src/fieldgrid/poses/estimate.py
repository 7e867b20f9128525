"""From fixes to the trajectory of the grid origin: the method, step by step."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from fieldgrid.core import (
    ConfigError,
    Figure,
    Finding,
    Float64,
    GnssError,
    Int64,
    PoseSettings,
    info,
    warning,
)
from fieldgrid.geometry import (
    Datum,
    FixColumns,
    LeverArm,
    Motion,
    VehicleGeometry,
    wrap_deg,
)
from fieldgrid.poses.attitude.ground import expected_ground
from fieldgrid.poses.axle import axle_forward_m, with_antenna_moved
from fieldgrid.poses.drive import DriveEstimate, with_recorded
from fieldgrid.poses.external.georeference import by_estimate
from fieldgrid.poses.external.given import CLEAR_OFFSET_DEG, GIVEN, given_drive, pairs_of, risen
from fieldgrid.poses.faults.camera_yaw import CameraYaw, camera_yaw
from fieldgrid.poses.faults.clock.offset import ClockFindings, check_clock
from fieldgrid.poses.faults.convention import FEW_TURNED_SHARE, Comparison
from fieldgrid.poses.faults.denied import (
    DriveContradiction,
    declared_doubt,
    denied_by,
    with_whole_place,
)
from fieldgrid.poses.faults.excused import GyroExcuse, excused
from fieldgrid.poses.faults.explained import explained
from fieldgrid.poses.faults.unseen import (
    accuracy_findings,
    receiver_doubt,
    unseen_faults,
    unseen_findings,
)
from fieldgrid.poses.fused import Fusion, conditioned, fuse
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.summary import summarise
from fieldgrid.poses.levelled import lean_doubt, leaning, tells_attitude, track_m
from fieldgrid.poses.measured import RecordedHeadings
from fieldgrid.poses.report import Estimate, PoseReport, drive_findings, fix_offset
from fieldgrid.poses.settings import HeadingSource, heading_source
from fieldgrid.poses.sigmas import AddedSigma, as_unsure
from fieldgrid.poses.slope import slope_doubt, slope_findings
from fieldgrid.poses.table import pose_table
from fieldgrid.poses.verdict import ErrorBudget, judged

DECLARED_SIGMA_DEG = 0.1
"""How well the turn of a frame is known that somebody declares."""


def estimate_poses(
    fixes: FixColumns,
    rig: VehicleGeometry | None = None,
    datum: Datum | None = None,
    settings: PoseSettings | None = None,
    motion: Motion | None = None,
    budget: ErrorBudget | None = None,
    *,
    frame_ns: Int64 | None = None,
    level_grids: bool = True,
) -> Estimate:
    """The trajectory of the grid origin (without a rig: of the antenna) over one drive.

    The plane is that of `datum`, of the first accepted fix without one. Where the drive tells how
    the vehicle leans, all goes through its full attitude, which is known best at `frame_ns`.
    Without `level_grids` the grids of such a drive are square to the ground all the same, as those
    of older versions. Raises GnssError when no fix can be used, or when a recorded heading
    contradicts the drive.
    """
    settings, motion = settings or PoseSettings(), motion or Motion()
    source = heading_source(settings.heading)
    if motion.poses is not None and source.kind == "smooth":
        inputs = fixes, rig, datum, settings, motion, budget
        return _of_given(*inputs, frame_ns=frame_ns, level_grids=level_grids)
    if settings.frame_origin is not None or settings.frame_heading_deg is not None:
        raise ConfigError(
            "--frame-origin and --frame-heading say where given poses lie, and none are used; give "
            "--poses FILE with the heading smooth, or leave them out."
        )
    unused: tuple[Finding, ...] = ()
    if motion.poses is not None:
        told = f"The given poses were not used, since headings shall be {source}."
        unused = (info("poses-unused", told),)
    found, _, _ = _estimated(
        *(fixes, rig, datum, settings, motion._replace(poses=None), budget, source, frame_ns),
        level_grids=level_grids,
    )
    report = replace(found.report, findings=(*found.report.findings, *unused))
    return found._replace(report=report)


def _estimated(
    fixes: FixColumns,
    rig: VehicleGeometry | None,
    datum: Datum | None,
    settings: PoseSettings,
    motion: Motion,
    budget: ErrorBudget | None,
    source: HeadingSource,
    frame_ns: Int64 | None,
    *,
    level_grids: bool,
) -> tuple[Estimate, Fusion, DriveEstimate]:
    """The estimate, what was fused for it, and the drive with its recorded headings."""
    # By what the drive carries, used or not: so its grids were made.
    level_grids = level_grids and tells_attitude(motion, fixes.time_ns)
    # Which fixes a vehicle can have driven through, and one estimate of all that was measured.
    found = fuse(conditioned(fixes, settings, datum), rig, motion, settings, frame_ns)
    # A recorded heading joins once the drive has shown what it means.
    recorded_deg, comparison, findings = _recorded(found, source, settings)
    log, axle, lean = found.log, found.axle, found.lean
    recorded = RecordedHeadings(recorded_deg)
    if settings.frame_heading_deg is not None:
        recorded = recorded._replace(offset_sigma_deg=DECLARED_SIGMA_DEG)
    elif comparison is not None:
        recorded = recorded._replace(offset_sigma_deg=settings.max_heading_offset_deg)
    drive = _with_recorded(found, recorded) if source.kind == "smooth" else found.drive
    # What the drive denies of clocks, antenna and camera.
    checks = _checked(found, drive, rig, source, recorded)
    # A row for each fix and each instant between, as unsure as all of that makes it.
    table, fix_row = pose_table(source, log, drive, recorded_deg, axle.vehicle, settings)
    at_ns, doubts = table.time_ns, list[AddedSigma]()
    if settings.accuracy_m is None:
        doubts.append(receiver_doubt(at_ns, log.accepted))
    if lean is not None:
        doubts.append(lean_doubt(at_ns, lean, level_grids=level_grids))
    elif axle.vehicle is not None:
        ground = expected_ground(track_m(log.accepted), 0.0)
        doubts.append(slope_doubt(ground, axle.vehicle, turns_seen=drive.measured.sees_turns()))
        findings += slope_findings(ground, axle.vehicle)
    if source.kind == "smooth":
        doubts.append(declared_doubt(at_ns, drive, axle.vehicle, checks.denied))
        gyros = [(found.trusted.drive.time_ns, found.trusted.unsure_deg)]
        if checks.excused is not None:
            gyros.append((checks.excused.time_ns, checks.excused.unsure_deg))
        doubts += [AddedSigma(heading_deg=np.interp(at_ns, *gyro)) for gyro in gyros]
    # Carried to the grid origin, and judged.
    if (vehicle := axle.vehicle) is not None:
        axle_m = LeverArm(0.0, axle_forward_m(vehicle), 0.0)
        point = axle_m if source.kind == "smooth" else vehicle.antenna
        east_m, north_m = carry_lever(table.east_m, table.north_m, table.heading_deg, point)
        up_m = table.up_m - vehicle.antenna.up_m
        table = table._replace(east_m=east_m, north_m=north_m, up_m=up_m)
    table = as_unsure(table, doubts)
    trajectory = judged(table, log.datum, settings, budget, str(source))
    if lean is not None:
        trajectory = leaning(trajectory, lean, level_grids=level_grids)
    # A contradiction by a gyro that is excused says itself why the gyro was left out.
    silent = found.gyro_finding is None or (checks.excused is not None and checks.denied.clear)
    unseen = unseen_faults(drive, rig, smooth=source.kind == "smooth")
    report = PoseReport(
        conditioning=summarise(log.fixes, log.verdicts),
        attitude=None if lean is None else lean.attitude,
        recorded=comparison,
        clock=checks.clocks.offset,
        contradiction=checks.clocks.contradiction,
        clock_change=checks.clocks.change,
        camera_yaw=checks.yaw,
        gyro_bias_dps=drive.gyro_bias_dps,
        offset=fix_offset(log.accepted, drive.offset_m),
        camera_scale=drive.smoothed.camera_scale,
        wheel_scale=drive.smoothed.wheel_scale,
        unseen=unseen,
        findings=(
            *(() if silent else (found.gyro_finding,)),
            *(*found.findings, *findings),
            *(accuracy_findings(log.accepted) if settings.accuracy_m is None else ()),
            *drive_findings(
                *(drive, log.accepted, rig, axle, checks.denied),
                *(source, settings, checks.clocks, checks.yaw),
                *(trajectory, fix_row, frame_ns),
            ),
            *unseen_findings(unseen),
        ),
    )
    return Estimate(trajectory, fix_row, report, table.gear_doubt), found, drive


class _Checks(NamedTuple):
    clocks: ClockFindings
    yaw: CameraYaw | None
    denied: DriveContradiction
    excused: GyroExcuse | None


def _checked(
    found: Fusion,
    drive: DriveEstimate,
    declared: VehicleGeometry | None,
    source: HeadingSource,
    recorded: RecordedHeadings,
) -> _Checks:
    """What a drive, with its recorded headings, says of the vehicle that was declared."""
    # A gyro of another clock than the fixes is not used, and yet tells that of the images.
    motion = found.motion
    if motion.poses is not None:
        motion = motion._replace(steps=None)  # those of the poses, not of a camera
    clocks = check_clock(
        *(found.unleapt or drive, found.log.accepted, motion, found.axle, found.hints),
        recorded=found.gyro,
    )
    smooth = source.kind == "smooth"
    # Where a heading is recorded, a vehicle that slips sideways does not look where it goes.
    follows_path = not np.isfinite(recorded.heading_deg).any()
    yaw = None
    if smooth and follows_path:
        yaw = camera_yaw(drive.smoothed.camera_yaw_rad, motion.steps, found.axle)
    denied = denied_by(drive, declared, clocks)
    excuse = None
    if smooth and drive.measured.sees_turns():
        denied = explained(denied, found, drive, declared)
    elif smooth:
        denied = with_whole_place(denied, drive, partial(_with_recorded, found, recorded))
        excuse = None if drive.headings_recorded else excused(found, declared)
    if excuse is not None:
        denied = excuse.denied
    return _Checks(clocks, yaw, denied, excuse)


def _with_recorded(
    found: Fusion, recorded: RecordedHeadings, ahead_m: float = 0.0
) -> DriveEstimate:
    """The drive by its recorded headings, too, with the antenna `ahead_m` farther ahead."""
    if not np.isfinite(recorded.heading_deg).any():
        return found.drive
    axle = with_antenna_moved(found.axle, ahead_m) if ahead_m else found.axle
    return with_recorded(found.drive, found.log.accepted, found.motion, axle, recorded, found.hints)


def _of_given(
    fixes: FixColumns,
    rig: VehicleGeometry | None,
    datum: Datum | None,
    settings: PoseSettings,
    motion: Motion,
    budget: ErrorBudget | None,
    *,
    frame_ns: Int64 | None,
    level_grids: bool,
) -> Estimate:
    """The estimate of a drive whose poses another program made."""
    poses, given = motion.poses, given_drive(fixes, rig, datum, settings, motion)
    assert poses is not None
    source = heading_source("smooth" if given.declared is None else "recorded")
    (track, fix_row, report, doubt), found, drive = _estimated(
        *(given.fixes, given.rig, given.datum, given.settings, given.motion, budget),
        *(source, frame_ns),
        level_grids=level_grids,
    )
    told, conditioning, unseen = list(given.findings), report.conditioning, report.unseen
    if (frame := given.declared) is None:
        pairs = pairs_of(poses, found.log, rig)
        frame = by_estimate(pairs, drive, settings)
        # What is said of a camera's motion is said of that of the poses.
        for one in report.findings:
            told.append(replace(one, message=one.message.replace("camera", "poses")))
        if found.lean is None:
            track = replace(track, up_m=risen(track, poses, found.log))
    else:
        ordered = fixes.in_order()
        conditioning, unseen = summarise(ordered, condition(ordered)), ()
        told += [one for one in report.findings if one.code == "no-pose"]
        if len(fixes):
            fix_row = fix_row[np.searchsorted(given.fixes.time_ns, ordered.time_ns)]
    report = replace(
        report,
        conditioning=conditioning,
        camera_scale=None,
        findings=(*frame.findings(), *told),
        georeference=frame,
        unseen=unseen,
    )
    return Estimate(replace(track, heading_source=GIVEN), fix_row, report, doubt)


def _recorded(
    fused: Fusion, source: HeadingSource, settings: PoseSettings
) -> tuple[Float64, Comparison | None, list[Finding]]:
    """Headings of the vehicle that were recorded with the accepted fixes, NaN where none can be
    used; raises when they contradict the drive."""
    rig, recorded = fused.axle.vehicle, fused.recorded_deg()
    if settings.frame_heading_deg is not None:
        return recorded, None, []  # somebody declared them
    if not np.isfinite(recorded).any():
        if source.kind == "recorded":
            raise GnssError(
                "No fix of this recording has a heading of its own; use --heading smooth."
            )
        return recorded, None, []
    found = fused.compared()
    if found is None:
        told = "The drive is too short to compare the recorded heading with its course."
        return recorded, None, [info("heading-recorded", told)]
    note, remedy = "", "use --heading smooth"
    if found.course:
        note = (
            "The recorded heading turns around in reverse: it is the course, not the direction of "
            "the vehicle, and was not used."
        )
    elif found.flips:
        remedy = f"cut the log where it does, or {remedy}"
        note = (
            "The recorded heading turns around during the drive, and was not used: it is "
            f"{found.offset_deg:z.0f}° off the nose at the {found.compared} fixes where that is "
            f"known best, and the other way round at {100.0 * found.flipped:.0f} % of all."
        )
    elif found.scatters:
        note = (
            f"The recorded heading scatters by {found.scatter_deg:.0f}° about that of the drive, "
            "so that one of the two is wrong, and was not used."
        )
    if note:
        if source.kind == "recorded":
            raise GnssError(note.replace(", and was not used", f"; {remedy}"))
        return np.full_like(recorded, np.nan), found, [warning("heading-recorded", note)]
    if found.is_denied(settings.max_heading_offset_deg):
        sentence = (
            f"The recorded heading {found.diagnosis()} (seen at {found.compared} fixes, "
            f"scatter {found.scatter_deg:.1f}°); declare {found.correction(rig)} in mounting.json "
            "(of a log alone: --heading-offset)"
        )
        if source.kind in ("smooth", "recorded"):
            raise GnssError(f"{sentence}, or use --heading course.")
        told = f"{sentence}. It was not used."
        return np.full_like(recorded, np.nan), found, [warning("heading-recorded", told)]
    findings = []
    if abs(found.offset_deg) > CLEAR_OFFSET_DEG:
        findings.append(
            warning(
                "heading-recorded",
                f"The recorded heading is {found.offset_deg:+.2f}° ± "
                f"{found.offset_sigma_deg:.2f}° off the course of the drive; taken out.",
                figure=Figure(found.offset_deg, "deg"),
            )
        )
    used = np.asarray(wrap_deg(recorded - found.offset_deg))
    # Of a few the robust estimate makes nothing by itself.
    if found.flipped > (FEW_TURNED_SHARE if source.kind == "smooth" else 0.0):
        around = fused.turned_around(found)
        used[around] = np.nan
        told = (
            f"The recorded heading is the other way round at {np.count_nonzero(around)} of "
            f"{np.count_nonzero(np.isfinite(recorded))} fixes, and was not used there."
        )
        findings.append(warning("heading-recorded", told))
    return used, found, findings


def carry_lever(
    antenna_e: Float64, antenna_n: Float64, heading: Float64, lever: LeverArm
) -> tuple[Float64, Float64]:
    """From a point of the vehicle to the grid origin: Eq. 3 of the lever arm, subtracted.

    Where the heading is NaN the point's own position is kept; such a pose is rejected.
    """
    phi = np.radians(np.nan_to_num(heading))
    known = ~np.isnan(heading)
    east = antenna_e - known * (lever.right_m * np.cos(phi) + lever.forward_m * np.sin(phi))
    north = antenna_n - known * (-lever.right_m * np.sin(phi) + lever.forward_m * np.cos(phi))
    return east, north
