"""From fixes to the trajectory of the grid origin: plane, heading, lever arm, verdict."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from fieldgrid.angles import wrap_deg
from fieldgrid.course import (
    NOISE_SHARE,
    STATION_M,
    Course,
    course,
    course_of_axle,
    stations,
)
from fieldgrid.errors import ConfigError, GnssError
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import Fix, Verdict, condition, position_sigma_m
from fieldgrid.rig import LeverArm, Rig
from fieldgrid.trajectory import MAX_GAP_NS, Status, Trajectory

_Float64 = npt.NDArray[np.float64]

CONSTANT_SIGMA_DEG = 1.0
"""What a heading given by hand is taken to be good for."""

STANDING_MPS = 0.1
"""Below this speed, as the receiver measured it, a vehicle stands and its positions wander."""

RECORDED_SIGMA_DEG = 1.0
"""The error of a recorded heading whose source does not state one."""


class PoseSettings(BaseModel):
    """Where headings come from, and how sure a pose must be to enter a map."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    heading: str = "auto"
    baseline_m: float | None = Field(default=None, gt=0.1, le=100.0)
    max_heading_sigma_deg: float = Field(default=3.0, gt=0.0, le=90.0)
    max_position_sigma_m: float = Field(default=2.0, gt=0.0, le=100.0)


class HeadingSource(NamedTuple):
    """`kind` is recorded, course or constant; `constant_deg` belongs to the last."""

    kind: str
    constant_deg: float = 0.0

    def __str__(self) -> str:
        return f"constant:{self.constant_deg:g}" if self.kind == "constant" else self.kind


def heading_source(text: str, fixes: Sequence[Fix]) -> HeadingSource:
    """Parse recorded | course | constant:DEG | auto (recorded where the fixes have it)."""
    has_recorded = any(fix.heading_deg is not None for fix in fixes)
    if text == "auto":
        return HeadingSource("recorded" if has_recorded else "course")
    if text == "course":
        return HeadingSource("course")
    if text == "recorded":
        if not has_recorded:
            raise GnssError(
                "No fix of this recording has a heading of its own; use --heading course."
            )
        return HeadingSource("recorded")
    match = re.fullmatch(r"constant:([-+]?\d+(?:\.\d+)?)", text)
    if not match or not -360.0 <= float(match[1]) <= 360.0:
        raise ConfigError(
            f"Heading source {text!r} is none of auto, recorded, course, constant:DEG "
            "(degrees clockwise from north, as in constant:-100)."
        )
    return HeadingSource("constant", float(wrap_deg(float(match[1]))))


def datum_of(fixes: Sequence[Fix], verdicts: Sequence[Verdict]) -> Datum:
    """The datum of a first map: the first accepted fix, rounded to 1e-7 degrees and 1 mm."""
    for fix, verdict in zip(fixes, verdicts, strict=True):
        if verdict.status is Status.OK:
            return Datum(round(fix.lat_deg, 7), round(fix.lon_deg, 7), round(fix.height_m, 3))
    raise GnssError(no_fix_sentence(fixes, verdicts))


def no_fix_sentence(fixes: Sequence[Fix], verdicts: Sequence[Verdict]) -> str:
    """Why there is nothing to place images with: how many fixes, and the commonest reason."""
    if not fixes:
        return "The GNSS log holds no position at all; record one, or choose another with --gnss."
    reasons = [verdict.reason for verdict in verdicts]
    commonest = max(set(reasons), key=reasons.count)
    return (
        f"None of the {len(fixes)} fixes can be used, mostly because: {commonest}; "
        "choose another log with --gnss."
    )


