"""What was found out about a drive besides its poses, and what to tell the user of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import (
    Figure,
    Finding,
    Float64,
    Int64,
    PoseSettings,
    commonest_reason,
    info,
    utc_text,
    warning,
)
from fieldgrid.geometry import Rig, Trajectory, VehicleGeometry, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes, fix_offsets
from fieldgrid.poses.attitude.attitude import Attitude
from fieldgrid.poses.axle import Axle, names_axle
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.external.georeference import Georeference
from fieldgrid.poses.faults.camera_yaw import CameraYaw, yaw_findings
from fieldgrid.poses.faults.clock.change import ClockChange
from fieldgrid.poses.faults.clock.offset import ClockFindings
from fieldgrid.poses.faults.clock.search import ClockOffset, MotionContradiction
from fieldgrid.poses.faults.clock.told import clock_findings
from fieldgrid.poses.faults.convention import Comparison
from fieldgrid.poses.faults.denied import DriveContradiction, denied_findings
from fieldgrid.poses.faults.leaps.seams import LEAP_S
from fieldgrid.poses.faults.unseen import UnseenFault
from fieldgrid.poses.gates.summary import ConditioningSummary
from fieldgrid.poses.gears.stations import TELL_GEARS
from fieldgrid.poses.settings import HeadingSource
from fieldgrid.poses.smoother.declared import DRIFT, LIKELY, Constant

GOOD_FIX_M = 0.05
"""To say that fixes are better than this admits no more headings."""

LEAST_DRIFT_M, DRIFT_TIMES = 0.2, 3.0
"""A drift of less than this, or than this multiple of the stated error, is not reported: the camera
itself makes as much."""


class FixOffset(NamedTuple):
    """How far the antenna is estimated from the accepted fixes, metres: the mean east and north,
    the median and the largest distance, and the median over the stated error; the median of the
    mean offset over 20 s, which white noise leaves alone, and that over the stated error."""

    mean_east_m: float
    mean_north_m: float
    median_m: float
    most_m: float
    median_sigmas: float
    lasting_m: float
    lasting_sigmas: float


@dataclass(frozen=True, slots=True)
class PoseReport:
    """What was found out about a drive besides its poses.

    `attitude` is how the vehicle leans, None where nothing tells it. `recorded` is a recorded
    heading beside the estimate; `gyro_bias_dps` NaN without a gyro. `offset` compares poses with
    their fixes. `camera_scale` and `wheel_scale` are by what share the distances of camera and
    wheels are too long. As the camera's motion has it, `clock` is the time offset between images
    and fixes, `clock_change` where that offset changes, `contradiction` how much of the motion no
    offset explains, `camera_yaw` where the camera looks. `unseen` are faults that the drive
    would not show: its sigmas do not cover them. `findings` tell all of it to people.
    """

    conditioning: ConditioningSummary
    attitude: Attitude | None
    recorded: Comparison | None
    clock: ClockOffset | None
    gyro_bias_dps: float
    offset: FixOffset | None
    camera_scale: Constant | None
    wheel_scale: Constant | None
    findings: tuple[Finding, ...]
    georeference: Georeference | None = None
    contradiction: MotionContradiction | None = None
    clock_change: ClockChange | None = None
    camera_yaw: CameraYaw | None = None
    unseen: tuple[UnseenFault, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return tuple(map(str, self.findings))

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is unknown is null."""
        bias = self.gyro_bias_dps
        parts = {
            "recorded_heading": self.recorded,
            "clock_offset": self.clock,
            "camera_contradiction": self.contradiction,
            "clock_change": self.clock_change,
            "fix_offset": self.offset,
            "camera_scale": self.camera_scale,
            "wheel_scale": self.wheel_scale,
            "georeference": self.georeference,
        }
        return {
            "conditioning": self.conditioning.as_dict(),
            "attitude": None if self.attitude is None else self.attitude.as_dict(),
            **{
                name: None
                if part is None
                else (
                    {
                        name: None if value != value else value
                        for name, value in part._asdict().items()
                    }
                )
                for name, part in parts.items()
            },
            "camera_yaw": None if self.camera_yaw is None else self.camera_yaw._asdict(),
            "gyro_bias_dps": None if np.isnan(bias) else bias,
            "unseen": [str(fault) for fault in self.unseen],
            "findings": [one.as_dict() for one in self.findings],
        }


