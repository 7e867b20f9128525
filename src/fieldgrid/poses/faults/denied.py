"""What was declared of antenna and stamps, and a drive denies.

Nobody knows whether the declaration is wrong or what speaks against it, so nothing is corrected: it
is told, and positions are as unsure as the two are apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, Int64, warning
from fieldgrid.geometry import Rig, VehicleGeometry
from fieldgrid.poses.axle import names_axle
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.clock.offset import ClockFindings
from fieldgrid.poses.settled import settled
from fieldgrid.poses.sigmas import AddedSigma
from fieldgrid.poses.smoother.declared import (
    AHEAD,
    ASIDE,
    DRIFT,
    LATE,
    LIKELY,
    Constant,
)
from fieldgrid.poses.smoother.model import PHI

FAR_M = 1.0
"""A drive that denies a fault only beyond this error does not see it."""

CLEAR_SIGMAS = 4.0
"""It sees an error of this number of sigmas."""

LEAST_LEVER_M, LEAST_DELAY_S = 0.3, 0.05
"""Smaller contradictions of the antenna's place and of the fixes' stamps are not worth a word."""

LEAST_DOUBT_DEG, LEAST_OFF_M = 1.0, 0.1
"""What does not fit together and moves no heading or position by more is not worth a word."""


class DriveContradiction(NamedTuple):
    """What the drive would add to the place of the antenna (to the right and ahead, metres) and to
    how late the fixes are stamped (seconds); None of what it does not clearly deny.

    `off_m` [n] is how far the positions of its nodes are off if that is so and one step does not
    show it, or if images are stamped as the camera's motion has it. With `either`, the place ahead
    and the stamps each explain all, and only one is wrong. With `gyro_unused` a gyro denies it that
    was not used. Stamps `may_be_late_s`, also where the place explains as much.
    """

    right_m: Constant | None
    ahead_m: Constant | None
    late_s: Constant | None
    off_m: Float64
    either: bool = False
    gyro_unused: bool = False
    may_be_late_s: float = 0.0

    @property
    def clear(self) -> bool:
        """Whether one of them is denied."""
        return any(one is not None for one in (self.right_m, self.ahead_m, self.late_s))


def denied_by(
    drive: DriveEstimate, vehicle: VehicleGeometry | None, clocks: ClockFindings
) -> DriveContradiction:
    """What a drive denies of its vehicle as it was declared, and of the clock of its images."""
    off_m = np.abs(drive.speed_mps) * np.abs(clocks.offset_s(drive.time_ns))
    found = drive.smoothed.declared
    aside, ahead = moving_places(drive, vehicle)
    # Recorded headings have the stamps of the fixes. With an axle that nobody names, a delay and
    # the antenna's place ahead of it cancel each other.
    late = drive.measured.sees_turns() and (names_axle(vehicle) or found.explains(LATE))
    tellable = {ASIDE: aside, AHEAD: ahead, LATE: late}
    wrong = {k for k, tells in tellable.items() if tells and found.probability(k) > LIKELY}
    either = not wrong and ahead and late and found.probability(AHEAD, LATE) > LIKELY
    named = {AHEAD, LATE} if either else wrong

    def told(k: int, least: float) -> Constant | None:
        beside = () if either else named - {k}
        one = found.off(k, *beside)
        return one if k in named and abs(one.value) > least else None

    return DriveContradiction(
        told(ASIDE, LEAST_LEVER_M),
        told(AHEAD, LEAST_LEVER_M),
        told(LATE, LEAST_DELAY_S),
        off_m,
        either,
    )


def moving_places(drive: DriveEstimate, vehicle: VehicleGeometry | None) -> tuple[bool, bool]:
    """Whether the antenna's place aside and ahead moves positions, and the drive can deny it."""
    # Of a log alone positions are those of the antenna; and where nobody says where the axle is,
    # its place is no contradiction, and moves no position.
    placed = isinstance(vehicle, Rig)
    # An antenna aside is the faster one in a turn, which only those see who see the speed.
    return placed and drive.measured.sees_speed(), placed and names_axle(vehicle)


def with_whole_place(
    denied: DriveContradiction, drive: DriveEstimate, placed: Callable[[float], DriveEstimate]
) -> DriveContradiction:
    """The contradiction with the whole distance by which recorded headings have the antenna ahead.

    The headings that a wrong place contradicts most have little weight, so that the drive shows a
    part of it at once. `placed` estimates the drive with the antenna moved ahead, in metres.
    """
    if denied.ahead_m is None:
        return denied
    ahead_m, _ = settled(drive, placed, lambda one: one.off(AHEAD))
    return denied._replace(ahead_m=ahead_m, off_m=np.maximum(denied.off_m, abs(ahead_m.value)))


