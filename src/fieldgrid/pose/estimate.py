"""From fixes to the trajectory of the grid origin: plane, heading, lever arm, verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Float64, Int64
from fieldgrid.errors import GnssError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import ConditioningSummary, condition, summarise
from fieldgrid.motion import Motion
from fieldgrid.pose.clock import ClockOffset, clock_offset
from fieldgrid.pose.convention import Comparison, compare
from fieldgrid.pose.placed import Placed, datum_of, no_fix_sentence, place
from fieldgrid.pose.rows import Rows, rows_of
from fieldgrid.pose.settings import HeadingSource, heading_source
from fieldgrid.pose.smooth import Drive, axle_forward_m, smooth_drive
from fieldgrid.pose.verdict import Budget, doubt
from fieldgrid.rig import LeverArm, Vehicle, nose_heading_deg
from fieldgrid.settings import PoseSettings
from fieldgrid.trajectory import Status, Trajectory


@dataclass(frozen=True, slots=True)
class PoseReport:
    """What was found out about a drive besides its poses.

    `recorded` is a recorded heading beside the estimate; `clock` the time offset between
    images and fixes, as seen from the camera's motion; `gyro_bias_dps` NaN without a gyro.
    """

    conditioning: ConditioningSummary
    recorded: Comparison | None
    clock: ClockOffset | None
    gyro_bias_dps: float
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is unknown is null."""
        bias = self.gyro_bias_dps
        return {
            "conditioning": self.conditioning.as_dict(),
            "recorded_heading": None if self.recorded is None else self.recorded._asdict(),
            "clock_offset": None if self.clock is None else self.clock._asdict(),
            "gyro_bias_dps": None if np.isnan(bias) else bias,
            "notes": list(self.notes),
        }


NO_RIG = (
    "Nothing says where the antenna sits; it is taken to be above the axle that does not steer. "
    "Ahead of it, headings are off in turns: a metre by 11° at a radius of 5 m (--antenna-ahead)."
)


class Estimate(NamedTuple):
    """A trajectory, the row of each input fix in it (in order of time), and the report."""

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
) -> Estimate:
    """The trajectory of the grid origin (without a rig: of the antenna) over one drive.

    Fixes are conditioned, carried into the LTP of `datum` (the first accepted fix without
    one), given a heading, moved from the antenna to the grid origin, and judged. Raises
    GnssError when no fix can be used, or when a recorded heading contradicts the drive.
    """
    settings, motion = settings or PoseSettings(), motion or Motion()
    source = heading_source(settings.heading)
    fixes = fixes.in_order()
    verdicts = condition(fixes, settings.gnss)
    if not verdicts.ok.any():
        raise GnssError(no_fix_sentence(fixes, verdicts))
    datum = datum or datum_of(fixes, verdicts)
    placed = place(fixes, verdicts, datum)
    drive = smooth_drive(placed, motion, rig)
    nose_deg, comparison, notes = _nose(placed, drive, rig, source, settings)
    if source.kind == "smooth" and np.isfinite(nose_deg).any():
        drive = smooth_drive(placed, motion, rig, nose_deg)
    rows, fix_row = rows_of(source, placed, drive, nose_deg, rig, settings)
    trajectory = _judged(rows, datum, rig, settings, budget, source)
    clock = clock_offset(placed, motion, rig)
    notes += [*_constant_note(source, drive, settings), *_clock_note(clock)]
    notes += [] if rig is not None else [NO_RIG]
    report = PoseReport(
        summarise(fixes, verdicts), comparison, clock, drive.gyro_bias_dps, tuple(notes)
    )
    return Estimate(trajectory, fix_row, report)


