"""A gyro that was left out because it does not turn as the path does, and is right once the antenna
or the stamps are put right.

An antenna far ahead of the axle or behind it swings out in each turn, so that its path turns by
half as much as the vehicle, or the other way; late stamps shift turns to where there are none. A
gyro whose axes or unit are wrong fits nothing that is put right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int64
from fieldgrid.pose.denied import Denied, sees_turns
from fieldgrid.pose.explained import explanation
from fieldgrid.pose.fused import Fused
from fieldgrid.pose.gyro_check import apart_deg
from fieldgrid.rig import VehicleGeometry


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
    tried = explanation(beside, vehicle)
    if tried is None or not tried.fits:
        return None
    either = ((tried.is_place, tried.place), (tried.is_late, tried.delay))
    fitting = [one.drive for may_be, one in either if may_be and one.drive is not None]
    unsure_deg = np.max([apart_deg(drive, one) for one in fitting], axis=0)
    denied = tried.denies(drive, vehicle)._replace(gyro_unused=True)
    return Excused(denied, drive.time_ns, unsure_deg)