class Estimate(NamedTuple):
    """A trajectory, the row of each input fix in it (in order of time), the report, and for each
    row the probability that the gear is the other one. Of given poses without fixes, `fix_row` has
    all rows."""

    trajectory: Trajectory
    fix_row: Int64
    report: PoseReport
    gear_doubt: Float64


def fix_offset(fixes: AcceptedFixes, offset_m: Float64) -> FixOffset:
    """How far the antenna is estimated from the accepted fixes: `offset_m` [fixes, 2]."""
    away_m = np.hypot(*offset_m.T)
    east_m, north_m = offset_m.mean(axis=0).tolist()
    lasting_m, stated_m = fix_offsets(fixes.time_ns, fixes, offset_m)
    return FixOffset(
        east_m,
        north_m,
        float(np.median(away_m)),
        float(away_m.max()),
        float(np.median(away_m / fixes.sigma_m)),
        float(np.median(lasting_m)),
        float(np.median(lasting_m / stated_m)),
    )


def drive_findings(
    drive: DriveEstimate,
    fixes: AcceptedFixes,
    rig: VehicleGeometry | None,
    axle: Axle,
    denied: DriveContradiction,
    source: HeadingSource,
    settings: PoseSettings,
    clocks: ClockFindings,
    yaw: CameraYaw | None,
    trajectory: Trajectory,
    fix_row: Int64,
    frame_ns: Int64 | None,
) -> Iterator[Finding]:
    """What is told of a drive; `rig` as it was declared."""
    yield from clock_findings(clocks, fixes, frame_ns)
    yield from yaw_findings(yaw)
    yield from _of_constant(source, drive, settings)
    # That the gears that the user knows are those of another time.
    first_ns, last_ns = (int(ns) for ns in fixes.time_ns[[0, -1]])
    spans = settings.gear_spans
    if spans and all(one.stop_ns < first_ns or one.start_ns > last_ns for one in spans):
        yield warning(
            "gears-elsewhere",
            "The known gears are all of a time before or after this drive, and were not used; "
            f"their times are UTC, and it lasts from {utc_text(first_ns)} to {utc_text(last_ns)}.",
        )
    if len(leaps_ns(fixes)):
        yield _leaps(fixes)
    yield from _drift(drive)
    if not names_axle(rig):
        yield _no_axle(rig, axle)
    yield from denied_findings(drive, denied)
    if not trajectory.accepted.any():
        yield _no_pose(trajectory, fix_row, fixes, settings)


def _of_constant(
    source: HeadingSource, drive: DriveEstimate, settings: PoseSettings
) -> Iterator[Finding]:
    """A heading given by hand beside that of the drive."""
    moving = (drive.gear != 0) & (drive.heading_sigma_deg < settings.max_heading_sigma_deg)
    if source.kind != "constant" or not moving.any():
        return
    off = np.abs(wrap_deg(drive.heading_deg[moving] - source.constant_deg))
    share = float(np.mean(off > 10.0))
    if share >= 0.1:
        yield warning(
            "heading-constant",
            f"The constant heading {source.constant_deg:g}° is more than 10° off the drive's own "
            f"in {100.0 * share:.0f} % of it (median {np.median(off):.0f}°).",
            figure=Figure(100.0 * share, "%"),
        )


def leaps_ns(fixes: AcceptedFixes) -> Int64:
    """The times of the fixes after which the solution goes on elsewhere."""
    return fixes.time_ns[fixes.lasting_s <= LEAP_S]


def _leaps(fixes: AcceptedFixes) -> Finding:
    """That the receiver's solution leaps, and what its positions count as."""
    leaps = leaps_ns(fixes)
    first_s = (leaps[0] - fixes.time_ns[0]) / 1e9
    sigma_m = float(np.median(fixes.sigma_m))
    often = "once" if len(leaps) == 1 else f"{len(leaps)} times"
    return warning(
        "leaps",
        f"The receiver's solution leaps {often} by more than it states (first {first_s:.0f} s "
        "after the start), and nothing tells which side is right: its positions count as good to "
        f"{sigma_m:.2f} m.",
        "If you know, keep that side alone: --until or --from "
        f"{utc_text(int(leaps[0]) + 1, 'ms')}.",
        Figure(sigma_m, "m"),
    )


