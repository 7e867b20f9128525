"""What was declared of antenna and stamps, and a drive denies.

Nobody knows whether the declaration is wrong or what speaks against it, so nothing is corrected: it
is told, and positions are as unsure as the two are apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Rig, VehicleGeometry
from fieldgrid.poses.axle import names_axle
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.clock.offset import ClockFindings
from fieldgrid.poses.smoother.declared import AHEAD, LATE, Constant, DeclaredCorrection
from fieldgrid.poses.table import PoseTable

CLEAR_SIGMAS = 4.0
"""A drive denies what was declared beyond this number of sigmas."""

FAR_M = 1.0
"""A drive that denies a fault only beyond this error does not see it."""

LEAST_LEVER_M, LEAST_DELAY_S = 0.3, 0.05
"""Smaller contradictions of the antenna's place and of the fixes' stamps are not worth a word."""

LEAST_SEEN_SHARE = 0.5
"""A camera or a gyro that saw less of a drive denies nothing: of five frames, and of a log that
ended early, the antenna was 3 m aside by six sigmas."""

MOST_ROUNDS = 10
"""A wrong place is settled in two to six."""

LEAST_DOUBT_DEG, LEAST_OFF_M = 1.0, 0.1
"""What does not fit together and moves no heading or position by more is not worth a word."""


class DriveContradiction(NamedTuple):
    """What the drive would add to the place of the antenna (to the right and ahead, metres) and to
    how late the fixes are stamped (seconds); None of what it does not clearly deny.

    `off_m` [n] is how far the positions of its nodes are off if that is so, or if images are
    stamped as the camera's motion has it. Where sensors and declarations do not fit together and
    none of them is clearly wrong, it is the most that one of those would make that explain it
    alone. With `either`, the place ahead and the stamps each explain all, and only one is wrong.
    With `gyro_unused` a gyro denies it that was not used.
    """

    right_m: Constant | None
    ahead_m: Constant | None
    late_s: Constant | None
    off_m: Float64
    either: bool = False
    gyro_unused: bool = False

    @property
    def clear(self) -> bool:
        """Whether one of them is denied."""
        return any(one is not None for one in (self.right_m, self.ahead_m, self.late_s))


def denied_by(
    drive: DriveEstimate, vehicle: VehicleGeometry | None, clocks: ClockFindings
) -> DriveContradiction:
    """What a drive denies of its vehicle as it was declared, and of the clock of its images."""
    speed_mps = np.abs(drive.speed_mps)
    by_clock_m = speed_mps * np.abs(clocks.offset_s(drive.time_ns))
    if not sees_turns(drive) and not (names_axle(vehicle) and drive.headings_recorded):
        return DriveContradiction(None, None, None, by_clock_m)
    found = drive.smoothed.declared
    places = moving_places(drive, vehicle)
    right_m = _clear(found.right_m, LEAST_LEVER_M) if places[0] else None
    ahead_m = _clear(found.ahead_m, LEAST_LEVER_M) if places[1] else None
    # Recorded headings have the stamps of the fixes. With an axle that nobody names, a delay and
    # the antenna's place ahead of it cancel each other.
    tells_delay = sees_turns(drive) and (names_axle(vehicle) or found.explains(LATE))
    late_s = _clear(found.late_s, LEAST_DELAY_S) if tells_delay else None
    off_m = np.hypot(math.hypot(_value(right_m), _value(ahead_m)), _value(late_s) * speed_mps)
    denied = DriveContradiction(right_m, ahead_m, late_s, off_m)
    if not denied.clear:
        off_m = off_if_alone_m(found, vehicle, speed_mps, places)
    return denied._replace(off_m=np.maximum(off_m, by_clock_m))


def off_if_alone_m(
    found: DeclaredCorrection,
    vehicle: VehicleGeometry | None,
    speed_mps: Float64,
    places: tuple[bool, bool],
) -> Float64:
    """How far positions [n] are off at most by one mistake that explains alone what does not fit
    together; of the antenna's `places` aside and ahead only those that move positions."""
    off_m = np.zeros(len(speed_mps))
    # An axle that nobody names explains what an antenna ahead of it explains.
    if not found.contradicts or (not names_axle(vehicle) and found.explains(AHEAD)):
        return off_m
    per_unit = places[0] * np.ones_like(speed_mps), places[1] * np.ones_like(speed_mps)
    for k, moved in enumerate((*per_unit, speed_mps)):
        if found.explains(k):
            off_m = np.maximum(off_m, np.abs(found.alone[k]) * moved)
    return off_m


