"""Which of two mistakes explains that a gyro denies what was declared: the antenna's place ahead of
the axle, or the stamps of the fixes.

Both shift where the path turns against the gyro, and one step of the estimate takes the one for the
other: a clock that is a second off is an antenna a metre farther back, to within centimetres. So
either is put right, step by step, until nothing is left to add; what was wrong fits then, and the
other does not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fieldgrid.pose.axle import names_axle, with_antenna_moved
from fieldgrid.pose.denied import (
    LEAST_DELAY_S,
    LEAST_LEVER_M,
    Denied,
    moving_places,
    off_if_alone_m,
)
from fieldgrid.pose.drive import DriveEstimate
from fieldgrid.pose.fused import Fused
from fieldgrid.rig import Rig, VehicleGeometry
from fieldgrid.smoother import Constant, DeclaredCorrection

MOST_STEPS = 8
"""Clocks that are up to 3 s off are settled in three to six."""

SETTLED_M, SETTLED_S = 0.005, 0.005
FARTHEST_M, LATEST_S = 10.0, 10.0

MOST_LEFT, RULED_OUT = 2.5, 4.0
"""What was wrong leaves no more sigmas than the first once it is put right; the other of the two is
ruled out where it leaves more than the second. It left 2.4 to 20."""

LEAST_MPS = 0.1
"""A slower vehicle tells no clock from a place."""


class PutRight(NamedTuple):
    """One of the two put right: by how much, and how many sigmas are left."""

    value: Constant
    left: float


def explained(
    denied: Denied, found: Fused, drive: DriveEstimate, vehicle: VehicleGeometry | None
) -> Denied:
    """What a gyro denies of a drive without a camera, by the mistake that explains it, or by
    either. Where neither does, nothing is clearly denied, and positions stay as unsure. Positions
    of a log alone are the antenna's, wherever on the `vehicle` that sits."""
    declared = drive.smoothed.declared
    camera = found.motion.steps is not None and len(found.motion.steps.start_ns) > 0
    if camera or drive.headings_recorded or not drive.at.has_gyro():
        return denied
    if not declared.contradicts or declared.blames_gyro:
        return denied
    speed_mps = np.abs(drive.speed_mps)
    usual_mps = float(np.median(speed_mps[drive.gear != 0])) if drive.gear.any() else 0.0
    if usual_mps < LEAST_MPS:
        return denied
    delay = _delay(found, declared, usual_mps)
    if not names_axle(vehicle):
        # Nobody knows how far ahead of it the antenna sits, and a delay looks like that.
        late_s = delay.value if delay.left < MOST_LEFT else None
        off_m = off_if_alone_m(declared, vehicle, speed_mps, moving_places(drive, vehicle))
        if late_s is not None:
            off_m = np.maximum(off_m, abs(late_s.value) * speed_mps)
        return Denied(denied.right_m, None, late_s, off_m)
    place = _place(found, declared)
    if min(place.left, delay.left) > MOST_LEFT:
        return denied._replace(ahead_m=None, late_s=None)
    ahead_m = place.value if place.left < RULED_OUT else None
    late_s = delay.value if delay.left < RULED_OUT else None
    if ahead_m is not None and not isinstance(vehicle, Rig):
        return denied._replace(ahead_m=None)
    by_place_m = 0.0 if ahead_m is None else abs(ahead_m.value)
    by_stamps_m = 0.0 if late_s is None else abs(late_s.value) * speed_mps
    return Denied(
        None,
        ahead_m if by_place_m > LEAST_LEVER_M else None,
        late_s if late_s is not None and abs(late_s.value) > LEAST_DELAY_S else None,
        np.maximum(by_place_m, by_stamps_m) + np.zeros(len(speed_mps)),
        either=ahead_m is not None and late_s is not None,
    )


def _place(found: Fused, declared: DeclaredCorrection) -> PutRight:
    """How much farther ahead the antenna sits, if that explains all."""

    def moved(ahead_m: float) -> DeclaredCorrection:
        axle = with_antenna_moved(found.axle, ahead_m)
        return found.again(axle=axle).drive.smoothed.declared

    return _settled(declared, moved, lambda one: one.ahead_m, (SETTLED_M, FARTHEST_M))


def _delay(found: Fused, declared: DeclaredCorrection, usual_mps: float) -> PutRight:
    """How late the fixes are stamped, if that explains all."""
    log = found.log

    def stamped(late_s: float) -> DeclaredCorrection:
        late_ns = round(late_s * 1e9)
        earlier = log._replace(
            fixes=log.fixes.replace(time_ns=log.fixes.time_ns - late_ns),
            accepted=log.accepted._replace(time_ns=log.accepted.time_ns - late_ns),
        )
        return found.again(log=earlier).drive.smoothed.declared

    def left_s(one: DeclaredCorrection) -> Constant:
        # The step takes most of a delay for a place.
        return Constant(one.late_s.value - one.ahead_m.value / usual_mps, one.late_s.sigma)

    return _settled(declared, stamped, left_s, (SETTLED_S, LATEST_S))


def _settled(
    declared: DeclaredCorrection,
    put_right: Callable[[float], DeclaredCorrection],
    left: Callable[[DeclaredCorrection], Constant],
    limits: tuple[float, float],
) -> PutRight:
    """Put one of them right until there is nothing `left` to add; infinitely many sigmas are left
    where that leads nowhere."""
    least, most = limits
    total = 0.0
    for _ in range(MOST_STEPS):
        total += left(declared).value
        if abs(total) > most:
            return PutRight(Constant(total, np.inf), np.inf)
        declared = put_right(total)
        if abs(left(declared).value) < least:
            break
    return PutRight(Constant(total, left(declared).sigma), declared.misfit)