def _drift(drive: DriveEstimate) -> Iterator[Finding]:
    """That the slow error of the fixes is larger than they state."""
    declared = drive.smoothed.declared
    # What does not fit together makes fixes wander beside the drive, too.
    larger = drive.slow.larger > 0 and not declared.contradicts
    stated_m = float(np.median(drive.measured.bias_m)) / drive.slow.factor
    if not larger and declared.probability(DRIFT) < LIKELY:
        return
    extent_m = declared.extent_m(drive.measured.time_s)
    if larger:
        extent_m = float(np.hypot(*np.ptp(drive.smoothed.state[:, 6:], axis=0)))
    if extent_m > max(LEAST_DRIFT_M, DRIFT_TIMES * stated_m):
        by = "camera" if len(drive.measured.step) else "gyro"
        yield warning(
            "drift",
            f"By the {by} the fixes drift by about {extent_m:.1f} m within the drive, more than "
            "they state, and nothing shows where they are right: positions count as good to "
            f"{max(drive.slow.factor * stated_m, extent_m / 2.0):.1f} m.",
            "Check the receiver's base station and corrections, and how cameras and IMU are "
            "mounted: one that is tilted or was pushed looks the same.",
            Figure(extent_m, "m"),
        )


def _no_axle(rig: VehicleGeometry | None, axle: Axle) -> Finding:
    """That nobody says where the axle is, and what that means."""
    remedy, figure = "Say it with --antenna-ahead METRES.", None
    if isinstance(rig, Rig):
        remedy = "Declare camera_mid_from_rear_axle_ground_flu_m in mounting.json."
    turns = "a metre is 11° at a radius of 5 m"
    if axle.told:
        (_, ahead_m), _ = axle.frame()
        means = f"; by the drive it is {ahead_m:.2f} m ± {axle.sigma_m:.2f} m"
        figure = Figure(ahead_m, "m")
    elif isinstance(rig, Rig):
        means = f", so headings are unsure in turns: {turns}"
    else:
        means = f"; it is taken to be above it. Ahead of it, headings are off in turns: {turns}"
    return info(
        "axle-unknown",
        f"Nothing says how far the antenna sits ahead of the axle that does not steer{means}.",
        remedy,
        figure,
    )


def _no_pose(
    trajectory: Trajectory, fix_row: Int64, fixes: AcceptedFixes, settings: PoseSettings
) -> Finding:
    """What to declare for poses of a refused drive to be used. The reasons are those of the poses
    at fixes, as everywhere; there may be more between them."""
    commonest = commonest_reason([trajectory.reason[row] for row in fix_row])
    sigma_m = float(np.median(fixes.sigma_m))
    better = (
        f"the fixes count as good to {sigma_m:.2f} m; if they are better, say so with "
        "--accuracy METRES or --quality NAME, "
    )
    surer = (
        f"{better if sigma_m > GOOD_FIX_M else ''}record a gyro or more fixes a second, or "
        f"allow less with max_heading_sigma_deg (now {settings.max_heading_sigma_deg:g}) in "
        "--config"
    )
    remedies = {
        "position sigma": "if the receiver is better than that, say so with --accuracy METRES or "
        "--quality NAME (rtk-fixed, rtk-float, differential, ...)",
        "the estimate lies": "the fixes contradict each other by more than they state; say how "
        "good they are with --accuracy METRES, or leave out the epochs of another receiver or of "
        "a jump",
        "forward or reverse": TELL_GEARS,
        "heading unknown": "log while the vehicle drives, or record its heading",
        "heading sigma": surer,
        "a cell": surer,
    }
    known = [remedy for start, remedy in remedies.items() if commonest.startswith(start)]
    # What is declared of the fixes does not tell which solution was right.
    beside = "keep the part on one side of a leap alone" if len(leaps_ns(fixes)) else ""
    advice = beside or "".join(known) or "choose another log with --gnss"
    return warning(
        "no-pose",
        f"No pose can be used, mostly because: {commonest}.",
        f"{advice[0].upper()}{advice[1:]}.",
    )
