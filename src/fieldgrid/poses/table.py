"""Poses as a table in order of time: what every way to headings ends in, before the verdict."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, PoseSettings, Quality
from fieldgrid.geometry import MAX_GAP_NS, Datum, FixColumns, VehicleGeometry, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes, fix_offsets
from fieldgrid.poses.drive import REST_MPS, DriveEstimate
from fieldgrid.poses.gates.verdict import Verdicts
from fieldgrid.poses.gears.course import (
    NOISE_SHARE,
    STATION_M,
    Course,
    course,
    course_of_axle,
    stations,
)
from fieldgrid.poses.settings import HeadingSource

# The paper's way to headings: the course over a baseline, one that is recorded, or one given.


CONSTANT_SIGMA_DEG = 1.0
"""What a heading given by hand is taken to be good for."""

JUMP_SIGMAS, JUMP_DEG = 4.0, 5.0
"""A nose does not turn faster than its tightest turn by more than this."""


def stated_heading(heading_deg: Float64, sigma_deg: Float64) -> Course:
    """Headings that the log or the user states, with their sigmas; NaN where they do not."""
    n, sigma_deg = len(heading_deg), np.where(np.isnan(heading_deg), np.inf, sigma_deg)
    return Course(heading_deg, sigma_deg, np.ones(n, dtype=np.int64), np.zeros(n))


def course_heading(
    fixes: AcceptedFixes, rig: VehicleGeometry | None, settings: PoseSettings
) -> Course:
    """Course where it is the heading: at the axle that does not steer, when the rig names it.

    The antenna, a metre ahead, swings outward in a turn: its course leads the heading by
    asin(distance · curvature), 11° at a radius of 5 m.
    """
    part = np.concatenate([[0], np.cumsum(np.diff(fixes.time_ns) > MAX_GAP_NS)])
    baseline_m = settings.baseline_m or default_baseline_m(fixes.sigma_m)
    step_m = max(STATION_M, 2.0 * NOISE_SHARE * float(np.median(fixes.sigma_m)))
    points = fixes.points_m()
    at = stations(points, part, fixes.speed_mps < REST_MPS, step_m)
    east_m, north_m = points[at].T
    up_m = 0.0 if rig is None else rig.antenna.up_m
    found = course(east_m, north_m, fixes.sigma_m[at], part[at], baseline_m, up_m)
    if rig is not None and rig.rear_axle_forward_m is not None:
        ahead_m = rig.antenna.forward_m - rig.rear_axle_forward_m
        found = course_of_axle(found, east_m, north_m, part[at], ahead_m)
    # The fixes between two stations have the heading of the one before.
    station = np.searchsorted(at, np.arange(len(fixes.time_ns)), side="right") - 1
    heading, sigma, gear, span = found
    return Course(heading[station], sigma[station], gear[station], span[station])


def default_baseline_m(sigma_m: Float64) -> float:
    """A baseline for the fixes at hand: 200 sigma, between 4 and 12 m.

    At a fix every 0.3 m that gives about 0.3° from 2 cm. Longer ones cut corners: rows are
    not straight to a degree over more than a few metres.
    """
    return float(np.clip(200.0 * np.median(sigma_m), 4.0, 12.0))


def jumps(
    east_m: Float64,
    north_m: Float64,
    heading_deg: Float64,
    sigma_deg: Float64,
    min_turn_radius_m: float,
) -> Bool:
    """Which of n headings jump away from both neighbours further than a vehicle can turn.

    The paper's indicator: a few isolated jumps corrupt a map, so their grids are discarded.
    """
    found = np.zeros(len(heading_deg), dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(heading_deg) & np.isfinite(sigma_deg))
    if known.size < 3:
        return found
    turn = np.abs(wrap_deg(np.diff(heading_deg[known])))
    way_m = np.hypot(np.diff(east_m[known]), np.diff(north_m[known]))
    sigma = np.hypot(sigma_deg[known][1:], sigma_deg[known][:-1])
    possible = np.degrees(way_m / min_turn_radius_m) + JUMP_SIGMAS * sigma + JUMP_DEG
    impossible = turn > possible
    found[known[1:-1]] = impossible[:-1] & impossible[1:]
    return found


class PoseTable(NamedTuple):
    """Poses of the unsteered axle (smooth) or of the antenna (else), n rows ordered by time.

    `offset_m` is how far the fixes around a pose lie from it on average and `stated_m` what they
    state. `rejection` says why conditioning refused a fix, `remark` what it noted of an accepted
    one.
    """

    time_ns: Int64
    east_m: Float64
    north_m: Float64
    up_m: Float64
    heading_deg: Float64
    heading_sigma_deg: Float64
    position_sigma_m: Float64
    relative_sigma_m: Float64
    speed_mps: Float64
    gear: Int64
    gear_doubt: Float64
    offset_m: Float64
    stated_m: Float64
    quality: Int64
    resting: Bool
    rejection: list[str]
    remark: list[str]

    def rows(self, at: Int64) -> PoseTable:
        """Some of the rows, copied."""
        chosen = at.tolist()
        return PoseTable._make(
            c[at] if isinstance(c, np.ndarray) else [c[k] for k in chosen] for c in self
        )


class ConditionedLog(NamedTuple):
    """All fixes of a drive in order of time with their verdicts, and the accepted ones in the
    plane of the datum."""

    fixes: FixColumns
    verdicts: Verdicts
    datum: Datum
    accepted: AcceptedFixes


def pose_table(
    source: HeadingSource,
    log: ConditionedLog,
    drive: DriveEstimate,
    recorded_deg: Float64,
    rig: VehicleGeometry | None,
    settings: PoseSettings,
) -> tuple[PoseTable, Int64]:
    """The table, and the row of each fix in it. `recorded_deg` are headings of the vehicle that
    were recorded with the accepted fixes."""
    if source.kind == "smooth":
        return _smooth_table(log, drive)
    if source.kind == "course":
        found = course_heading(log.accepted, rig, settings)
    elif source.kind == "recorded":
        found = stated_heading(recorded_deg, log.accepted.recorded_sigma_deg)
    else:
        constant_deg = np.full(len(log.accepted.time_ns), source.constant_deg)
        found = stated_heading(constant_deg, np.full_like(constant_deg, CONSTANT_SIGMA_DEG))
    rows = _paper_table(log, drive, found, settings)
    return rows, np.arange(len(log.fixes), dtype=np.int64)


def _smooth_table(log: ConditionedLog, drive: DriveEstimate) -> tuple[PoseTable, Int64]:
    """The nodes of the drive, each judged by what is known there, and beside them every
    rejected fix with the estimate of its time: a bad fix does not spoil the pose."""
    ok, reason = log.verdicts.ok, log.verdicts.reason
    fix_ns = log.fixes.time_ns
    owner = np.full(len(drive.time_ns), -1, dtype=np.int64)
    owner[drive.fix >= 0] = np.flatnonzero(ok)
    extra = np.flatnonzero(~ok)
    node = np.minimum(np.searchsorted(drive.time_ns, fix_ns[extra]), len(drive.time_ns) - 1)
    time_ns = np.concatenate([drive.time_ns, fix_ns[extra]])
    at = np.concatenate([np.arange(len(drive.time_ns)), node])
    fix = np.concatenate([owner, extra])
    order = np.argsort(time_ns, kind="stable")
    time_ns, at, fix = time_ns[order], at[order], fix[order]
    outside = (time_ns < drive.time_ns[0]) | (time_ns > drive.time_ns[-1])
    own = fix >= 0
    fix_row = np.empty(len(log.fixes), dtype=np.int64)
    fix_row[fix[own]] = np.flatnonzero(own)
    used = log.accepted
    east, north, up = (
        drive.east_m[at],
        drive.north_m[at],
        np.interp(time_ns, used.time_ns, used.up_m),
    )
    east[outside], north[outside], up[outside] = _positions(log, fix[outside])
    offset_m, stated_m = fix_offsets(drive.time_ns, used, drive.offset_m)
    stated_m = stated_m * drive.slow.factor
    return PoseTable(
        time_ns,
        east,
        north,
        up,
        np.where(outside, np.nan, drive.heading_deg[at]),
        np.where(outside, np.inf, drive.heading_sigma_deg[at]),
        np.where(outside, log.fixes.position_sigma_m()[fix], drive.position_sigma_m[at]),
        drive.relative_sigma_m[at],
        np.where(outside, np.nan, drive.speed_mps[at]),
        np.where(outside, 0, drive.gear[at]),
        drive.doubt[at],
        offset_m[at],
        stated_m[at],
        np.where(own, log.fixes.quality[fix], Quality.ESTIMATED),
        drive.resting[at] & ~outside,
        ["" if k < 0 or ok[k] else reason[k] for k in fix.tolist()],
        [reason[k] if k >= 0 and ok[k] else "" for k in fix.tolist()],
    ), fix_row


def _positions(log: ConditionedLog, rows: Int64) -> tuple[Float64, Float64, Float64]:
    """East, north and up as some of the fixes have them, rejected or not."""
    some = log.fixes[rows]
    with np.errstate(invalid="ignore"):  # rejected fixes may hold anything
        return log.datum.to_enu(some.lat_deg, some.lon_deg, some.height_m)


def _paper_table(
    log: ConditionedLog, drive: DriveEstimate, found: Course, settings: PoseSettings
) -> PoseTable:
    """A row a fix, at its own position, with a heading of the paper's kind."""
    ok, used = log.verdicts.ok, log.accepted
    n = len(ok)

    def everywhere(values: Float64, unknown: float) -> Float64:
        column = np.full(n, unknown)
        column[ok] = values
        return column

    gear, driven = drive.gear[drive.fix >= 0], drive.speed_mps[drive.fix >= 0]
    stated = log.fixes.speed_mps
    resting = gear == 0
    if np.isfinite(found.span_m).all() and found.span_m.any():  # course: the gear is its own
        gear = np.where(resting, 0, found.gear)
    rejection = [r if not o else "" for r, o in zip(log.verdicts.reason, ok, strict=True)]
    jumping = jumps(
        used.east_m, used.north_m, found.heading_deg, found.sigma_deg, settings.min_turn_radius_m
    )
    for k in np.flatnonzero(ok)[jumping].tolist():
        rejection[k] = "heading jumps away from that of both neighbours"
    gears = everywhere(gear.astype(np.float64), 0.0).astype(np.int64)
    positions = _positions(log, np.arange(n))
    for column, accepted in zip(positions, (used.east_m, used.north_m, used.up_m), strict=True):
        column[ok] = accepted
    return PoseTable(
        log.fixes.time_ns,
        *positions,
        everywhere(found.heading_deg, np.nan),
        everywhere(found.sigma_deg, np.inf),
        log.fixes.position_sigma_m(),
        everywhere(used.noise.across_m, np.inf),
        np.where(np.isnan(stated), everywhere(np.abs(driven), np.nan), stated) * gears,
        gears,
        np.zeros(n),
        np.zeros(n),
        np.full(n, np.inf),
        log.fixes.quality,
        everywhere(resting.astype(np.float64), 0.0) > 0.0,
        rejection,
        [r if o else "" for r, o in zip(log.verdicts.reason, ok, strict=True)],
    )
