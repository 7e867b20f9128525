"""One position from a receiver, as it was recorded, and how sure it is."""

from __future__ import annotations

import math
from typing import NamedTuple

QUALITY_NAMES = {
    0: "none",
    1: "GPS",
    2: "differential",
    3: "PPS",
    4: "RTK fixed",
    5: "RTK float",
    6: "estimated",
    7: "manual",
    8: "simulated",
    9: "SBAS",
}
"""The quality codes of the NMEA sentence GGA (9 is NovAtel's)."""

_USUAL_SIGMA_M = {1: 1.5, 2: 0.5, 3: 0.5, 4: 0.02, 5: 0.25, 9: 0.5}
_OTHER_SIGMA_M = 5.0
_LEAST_SIGMA_M = 0.01


class Fix(NamedTuple):
    """A recorded position of the antenna; what the receiver did not say is None.

    `time_ns` is UTC. `height_m` is ellipsoidal (altitude + geoid separation). `quality` is
    GGA's code. `age_s` is that of the differential correction. `sigma_m` is the receiver's
    own 1-sigma error along one horizontal axis. `heading_deg` is a recorded heading of the
    nose (two antennas, INS), never the course; `heading_quality` is that of the baseline
    between the antennas, in GGA's codes. `course_deg` is where the antenna moves, as the
    receiver says it. Angles are degrees clockwise from north, (-180, 180].
    """

    time_ns: int
    lat_deg: float
    lon_deg: float
    height_m: float
    quality: int
    satellites: int | None = None
    hdop: float | None = None
    age_s: float | None = None
    sigma_m: float | None = None
    speed_mps: float | None = None
    heading_deg: float | None = None
    heading_sigma_deg: float | None = None
    heading_quality: int | None = None
    course_deg: float | None = None


def position_sigma_m(fix: Fix) -> float:
    """1-sigma error of a fix along one horizontal axis, metres.

    The receiver's own figure when it gives one, else what is usual for the quality. Its own
    figure is not believed below a tenth of the usual, nor below 1 cm: drivers that write
    millimetres for metres exist. A large figure is always believed.
    """
    usual = _USUAL_SIGMA_M.get(fix.quality, _OTHER_SIGMA_M)
    if fix.sigma_m is None or not (math.isfinite(fix.sigma_m) and fix.sigma_m > 0.0):
        return usual
    return max(fix.sigma_m, usual / 10.0, _LEAST_SIGMA_M)
