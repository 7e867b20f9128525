"""A gyro that was left out because it does not turn as the path does, and is right once the antenna
or the stamps are put right.

An antenna far ahead of the axle or behind it swings out in each turn, so that its path turns by
half as much as the vehicle, or the other way; late stamps shift turns to where there are none. A
gyro whose axes or unit are wrong fits nothing that is put right.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int64
from fieldgrid.pose.denied import CLEAR_SIGMAS, Denied, sees_turns
from fieldgrid.pose.drive import DriveEstimate
from fieldgrid.pose.explained import MOST_LEFT, UNTOLD, Explanation, PutRight, explanation
from fieldgrid.pose.fused import Fused
from fieldgrid.pose.gyro_check import apart_deg
from fieldgrid.rig import VehicleGeometry

STARTS = (0.0, 1.5, -1.5)
"""Metres and seconds. What is twice as far off may bend the first estimate out of all reach."""

MOST_NODES = 30_000
"""Two hours at most: beginning elsewhere, too, would take minutes of a longer drive."""

FAR_OFF, MORE_FAR_OFF = 5.0, 0.01
"""A fix that lies beside the drive by so many times its noise does not fit it. With a gyro that is
right no larger share of them does than without it, and with one that is wrong 0.03 to 0.9 more: it
fits a drive that leaves the fixes."""

LEFT_SHARE = 0.25
"""At most so much is left of what the gyro contradicted."""


class Excused(NamedTuple):
    """What such a gyro denies of antenna and stamps, and how far headings by it, with these put
    right, are from those without it at the nodes of the drive [n]."""

    denied: Denied
    time_ns: Int64
    unsure_deg: Float64

    def unsure_at(self, time_ns: Int64) -> Float64:
        """The same at other instants."""
        return np.asarray(np.interp(time_ns, self.time_ns, self.unsure_deg))


def excused(found: Fused, vehicle: VehicleGeometry | None) -> Excused | None:
    """What excuses the gyro that the drive was estimated without; None where nothing does. A
    camera shows by itself what was declared wrongly."""
    drive, gyro = found.drive, found.gyro
    if gyro is None or drive.at.has_gyro() or found.has_camera():
        return None
    beside = found.again(motion=found.motion._replace(gyro=gyro))
    if not sees_turns(beside.drive):
        return None
    most = max(MOST_LEFT, LEFT_SHARE * beside.drive.smoothed.declared.misfit)
    tried = next((one for one in _tried(beside, found, vehicle) if one.left <= most), None)
    if tried is None:
        return None
    either = ((tried.is_place, tried.place), (tried.is_late, tried.delay))
    fitting = [one.drive for may_be, one in either if may_be and one.drive is not None]
    unsure_deg = np.max([apart_deg(drive, one) for one in fitting], axis=0)
    denied = tried.denies(drive, vehicle)._replace(gyro_unused=True)
    return Excused(denied, drive.time_ns, unsure_deg)


def _tried(beside: Fused, without: Fused, vehicle: VehicleGeometry | None) -> Iterator[Explanation]:
    """What is left with the gyro by what its fixes fit as well as those of the drive without."""
    noise_m = without.log.accepted.noise.across_m
    most = _far_off(without.drive, noise_m) + MORE_FAR_OFF

    def fits(one: PutRight) -> bool:
        is_clear = abs(one.value.value) > CLEAR_SIGMAS * one.value.sigma
        return one.drive is not None and is_clear and _far_off(one.drive, noise_m) <= most

    few = len(beside.drive.time_ns) <= MOST_NODES
    for start in STARTS if few else STARTS[:1]:
        tried = explanation(beside, vehicle, start)
        if tried is not None:
            yield Explanation(*(one if fits(one) else UNTOLD for one in tried))


def _far_off(drive: DriveEstimate, noise_m: Float64) -> float:
    """The share of the fixes that do not fit a drive."""
    off_m = np.abs(drive.smoothed.fix_off_m[drive.fix >= 0])
    return float(np.mean((off_m > FAR_OFF * noise_m[:, None]).any(axis=1)))
