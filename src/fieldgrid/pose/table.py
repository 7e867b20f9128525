"""Poses as a table in order of time: what every way to headings ends in, before the verdict."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.course import Course
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import CountedTwice, Verdicts
from fieldgrid.pose.accepted import AcceptedFixes, fix_offsets
from fieldgrid.pose.drive import DriveEstimate
from fieldgrid.pose.paper import CONSTANT_SIGMA_DEG, course_heading, stated_heading
from fieldgrid.pose.settings import HeadingSource
from fieldgrid.pose.verdict import jumps
from fieldgrid.quality import Quality
from fieldgrid.rig import VehicleGeometry
from fieldgrid.settings import PoseSettings


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
    plane of the datum; `twice` are those whose seconds the log counts twice, if there are any, and
    `spans` these seconds."""

    fixes: FixColumns
    verdicts: Verdicts
    datum: Datum
    accepted: AcceptedFixes
    twice: Bool | None = None
    spans: tuple[CountedTwice, ...] = ()


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

    gear = drive.gear[drive.fix >= 0]
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
        log.fixes.speed_mps * gears,
        gears,
        np.zeros(n),
        np.zeros(n),
        np.full(n, np.inf),
        log.fixes.quality,
        everywhere(resting.astype(np.float64), 0.0) > 0.0,
        rejection,
        [r if o else "" for r, o in zip(log.verdicts.reason, ok, strict=True)],
    )