def moving_places(drive: DriveEstimate, vehicle: VehicleGeometry | None) -> tuple[bool, bool]:
    """Whether the antenna's place aside and ahead moves positions, and the drive can deny it."""
    # Of a log alone positions are those of the antenna; and where nobody says where the axle is,
    # its place is no contradiction, and moves no position.
    placed = isinstance(vehicle, Rig)
    # An antenna aside is the faster one in a turn, which only those see who see the speed.
    return placed and sees_speed(drive), placed and names_axle(vehicle)


def with_whole_place(
    denied: DriveContradiction, placed: Callable[[float], DriveEstimate]
) -> DriveContradiction:
    """The contradiction with the whole distance by which recorded headings have the antenna ahead.

    The headings that a wrong place contradicts most have little weight, so that the drive shows a
    part of it at once. `placed` estimates the drive with the antenna moved ahead, in metres.
    """
    if denied.ahead_m is None:
        return denied
    total_m, sigma_m = denied.ahead_m
    for _ in range(MOST_ROUNDS):
        value_m, sigma_m = placed(total_m).smoothed.declared.ahead_m
        total_m += value_m
        if abs(value_m) < sigma_m:
            break
    ahead_m = Constant(total_m, float(np.hypot(sigma_m, value_m)))
    return denied._replace(ahead_m=ahead_m, off_m=np.maximum(denied.off_m, abs(total_m)))


def sees_turns(drive: DriveEstimate) -> bool:
    """Whether a gyro or a camera saw how the vehicle turned, over most of the drive."""
    step_s, turned = np.diff(drive.measured.time_s), np.isfinite(drive.measured.turned_rad)
    by_gyro = float(step_s[turned].sum()) / max(float(step_s.sum()), 1e-9)
    return max(by_gyro, _camera_share(drive)) >= LEAST_SEEN_SHARE


def sees_speed(drive: DriveEstimate) -> bool:
    """Whether wheels or a camera measured its speed, over most of the drive."""
    by_wheels = float(np.mean(np.isfinite(drive.measured.speed_mps)))
    return max(by_wheels, _camera_share(drive)) >= LEAST_SEEN_SHARE


def sees_way(drive: DriveEstimate) -> bool:
    """Whether a camera measured its way, over most of the drive."""
    return _camera_share(drive) >= LEAST_SEEN_SHARE


def _camera_share(drive: DriveEstimate) -> float:
    """The share of the drive's time that the camera's steps cover."""
    time_s, nodes = drive.measured.time_s, drive.measured.step_nodes
    lasted_s = float(time_s[-1] - time_s[0])
    return float(np.diff(time_s[nodes], axis=1).sum()) / max(lasted_s, 1e-9)


def _clear(one: Constant, least: float) -> Constant | None:
    return one if abs(one.value) > max(CLEAR_SIGMAS * one.sigma, least) else None


def _value(one: Constant | None) -> float:
    return 0.0 if one is None else one.value


def unsure_declared(
    table: PoseTable, drive: DriveEstimate, denied: DriveContradiction
) -> PoseTable:
    """The poses with positions as unsure as the contradicted declarations move them. Neighbours
    share this error."""
    node = np.clip(np.searchsorted(drive.time_ns, table.time_ns), 0, len(denied.off_m) - 1)
    sigma_m = np.hypot(table.position_sigma_m, denied.off_m[node] / np.sqrt(2.0))
    return table._replace(position_sigma_m=sigma_m)