def _nose(
    placed: Placed, drive: Drive, rig: Vehicle | None, source: HeadingSource, settings: PoseSettings
) -> tuple[Float64, Comparison | None, list[str]]:
    """Recorded headings as those of the nose, NaN where none can be used; raises when they
    contradict the drive."""
    recorded = placed.recorded_deg
    if rig is not None:
        recorded = nose_heading_deg(rig, recorded)
    if not np.isfinite(recorded[placed.ok]).any():
        if source.kind == "recorded":
            raise GnssError(
                "No fix of this recording has a heading of its own; use --heading smooth."
            )
        return recorded, None, []
    at = drive.fix >= 0
    # Nodes stand in the order of the accepted fixes.
    found = compare(
        recorded[placed.ok], drive.heading_deg[at], drive.heading_sigma_deg[at], drive.gear[at]
    )
    if found is None:
        note = "The drive is too short to compare the recorded heading with its course."
        return recorded, None, [note]
    if found.course:
        note = (
            "The recorded heading turns around in reverse: it is the course, not the nose's "
            "direction, and was not used."
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
    note = (
        f"The recorded heading is {found.offset_deg:+.2f}° ± {found.offset_sigma_deg:.2f}° off "
        "the course of the drive; taken out."
    )
    return np.asarray(wrap_deg(recorded - found.offset_deg)), found, [note]


def _constant_note(source: HeadingSource, drive: Drive, settings: PoseSettings) -> list[str]:
    """A heading given by hand beside that of the drive."""
    if source.kind != "constant":
        return []
    moving = (drive.gear != 0) & (drive.heading_sigma_deg < settings.max_heading_sigma_deg)
    if not moving.any():
        return []
    off = np.abs(wrap_deg(drive.heading_deg[moving] - source.constant_deg))
    share = float(np.mean(off > 10.0))
    if share < 0.1:
        return []
    return [
        f"The constant heading {source.constant_deg:g}° is more than 10° off the drive's own in "
        f"{100.0 * share:.0f} % of it (median {np.median(off):.0f}°)."
    ]


def _clock_note(clock: ClockOffset | None) -> list[str]:
    if clock is None or not clock.is_certain:
        return []
    return [
        f"The images seem stamped {-clock.offset_s:+.3f} s ± {clock.sigma_s:.3f} s against the "
        f"fixes; if so, add {clock.offset_s:.3f} to image_time_offset_s in recording.toml, or to "
        "--time-offset."
    ]


def _judged(
    rows: Rows,
    datum: Datum,
    rig: Vehicle | None,
    settings: PoseSettings,
    budget: Budget | None,
    source: HeadingSource,
) -> Trajectory:
    """Rows carried to the grid origin, each with its verdict."""
    status, reason = _verdicts(rows, settings, budget)
    east_m, north_m, up_m = rows.east_m, rows.north_m, rows.up_m
    if rig is not None:
        point = rig.antenna
        if source.kind == "smooth":
            point = LeverArm(0.0, axle_forward_m(rig), 0.0)
        east_m, north_m = carry_lever(east_m, north_m, rows.heading_deg, point)
        up_m = up_m - rig.antenna.up_m
    return Trajectory(
        datum=datum,
        time_ns=rows.time_ns,
        east_m=east_m,
        north_m=north_m,
        up_m=up_m,
        heading_deg=rows.heading_deg,
        position_sigma_m=rows.position_sigma_m,
        heading_sigma_deg=rows.heading_sigma_deg,
        speed_mps=rows.speed_mps,
        gear=rows.gear,
        quality=rows.quality,
        status=status,
        reason=reason,
        heading_source=str(source),
    )


def _verdicts(
    rows: Rows, settings: PoseSettings, budget: Budget | None
) -> tuple[tuple[Status, ...], tuple[str, ...]]:
    status, reason = [], []
    sure = zip(
        rows.heading_sigma_deg.tolist(),
        rows.position_sigma_m.tolist(),
        rows.relative_sigma_m.tolist(),
        rows.gear_doubt.tolist(),
        strict=True,
    )
    told = zip(rows.rejection, rows.remark, rows.resting.tolist(), strict=True)
    for sigmas, (rejection, remark, resting) in zip(sure, told, strict=True):
        against = rejection or doubt(*sigmas, settings, budget)
        good = Status.HELD if resting else Status.OK
        status.append(Status.REJECTED if against else good)
        reason.append(against or remark)
    return tuple(status), tuple(reason)


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
