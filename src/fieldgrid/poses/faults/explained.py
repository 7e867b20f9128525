"""Which of two mistakes explains that a gyro denies what was declared: the antenna's place ahead of
the axle, or the stamps of the fixes.

Both shift where the path turns against the gyro, and one step of the estimate takes the one for the
other: a clock that is a second off is an antenna a metre farther back, to within centimetres. So
either is put right, step by step, until nothing is left to add; what was wrong fits then, and the
other does not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.geometry import Rig, VehicleGeometry
from fieldgrid.poses.axle import names_axle, with_antenna_moved
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.denied import (
    CLEAR_SIGMAS,
    LEAST_DELAY_S,
    LEAST_LEVER_M,
    DriveContradiction,
)
from fieldgrid.poses.fused import Fusion
from fieldgrid.poses.settled import settled
from fieldgrid.poses.smoother.declared import (
    AHEAD,
    LATE,
    MOST_MISFIT,
    Constant,
    DeclaredCorrection,
)

MOST_LEFT = 2.5
"""What was wrong leaves no more sigmas once it is put right."""

CLEAR_NATS = 3.0
"""The other of the two is ruled out where it is less likely by this."""

LEAST_MPS = 0.1
"""A slower vehicle tells no clock from a place."""


class Correction(NamedTuple):
    """One of the two put right: by how much, how many sigmas are left, and the drive then."""

    value: Constant
    left: float
    drive: DriveEstimate | None

    @classmethod
    def of(cls, value: Constant, drive: DriveEstimate) -> Correction:
        """What a drive leaves that was settled."""
        known = np.isfinite(value.sigma)
        return cls(value, drive.smoothed.declared.misfit(), drive) if known else UNTOLD

    @property
    def is_clear(self) -> bool:
        """Whether it is something."""
        return abs(self.value.value) > CLEAR_SIGMAS * self.value.sigma

    def rules_out(self, other: Correction) -> bool:
        """Whether the drive fits this, and is clearly less likely by the other."""
        return self.left < MOST_LEFT and self.nats > other.nats + CLEAR_NATS

    @property
    def nats(self) -> float:
        """How likely the drive is by this."""
        return -np.inf if self.drive is None else self.drive.smoothed.nats


UNTOLD = Correction(Constant(0.0, np.inf), np.inf, None)


class Explanation(NamedTuple):
    """The antenna's place ahead of the axle put right, and instead of it the stamps."""

    place: Correction
    delay: Correction

    @property
    def left(self) -> float:
        """How many sigmas are left by the one that explains more."""
        return min(self.place.left, self.delay.left)

    @property
    def is_place(self) -> bool:
        """Whether the place may be it."""
        return not self.delay.rules_out(self.place)

    @property
    def is_late(self) -> bool:
        """Whether the stamps may be it."""
        return not self.place.rules_out(self.delay)

    def denies(self, drive: DriveEstimate, vehicle: VehicleGeometry | None) -> DriveContradiction:
        """What that says of a vehicle and of stamps as they were declared, where one of them
        explains all; how far positions are off at the nodes of a drive."""
        moves = isinstance(vehicle, Rig)
        by_place_m = abs(self.place.value.value) if moves and self.is_place else 0.0
        by_stamps_s = self.delay.value.value if self.is_late else 0.0
        ahead_m = self.place.value if by_place_m > LEAST_LEVER_M else None
        late_s = self.delay.value if abs(by_stamps_s) > LEAST_DELAY_S else None
        if not moves and self.is_place:
            late_s = None  # it may as well be the place, which is not to be told here
        # How far the vehicle is at each node from where it is by the gyro's clock, by which its
        # fixes are late. Where it starts in between, that is farther than its speed tells.
        later_ns = drive.time_ns + round(by_stamps_s * 1e9)
        places = (drive.east_m, drive.north_m)
        apart_m = np.hypot(*(np.interp(later_ns, drive.time_ns, one) - one for one in places))
        off_m = np.maximum(by_place_m, np.maximum(apart_m, np.abs(by_stamps_s * drive.speed_mps)))
        either = ahead_m is not None and late_s is not None
        return DriveContradiction(
            *(None, ahead_m, late_s, off_m, either), may_be_late_s=by_stamps_s
        )


def explained(
    denied: DriveContradiction, found: Fusion, drive: DriveEstimate, vehicle: VehicleGeometry | None
) -> DriveContradiction:
    """What a gyro denies of a drive without a camera, by the mistake that explains it, or by
    either. Where neither does, nothing is clearly denied, and positions stay as unsure. Positions
    of a log alone are the antenna's, wherever on the `vehicle` that sits."""
    declared = drive.smoothed.declared
    by_gyro = drive.measured.sees_turns() and not found.has_camera()
    if not by_gyro or drive.headings_recorded or declared.misfit() < MOST_MISFIT:
        return denied
    tried = explanation(found._replace(drive=drive), vehicle)
    if tried is None:
        return denied
    if tried.left > MOST_LEFT:
        # Nothing ahead or late is denied, since neither explains the drive.
        return denied._replace(ahead_m=None, late_s=None, either=False)
    return tried.denies(drive, vehicle)


def explanation(
    found: Fusion,
    vehicle: VehicleGeometry | None,
    ahead_m: float | None = 0.0,
    late_s: float | None = 0.0,
) -> Explanation | None:
    """What is left of a contradiction by a gyro once either is put right, the place beginning
    `ahead_m`, the stamps `late_s`; what begins with None is not tried. None of a vehicle that
    hardly moves."""
    drive = found.drive
    speed_mps = np.abs(drive.speed_mps)
    usual_mps = float(np.median(speed_mps[drive.gear != 0])) if drive.gear.any() else 0.0
    if usual_mps < LEAST_MPS:
        return None
    delay = UNTOLD if late_s is None else _delay(found, usual_mps, late_s)
    # Where nobody says how far ahead of the axle the antenna sits, its place is free already.
    free = not names_axle(vehicle)
    place = UNTOLD if ahead_m is None or free else _place(found, ahead_m)
    return Explanation(place, delay)


def _place(found: Fusion, start_m: float) -> Correction:
    """How much farther ahead the antenna sits, if that explains all."""

    def moved(ahead_m: float) -> DriveEstimate:
        return found.again(axle=with_antenna_moved(found.axle, ahead_m), as_stated=True).drive

    first = moved(start_m) if start_m else found.drive
    return Correction.of(*settled(first, moved, lambda one: one.off(AHEAD, LATE), start_m))


def _delay(found: Fusion, usual_mps: float, start_s: float) -> Correction:
    """How late the fixes are stamped, if that explains all."""
    log = found.log

    def stamped(late_s: float) -> DriveEstimate:
        late_ns = round(late_s * 1e9)
        earlier = log._replace(
            fixes=log.fixes.replace(time_ns=log.fixes.time_ns - late_ns),
            accepted=log.accepted._replace(time_ns=log.accepted.time_ns - late_ns),
        )
        return found.again(log=earlier, as_stated=True).drive

    def left_s(one: DeclaredCorrection) -> Constant:
        # The step takes most of a delay for a place.
        late_s, ahead_m = one.off(LATE, AHEAD), one.off(AHEAD, LATE)
        return Constant(late_s.value - ahead_m.value / usual_mps, late_s.sigma)

    first = stamped(start_s) if start_s else found.drive
    return Correction.of(*settled(first, stamped, left_s, start_s))