def denied_notes(drive: DriveEstimate, denied: DriveContradiction) -> Iterator[str]:
    """A sentence on each thing that is denied, or one on what does not fit together."""
    yield from _denied_notes(drive, denied)
    if denied.gyro_unused and denied.clear:
        yield (
            "The gyro fits the drive only once that is corrected, so it was not used; headings "
            "count as unsure by what it would change."
        )


def _denied_notes(drive: DriveEstimate, denied: DriveContradiction) -> Iterator[str]:
    if denied.either and denied.ahead_m is not None and denied.late_s is not None:
        (ahead_m, _), (late_s, _) = denied.ahead_m, denied.late_s
        yield (
            f"By the drive the antenna sits {abs(ahead_m):.2f} m farther "
            f"{'ahead' if ahead_m > 0.0 else 'back'} than mounting.json says, or the fixes are "
            f"stamped {abs(late_s):.2f} s {'late' if late_s > 0.0 else 'early'} against the gyro: "
            f"each would explain it. Measure the place, or add {-late_s:.2f} to --gnss-offset if "
            "the stamps are wrong. Until then positions count as that unsure."
        )
        return
    for one, more, less in (
        (denied.ahead_m, "farther ahead", "farther back"),
        (denied.right_m, "farther right", "farther left"),
    ):
        if one is not None:
            way = more if one.value > 0.0 else less
            yield (
                f"By the drive the antenna sits {abs(one.value):.2f} m ± {one.sigma:.2f} m {way} "
                "than mounting.json says; measure its place and correct it. Until then positions "
                "count as that unsure."
            )
    if (delay := denied.late_s) is not None:
        late = "late" if delay.value > 0.0 else "early"
        by = ["gyro"] if denied.gyro_unused else _turn_sensors(drive)
        yield (
            f"By the drive the fixes are stamped {abs(delay.value):.2f} s ± {delay.sigma:.2f} s "
            f"{late} against {' and '.join(f'the {one}' for one in by)}; "
            f"look at how they were logged, or add {-delay.value:.2f} to --gnss-offset. Until then "
            "positions count as unsure by what is driven in that time."
        )
    if drive.smoothed.declared.contradicts and not denied.clear and sees_turns(drive):
        yield from _unfit_note(drive, denied)


def _turn_sensors(drive: DriveEstimate) -> list[str]:
    """What saw how the vehicle turned."""
    seen = (drive.at.has_gyro(), "gyro"), (len(drive.measured.step) > 0, "camera")
    return [name for has, name in seen if has]


def _unfit_note(drive: DriveEstimate, denied: DriveContradiction) -> Iterator[str]:
    """That something does not fit together, and what would explain it alone."""
    found = drive.smoothed.declared
    moving = drive.gear != 0
    most_deg = float(np.degrees(drive.smoothed.response.at_most[moving]).max(initial=0.0))
    most_m = float(denied.off_m[moving].max(initial=0.0))
    if most_deg <= LEAST_DOUBT_DEG and most_m <= LEAST_OFF_M:
        return
    right_m, ahead_m, late_s, _ = found.alone
    alone = (
        f"the antenna's place aside ({right_m:+.2f} m to the right would explain it)",
        f"its place ahead ({ahead_m:+.2f} m would, and so would an IMU that is tilted)",
        f"the stamps (fixes {abs(late_s):.2f} s {'late' if late_s > 0.0 else 'early'} would)",
        "the gyro's scale",
    )
    check = " or ".join(what for k, what in enumerate(alone) if found.explains(k))
    positions = f", and positions {most_m:.2f} m" if most_m > LEAST_OFF_M else ""
    *first, last = ("Fixes", "antenna", *_turn_sensors(drive))
    yield (
        f"{', '.join(first)} and {last} do not fit together by {found.misfit:.0f} sigmas, so "
        f"headings may be up to {most_deg:.1f}° off{positions}. Check "
        f"{check or 'the place of the antenna, the stamps and the scale of the gyro'}."
    )