def estimate_poses(
    fixes: Sequence[Fix],
    rig: Rig,
    datum: Datum | None = None,
    settings: PoseSettings | None = None,
) -> Trajectory:
    """The trajectory of the grid origin from the fixes of one drive.

    Fixes are conditioned, carried into the LTP of `datum` (the first accepted fix without
    one), given a heading, moved from the antenna to the grid origin, and judged. Raises
    GnssError when no fix can be used.
    """
    settings = settings or PoseSettings()
    fixes = sorted(fixes, key=lambda fix: fix.time_ns)
    verdicts = condition(fixes)
    if not any(verdict.status is Status.OK for verdict in verdicts):
        raise GnssError(no_fix_sentence(fixes, verdicts))
    datum = datum or datum_of(fixes, verdicts)
    source = heading_source(settings.heading, fixes)

    with np.errstate(invalid="ignore"):  # rejected fixes may hold anything
        antenna_e, antenna_n, antenna_u = datum.to_enu(
            [fix.lat_deg for fix in fixes],
            [fix.lon_deg for fix in fixes],
            [fix.height_m for fix in fixes],
        )
    sigma_m = np.array([position_sigma_m(fix) for fix in fixes])
    ok = np.array([verdict.status is Status.OK for verdict in verdicts])
    headings = _headings(fixes, source, ok, antenna_e, antenna_n, sigma_m, rig, settings)
    east_m, north_m = carry_lever(antenna_e, antenna_n, headings.heading_deg, rig.antenna)
    status, reason = _judge(verdicts, headings, sigma_m, settings)
    return Trajectory(
        datum=datum,
        time_ns=np.array([fix.time_ns for fix in fixes], dtype=np.int64),
        east_m=east_m,
        north_m=north_m,
        up_m=antenna_u - rig.antenna.up_m,
        heading_deg=headings.heading_deg,
        position_sigma_m=sigma_m,
        heading_sigma_deg=headings.sigma_deg,
        speed_mps=_speeds(fixes, headings.gear),
        quality=np.array([fix.quality for fix in fixes], dtype=np.int64),
        status=status,
        reason=reason,
        heading_source=str(source),
    )


def carry_lever(
    antenna_e: _Float64, antenna_n: _Float64, heading: _Float64, lever: LeverArm
) -> tuple[_Float64, _Float64]:
    """From the antenna to the grid origin: Eq. 3 of the lever arm, subtracted.

    Where the heading is NaN the antenna's own position is kept; such a pose is rejected.
    """
    phi = np.radians(np.nan_to_num(heading))
    known = ~np.isnan(heading)
    east = antenna_e - known * (lever.right_m * np.cos(phi) + lever.forward_m * np.sin(phi))
    north = antenna_n - known * (-lever.right_m * np.sin(phi) + lever.forward_m * np.cos(phi))
    return east, north


def _headings(
    fixes: Sequence[Fix],
    source: HeadingSource,
    ok: npt.NDArray[np.bool_],
    antenna_e: _Float64,
    antenna_n: _Float64,
    sigma_m: _Float64,
    rig: Rig,
    settings: PoseSettings,
) -> Course:
    n = len(fixes)
    if source.kind == "course":
        found = _course_of_axle(fixes, antenna_e[ok], antenna_n[ok], sigma_m[ok], ok, rig, settings)
        full = Course(np.full(n, np.nan), np.full(n, np.inf), np.ones(n, np.int64), np.zeros(n))
        for whole, part in zip(full, found, strict=True):
            whole[ok] = part
        return full
    if source.kind == "constant":
        heading, sigma = np.full(n, source.constant_deg), np.full(n, CONSTANT_SIGMA_DEG)
    else:
        recorded = [np.nan if fix.heading_deg is None else fix.heading_deg for fix in fixes]
        heading = wrap_deg(np.array(recorded))
        sigma = np.array([fix.heading_sigma_deg or RECORDED_SIGMA_DEG for fix in fixes])
        sigma[np.isnan(heading)] = np.inf
    return Course(heading, sigma, np.ones(n, dtype=np.int64), np.zeros(n))


