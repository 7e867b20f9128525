"""From fixes to the trajectory of the grid origin: the method, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Float64, Int64
from fieldgrid.errors import ConfigError, GnssError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import NO_STRAYS, condition, summarise
from fieldgrid.motion import Motion
from fieldgrid.pose.accepted import accepted_fixes, datum_of, no_fix_sentence
from fieldgrid.pose.axle import axle_by_gyro, axle_forward_m, axle_of
from fieldgrid.pose.camera_yaw import camera_yaw
from fieldgrid.pose.clock import check_clock
from fieldgrid.pose.clock_jump import clock_jump
from fieldgrid.pose.convention import Comparison, compare
from fieldgrid.pose.denied import denied_by, unsure_declared
from fieldgrid.pose.drifting import drift, drift_notes, unsure_drift
from fieldgrid.pose.drive import Drive, smooth_drive, with_recorded
from fieldgrid.pose.gears import gear_hints
from fieldgrid.pose.given import CLEAR_OFFSET_DEG, place_poses
from fieldgrid.pose.gyro_check import with_trusted_gyro, without_wrong_gyro
from fieldgrid.pose.gyro_faults import without_faulty_samples
from fieldgrid.pose.imu_turn import imu_turn
from fieldgrid.pose.levelled import (
    find_lean,
    leaning,
    levelled_fixes,
    levelled_motion,
    tells_attitude,
    unsure_lean,
)
from fieldgrid.pose.measured import RecordedHeadings
from fieldgrid.pose.report import PoseReport, drive_notes, fix_offset
from fieldgrid.pose.seen_leaps import seen_leaps
from fieldgrid.pose.settings import HeadingSource, heading_source
from fieldgrid.pose.slope import FLAT, slope_notes, slope_seen, unsure_slope
from fieldgrid.pose.stray import MOST_ROUNDS, stray_fixes
from fieldgrid.pose.table import Conditioned, PoseTable, pose_table
from fieldgrid.pose.verdict import Budget, judged
from fieldgrid.pose.wheel_sense import with_right_wheels
from fieldgrid.rig import LeverArm, Vehicle, nose_heading_deg
from fieldgrid.settings import PoseSettings
from fieldgrid.trajectory import Trajectory


class Estimate(NamedTuple):
    """A trajectory, the row of each input fix in it (in order of time), and the report. Of given
    poses without fixes, `fix_row` has all rows."""

    trajectory: Trajectory
    fix_row: Int64
    report: PoseReport


def estimate_poses(
    fixes: FixColumns,
    rig: Vehicle | None = None,
    datum: Datum | None = None,
    settings: PoseSettings | None = None,
    motion: Motion | None = None,
    budget: Budget | None = None,
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
        return _of_given(fixes, rig, datum, settings, motion, budget, level_grids=level_grids)
    if settings.frame_origin is not None or settings.frame_heading_deg is not None:
        raise ConfigError(
            "--frame-origin and --frame-heading say where given poses lie, and none are used; give "
            "--poses FILE with the heading smooth, or leave them out."
        )
    # Which fixes a vehicle can have driven through.
    log = conditioned(fixes, settings, datum)
    # Forward or reverse, and one batch estimate of everything that was measured.
    hints = gear_hints(settings)
    # By what the drive carries, used here or not: so its grids were made.
    level_grids = level_grids and tells_attitude(motion)
    motion, faulty_gyro = without_faulty_samples(motion)
    motion, turned_wheels = with_right_wheels(motion)
    gyro = motion.gyro
    motion, wrong_gyro = without_wrong_gyro(log.accepted, motion)
    declared, axle = rig, axle_of(rig, motion.steps)
    drive = smooth_drive(log.accepted, log.fixes.time_ns, motion, axle, hints=hints)
    strays: dict[int, str] = {}
    for _ in range(MOST_ROUNDS):
        if not (more := stray_fixes(drive, log)):
            break
        strays |= more
        log = conditioned(log.fixes, settings, log.datum, strays)
        drive = smooth_drive(log.accepted, log.fixes.time_ns, motion, axle, hints=hints)
    trusted = with_trusted_gyro(drive, log.accepted, log.fixes.time_ns, motion, axle, hints)
    drive, motion = trusted.drive, trusted.motion
    told = axle_by_gyro(axle, drive.smoothed.declared.ahead_m) if drive.at.has_gyro() else axle
    if told != axle:
        axle = told
        drive = smooth_drive(log.accepted, log.fixes.time_ns, motion, axle, hints=hints)
    rig = axle.vehicle
    # The same of a vehicle that stands level, once its headings have told how it leans.
    turned_imu = imu_turn(motion.steps, motion.inertial)
    lean = find_lean(log.accepted, drive, motion, rig, frame_ns)
    if lean is not None:
        log = log._replace(accepted=levelled_fixes(log.accepted, lean))
        motion = levelled_motion(motion, lean)
        drive = smooth_drive(log.accepted, log.fixes.time_ns, motion, axle, hints=hints)
    # A solution that goes on elsewhere, as the camera sees.
    if rig is not None and (seen := seen_leaps(log.accepted, drive, motion.steps, rig.antenna)):
        log = log._replace(accepted=accepted_fixes(log.fixes, log.verdicts, log.datum, seen))
        if lean is not None:
            log = log._replace(accepted=levelled_fixes(log.accepted, lean))
        drive = smooth_drive(log.accepted, log.fixes.time_ns, motion, axle, hints=hints)
    # A recorded heading joins once the drive has shown what it means.
    recorded_deg, comparison, notes = _recorded(log, drive, rig, source, settings)
    if motion.poses is not None:
        notes.append(f"The given poses were not used, since headings shall be {source}.")
    if source.kind == "smooth" and np.isfinite(recorded_deg).any():
        recorded = RecordedHeadings(recorded_deg)
        if comparison is not None:
            recorded = recorded._replace(offset_sigma_deg=settings.max_heading_offset_deg)
        drive = with_recorded(drive, log.accepted, motion, axle, recorded, hints)
    # A row for each fix and each instant between, carried to the grid origin and judged.
    table, fix_row = pose_table(source, log, drive, recorded_deg, rig, settings)
    if source.kind == "smooth":
        unsure_deg = trusted.unsure_at(table.time_ns)
        table = table._replace(heading_sigma_deg=np.hypot(table.heading_sigma_deg, unsure_deg))
    slope = FLAT
    if lean is not None:
        table = unsure_lean(table, lean, level_grids=level_grids)
    elif rig is not None:
        slope = slope_seen(log.accepted)
        table = unsure_slope(table, slope, rig, turns_seen=drive.turns_seen)
    # A gyro of another clock than the fixes is not used, and yet tells that of the images.
    clocks = check_clock(drive, log.accepted, motion, axle, hints, recorded=gyro)
    # Where a heading is recorded, a vehicle that slips sideways does not look where it goes.
    follows_path = source.kind == "smooth" and not np.isfinite(recorded_deg).any()
    yaw = camera_yaw(motion.steps, axle) if follows_path else None
    denied = denied_by(drive, declared, clocks)
    table = unsure_declared(_carried(table, rig, source), drive, denied)
    drifts = drift(drive, axle, denied, clocks) if source.kind == "smooth" else None
    table = unsure_drift(table, drive, drifts)
    trajectory = judged(table, log.datum, settings, budget, str(source))
    if lean is not None:
        trajectory = leaning(trajectory, lean, level_grids=level_grids)
    report = PoseReport(
        conditioning=summarise(log.fixes, log.verdicts),
        attitude=None if lean is None else lean.attitude,
        recorded=comparison,
        clock=clocks.offset,
        contradiction=clocks.contradiction,
        clock_change=clocks.change,
        jump=clock_jump(log.accepted, motion.steps, gyro),
        camera_yaw=yaw,
        imu_turn=turned_imu,
        gyro_bias_dps=drive.gyro_bias_dps,
        offset=fix_offset(log.accepted, drive.offset_m),
        camera_scale=drive.smoothed.camera_scale,
        wheel_scale=drive.smoothed.wheel_scale,
        notes=(
            *(
                note
                for note in (faulty_gyro, turned_wheels, wrong_gyro, trusted.note)
                if note is not None
            ),
            *notes,
            *slope_notes(slope, rig),
            *drift_notes(drifts),
            *drive_notes(
                *(drive, log.accepted, declared, axle, denied),
                *(source, settings, clocks.offset, yaw, trajectory),
            ),
        ),
    )
    return Estimate(trajectory, fix_row, report)


def _of_given(
    fixes: FixColumns,
    rig: Vehicle | None,
    datum: Datum | None,
    settings: PoseSettings,
    motion: Motion,
    budget: Budget | None,
    *,
    level_grids: bool,
) -> Estimate:
    """The estimate of a drive whose poses another program made."""
    assert motion.poses is not None
    log, notes = None, []
    origin = settings.frame_origin
    try:
        log = conditioned(fixes, settings, datum)
        datum = log.datum
    except GnssError as problem:
        if origin is not None and len(fixes):
            notes.append(str(problem))
        elif origin is None and len(fixes):
            raise
    if datum is None and origin is not None:
        datum = Datum(origin.lat_deg, origin.lon_deg, origin.height_m)
    if datum is None:
        raise GnssError(
            "No fix tells where the poses lie; give a log with --gnss, or declare the frame with "
            "--frame-origin LAT,LON,HEIGHT and --frame-heading DEG."
        )
    placed = place_poses(
        *(motion.poses, motion.tilt, log, rig, datum, settings, budget), level_grids=level_grids
    )
    found, pairs = placed.georeference, placed.pairs
    offset = None
    if pairs is not None:
        offset_m = found.place(*pairs.frame_m[:, :2].T) - pairs.fixes.points_m()
        offset = fix_offset(pairs.fixes, offset_m)
    judged_fixes = (fixes, condition(fixes)) if log is None else (log.fixes, log.verdicts)
    report = PoseReport(
        conditioning=summarise(*judged_fixes),
        attitude=placed.attitude,
        recorded=None,
        clock=None,
        gyro_bias_dps=float("nan"),
        offset=offset,
        camera_scale=None,
        wheel_scale=None,
        notes=(*notes, *placed.notes),
        georeference=found,
    )
    return Estimate(placed.trajectory, placed.fix_row, report)


def conditioned(
    fixes: FixColumns,
    settings: PoseSettings,
    datum: Datum | None = None,
    strays: Mapping[int, str] = NO_STRAYS,
) -> Conditioned:
    """Fixes in order of time with what the settings declare of them, judged, and the accepted
    ones in the plane; `strays` as in `condition`. Raises GnssError when none can be used."""
    fixes = fixes.in_order()
    if settings.quality is not None:
        fixes = fixes.replace(quality=np.full(len(fixes), settings.quality, dtype=np.int64))
    if settings.accuracy_m is not None:
        fixes = fixes.replace(sigma_m=np.full(len(fixes), settings.accuracy_m))
    verdicts = condition(fixes, settings.gnss, strays)
    if not verdicts.ok.any():
        raise GnssError(no_fix_sentence(fixes, verdicts))
    datum = datum or datum_of(fixes, verdicts)
    return Conditioned(fixes, verdicts, datum, accepted_fixes(fixes, verdicts, datum))


def _recorded(
    log: Conditioned,
    drive: Drive,
    rig: Vehicle | None,
    source: HeadingSource,
    settings: PoseSettings,
) -> tuple[Float64, Comparison | None, list[str]]:
    """Headings of the vehicle that were recorded with the accepted fixes, NaN where none can be
    used; raises when they contradict the drive."""
    recorded = log.accepted.recorded_deg
    if rig is not None:
        recorded = nose_heading_deg(rig, recorded)
    if not np.isfinite(recorded).any():
        if source.kind == "recorded":
            raise GnssError(
                "No fix of this recording has a heading of its own; use --heading smooth."
            )
        return recorded, None, []
    at = drive.fix >= 0
    # Nodes stand in the order of the accepted fixes. An unsure axle, which shifts headings one way
    # in left and the other way in right turns, hides no convention.
    sigma_deg = np.degrees(drive.smoothed.heading_sigma_rad[at])
    found = compare(recorded, drive.heading_deg[at], sigma_deg, drive.gear[at])
    if found is None:
        note = "The drive is too short to compare the recorded heading with its course."
        return recorded, None, [note]
    if found.course:
        note = (
            "The recorded heading turns around in reverse: it is the course, not the direction of "
            "the vehicle, and was not used."
        )
        if source.kind == "recorded":
            raise GnssError(note.replace(", and was not used", "; use --heading smooth"))
        return np.full_like(recorded, np.nan), found, [note]
    if found.mirrored or abs(found.offset_deg) > settings.max_heading_offset_deg:
        sentence = (
            f"The recorded heading {found.diagnosis()} (seen at {found.compared} fixes, "
            f"scatter {found.scatter_deg:.1f}°); declare {found.correction(rig)} in mounting.json "
            "(of a log alone: --heading-offset)"
        )
        if source.kind in ("smooth", "recorded"):
            raise GnssError(f"{sentence}, or use --heading course.")
        return np.full_like(recorded, np.nan), found, [f"{sentence}. It was not used."]
    notes = []
    if abs(found.offset_deg) > CLEAR_OFFSET_DEG:
        notes = [
            f"The recorded heading is {found.offset_deg:+.2f}° ± {found.offset_sigma_deg:.2f}° off "
            "the course of the drive; taken out."
        ]
    return np.asarray(wrap_deg(recorded - found.offset_deg)), found, notes


def _carried(table: PoseTable, rig: Vehicle | None, source: HeadingSource) -> PoseTable:
    """Rows carried to the grid origin."""
    if rig is None:
        return table
    point = rig.antenna
    if source.kind == "smooth":
        point = LeverArm(0.0, axle_forward_m(rig), 0.0)
    east_m, north_m = carry_lever(table.east_m, table.north_m, table.heading_deg, point)
    return table._replace(east_m=east_m, north_m=north_m, up_m=table.up_m - rig.antenna.up_m)


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