def declared_doubt(
    time_ns: Int64,
    drive: DriveEstimate,
    vehicle: VehicleGeometry | None,
    denied: DriveContradiction,
) -> AddedSigma:
    """How unsure what was declared of the vehicle leaves poses. Neighbours share this error of
    their positions. Of a log alone poses are those of the antenna, in its own clock."""
    unsure = drive.smoothed.unsure
    unsure_m = unsure.axle_m if isinstance(vehicle, Rig) else unsure.antenna_m
    unsure_m = np.maximum(unsure_m, denied.off_m / np.sqrt(2.0))
    phi, time_s = drive.smoothed.state[:, PHI], drive.measured.time_s
    turned_deg = np.degrees(np.interp(time_s + denied.may_be_late_s, time_s, phi) - phi)
    node = np.clip(np.searchsorted(drive.time_ns, time_ns), 0, len(unsure_m) - 1)
    return AddedSigma(position_m=unsure_m[node], heading_deg=turned_deg[node])


def denied_findings(drive: DriveEstimate, denied: DriveContradiction) -> Iterator[Finding]:
    """A finding on each thing that is denied, or one on what does not fit together."""
    until = "Until then positions count as that unsure."
    if denied.either and denied.ahead_m is not None and denied.late_s is not None:
        (ahead_m, _), (late_s, _) = denied.ahead_m, denied.late_s
        yield warning(
            "antenna-or-stamps",
            f"By the drive the antenna sits {abs(ahead_m):.2f} m farther "
            f"{'ahead' if ahead_m > 0.0 else 'back'} than mounting.json says, or the fixes are "
            f"stamped {abs(late_s):.2f} s {'late' if late_s > 0.0 else 'early'} against the gyro: "
            "each would explain it.",
            f"Measure the place, or add {-late_s:.2f} to --gnss-offset if the stamps are wrong. "
            f"{until}",
        )
    else:
        for one, more, less in (
            (denied.ahead_m, "farther ahead", "farther back"),
            (denied.right_m, "farther right", "farther left"),
        ):
            if one is not None:
                way = more if one.value > 0.0 else less
                yield warning(
                    "antenna-place",
                    f"By the drive the antenna sits {abs(one.value):.2f} m ± {one.sigma:.2f} m "
                    f"{way} than mounting.json says.",
                    f"Measure its place and correct it. {until}",
                    Figure(one.value, "m"),
                )
        if (delay := denied.late_s) is not None:
            late = "late" if delay.value > 0.0 else "early"
            by = ["gyro"] if denied.gyro_unused else _turn_sensors(drive)
            yield warning(
                "fixes-stamped",
                f"By the drive the fixes are stamped {abs(delay.value):.2f} s ± {delay.sigma:.2f} "
                f"s {late} against {' and '.join(f'the {one}' for one in by)}.",
                f"Look at how they were logged, or add {-delay.value:.2f} to --gnss-offset. Until "
                "then positions count as unsure by what is driven in that time.",
                Figure(delay.value, "s"),
            )
        if drive.smoothed.declared.contradicts and not denied.clear and drive.measured.sees_turns():
            yield from _unfit(drive, denied)
    if denied.gyro_unused and denied.clear:
        yield warning(
            "gyro-unused",
            "The gyro fits the drive only once that is corrected, so it was not used; headings "
            "count as unsure by what it would change.",
        )


def _turn_sensors(drive: DriveEstimate) -> list[str]:
    """What saw how the vehicle turned."""
    seen = (drive.at.has_gyro(), "gyro"), (len(drive.measured.step) > 0, "camera")
    return [name for has, name in seen if has]


def _unfit(drive: DriveEstimate, denied: DriveContradiction) -> Iterator[Finding]:
    """That something does not fit together, and what would explain it alone."""
    found, unsure = drive.smoothed.declared, drive.smoothed.unsure
    moving = drive.gear != 0
    most_deg = float(np.degrees(unsure.heading_rad[moving]).max(initial=0.0))
    most_m = float(unsure.axle_m[moving].max(initial=0.0))
    # A drift has a finding of its own.
    if found.explains(DRIFT) or (most_deg <= LEAST_DOUBT_DEG and most_m <= LEAST_OFF_M):
        return
    late_s = denied.may_be_late_s or found.off(LATE).value
    alone = {
        ASIDE: f"the antenna's place aside ({found.off(ASIDE).value:+.2f} m to the right would "
        "explain it)",
        AHEAD: f"its place ahead ({found.off(AHEAD).value:+.2f} m would, and so would an IMU that "
        "is tilted)",
        LATE: f"the stamps (fixes {abs(late_s):.2f} s {'late' if late_s > 0.0 else 'early'} would)",
    }
    explains = [k for k in alone if found.explains(k) or (k == LATE and denied.may_be_late_s)]
    check = " or ".join(alone[k] for k in explains)
    positions = f", and positions {most_m:.2f} m" if most_m > LEAST_OFF_M else ""
    misfit = found.misfit()
    *first, last = ("Fixes", "antenna", *_turn_sensors(drive))
    yield warning(
        "contradiction",
        f"{', '.join(first)} and {last} do not fit together by {misfit:.0f} sigmas, so "
        f"headings may be up to {most_deg:.1f}° off{positions}.",
        f"Check {check or 'the place of the antenna and the stamps'}.",
        Figure(misfit, "sigmas"),
    )