def _course_of_axle(
    fixes: Sequence[Fix],
    antenna_e: _Float64,
    antenna_n: _Float64,
    sigma_m: _Float64,
    ok: npt.NDArray[np.bool_],
    rig: Rig,
    settings: PoseSettings,
) -> Course:
    """Course where it is the heading: at the axle that does not steer, when the rig names it.

    The antenna, a metre ahead, swings outward in a turn: its course leads the heading by
    asin(distance · curvature), 11° at a radius of 5 m.
    """
    times = np.array([fix.time_ns for fix in fixes], dtype=np.int64)[ok]
    part = np.concatenate([[0], np.cumsum(np.diff(times) > MAX_GAP_NS)])
    baseline_m = settings.baseline_m or default_baseline_m(sigma_m)
    step_m = max(STATION_M, 2.0 * NOISE_SHARE * float(np.median(sigma_m)))
    speeds = [fix.speed_mps for fix, used in zip(fixes, ok, strict=True) if used]
    standing = np.array([speed is not None and speed < STANDING_MPS for speed in speeds])
    at = stations(np.stack([antenna_e, antenna_n], axis=1), part, standing, step_m)
    east_m, north_m, part_at = antenna_e[at], antenna_n[at], part[at]
    found = course(east_m, north_m, sigma_m[at], part_at, baseline_m, rig.antenna.up_m)
    if rig.rear_axle_forward_m is not None:
        ahead_m = rig.antenna.forward_m - rig.rear_axle_forward_m
        found = course_of_axle(found, east_m, north_m, part_at, ahead_m)
    # The fixes between two stations have the heading of the one before.
    station = np.searchsorted(at, np.arange(len(antenna_e)), side="right") - 1
    return Course(
        found.heading_deg[station],
        found.sigma_deg[station],
        found.gear[station],
        found.span_m[station],
    )


def default_baseline_m(sigma_m: _Float64) -> float:
    """A baseline for the fixes at hand: 200 sigma, between 4 and 12 m.

    At a fix every 0.3 m that gives about 0.3° from 2 cm. Longer ones cut corners: rows are
    not straight to a degree over more than a few metres.
    """
    return float(np.clip(200.0 * np.median(sigma_m), 4.0, 12.0))


def _judge(
    verdicts: Sequence[Verdict], headings: Course, sigma_m: _Float64, settings: PoseSettings
) -> tuple[tuple[Status, ...], tuple[str, ...]]:
    status, reason = [], []
    for k, verdict in enumerate(verdicts):
        # An accepted fix may carry a reason too: that the solution has moved there.
        doubt = _doubt(headings, k, sigma_m[k], settings) if verdict.status is Status.OK else ""
        status.append(Status.REJECTED if doubt else verdict.status)
        reason.append(doubt or verdict.reason)
    return tuple(status), tuple(reason)


def _doubt(headings: Course, k: int, sigma_m: float, settings: PoseSettings) -> str:
    """Why the pose at an accepted fix is not sure enough for a map; empty when it is."""
    sigma_deg = headings.sigma_deg[k]
    if not np.isfinite(sigma_deg):
        if np.isnan(headings.heading_deg[k]) and headings.span_m[k] > 0.0:
            return f"heading unknown: only {headings.span_m[k]:.2f} m of path around it"
        return "heading unknown: none is recorded, and the vehicle does not move"
    if sigma_deg > settings.max_heading_sigma_deg:
        return f"heading sigma {sigma_deg:.1f}° > {settings.max_heading_sigma_deg:g}°"
    if sigma_m > settings.max_position_sigma_m:
        return f"position sigma {sigma_m:.2f} m > {settings.max_position_sigma_m:g} m"
    return ""


def _speeds(fixes: Sequence[Fix], gear: npt.NDArray[np.int64]) -> _Float64:
    """Speed in m/s, negative in reverse; NaN where the receiver gave none."""
    recorded = [np.nan if fix.speed_mps is None else fix.speed_mps for fix in fixes]
    return np.array(recorded) * gear
