"""Poses as rows in order of time: what every way to headings ends in, before the verdict."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.course import Course
from fieldgrid.pose.paper import constant_heading, course_heading, recorded_heading
from fieldgrid.pose.placed import Placed
from fieldgrid.pose.settings import HeadingSource
from fieldgrid.pose.smooth import Drive
from fieldgrid.pose.verdict import jumps
from fieldgrid.quality import Quality
from fieldgrid.rig import Vehicle
from fieldgrid.settings import PoseSettings


class Rows(NamedTuple):
    """Poses of the unsteered axle (smooth) or of the antenna (else), n rows ordered by time.

    `rejection` says why conditioning refused a fix, `remark` what it noted of an accepted one.
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
    quality: Int64
    resting: Bool
    rejection: list[str]
    remark: list[str]


def rows_of(
    source: HeadingSource,
    placed: Placed,
    drive: Drive,
    nose_deg: Float64,
    rig: Vehicle | None,
    settings: PoseSettings,
) -> tuple[Rows, Int64]:
    """Rows in order of time, and the row of each fix."""
    if source.kind == "smooth":
        return _smooth_rows(placed, drive)
    if source.kind == "course":
        found = course_heading(placed, rig, settings)
    elif source.kind == "recorded":
        found = recorded_heading(nose_deg, placed.recorded_sigma_deg)
    else:
        found = constant_heading(len(placed.time_ns), source.constant_deg)
    rows = _paper_rows(placed, drive, found, settings)
    return rows, np.arange(len(placed.time_ns), dtype=np.int64)


def _smooth_rows(placed: Placed, drive: Drive) -> tuple[Rows, Int64]:
    """The nodes of the drive, each judged by what is known there, and beside them every
    rejected fix with the estimate of its time: a bad fix does not spoil the pose."""
    node = np.searchsorted(drive.time_ns, placed.time_ns)
    node = np.minimum(node, len(drive.time_ns) - 1)
    owner = np.full(len(drive.time_ns), -1, dtype=np.int64)
    owner[drive.fix >= 0] = np.flatnonzero(placed.ok)
    extra = np.flatnonzero(~placed.ok)
    time_ns = np.concatenate([drive.time_ns, placed.time_ns[extra]])
    at = np.concatenate([np.arange(len(drive.time_ns)), node[extra]])
    fix = np.concatenate([owner, extra])
    order = np.argsort(time_ns, kind="stable")
    time_ns, at, fix = time_ns[order], at[order], fix[order]
    outside = (time_ns < drive.time_ns[0]) | (time_ns > drive.time_ns[-1])
    own = fix >= 0
    fix_row = np.empty(len(placed.time_ns), dtype=np.int64)
    fix_row[fix[own]] = np.flatnonzero(own)
    up = np.interp(time_ns, placed.time_ns[placed.ok], placed.up_m[placed.ok])
    rows = Rows(
        time_ns,
        np.where(outside, placed.east_m[fix], drive.east_m[at]),
        np.where(outside, placed.north_m[fix], drive.north_m[at]),
        np.where(outside, placed.up_m[fix], up),
        np.where(outside, np.nan, drive.heading_deg[at]),
        np.where(outside, np.inf, drive.heading_sigma_deg[at]),
        np.where(outside, placed.sigma_m[fix], drive.position_sigma_m[at]),
        drive.relative_sigma_m[at],
        np.where(outside, np.nan, drive.speed_mps[at]),
        np.where(outside, 0, drive.gear[at]),
        drive.doubt[at],
        np.where(own, placed.quality[fix], Quality.ESTIMATED),
        drive.resting[at] & ~outside,
        ["" if k < 0 or placed.ok[k] else placed.reason[k] for k in fix.tolist()],
        [placed.reason[k] if k >= 0 and placed.ok[k] else "" for k in fix.tolist()],
    )
    return rows, fix_row


def _paper_rows(placed: Placed, drive: Drive, found: Course, settings: PoseSettings) -> Rows:
    """A row a fix, at its own position, with a heading of the paper's kind."""
    ok = placed.ok
    gear = np.zeros(len(ok), dtype=np.int64)
    gear[ok] = drive.gear[drive.fix >= 0]
    resting = gear == 0
    if np.isfinite(found.span_m).all() and found.span_m.any():  # course: the gear is its own
        gear = np.where(resting, 0, found.gear)
    jumping = np.zeros(len(ok), dtype=np.bool_)
    jumping[ok] = jumps(
        placed.east_m[ok],
        placed.north_m[ok],
        found.heading_deg[ok],
        found.sigma_deg[ok],
        settings.min_turn_radius_m,
    )
    rejection = [r if not o else "" for r, o in zip(placed.reason, ok, strict=True)]
    for k in np.flatnonzero(jumping):
        rejection[k] = "heading jumps away from that of both neighbours"
    return Rows(
        placed.time_ns,
        placed.east_m,
        placed.north_m,
        placed.up_m,
        np.where(ok, found.heading_deg, np.nan),
        np.where(ok, found.sigma_deg, np.inf),
        placed.sigma_m,
        placed.noise_m,
        placed.speed_mps * gear,
        gear,
        np.zeros(len(ok)),
        placed.quality,
        resting & ok,
        rejection,
        [r if o else "" for r, o in zip(placed.reason, ok, strict=True)],
    )
