"""What a sentence can state of an epoch, and how far it is trusted beside the others.

The readers here take the fields of a sentence, its address being field 0. ValueError for what
cannot be.
"""

from __future__ import annotations

from typing import NamedTuple

from fieldgrid.core import CARRIER, Quality
from fieldgrid.poses.gnss.fields import angle_deg, direction_deg, number, tilt_deg

MAX_HEIGHT_M = 1e5
_MAX_SPEED_MPS = 1e4
_KNOT_MPS = 1852.0 / 3600.0

# Where an epoch has its position from, the best last. GGA alone has quality, satellites, HDOP,
# age and geoid together; RMC has no height and the coarsest quality.
BY_RMC, BY_PVTSLN, BY_BESTNAV, BY_KSXT, BY_GGK, BY_GGA = range(6)

# Where it has its heading from. What gives a quality or a sigma goes before what gives none.
BY_HDT, BY_THS, BY_ATTITUDE, BY_PASHR, BY_UNIHEADING = range(5)

_RMC_QUALITY = {
    b"": Quality.UNKNOWN,  # receivers before NMEA 2.3 say no more than "valid"
    b"A": Quality.GPS,
    b"D": Quality.DIFFERENTIAL,
    b"P": Quality.PPS,
    b"R": Quality.RTK_FIXED,
    b"F": Quality.RTK_FLOAT,
    b"E": Quality.ESTIMATED,
    b"M": Quality.MANUAL,
    b"S": Quality.SIMULATED,
}


class Position(NamedTuple):
    """A position and what its sentence says of it. `height_m` is None where it has none."""

    source: int
    lat_deg: float
    lon_deg: float
    height_m: float | None
    quality: Quality
    satellites: int | None = None
    hdop: float | None = None
    age_s: float | None = None
    sigma_m: float | None = None
    has_geoid: bool = True


class Heading(NamedTuple):
    """A recorded heading of the nose; `deg` is None where the sentence says it has none.

    `pitch_deg` and `roll_deg` are those of the axis that points there: up, right side down.
    """

    source: int
    deg: float | None
    sigma_deg: float | None = None
    quality: Quality | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    tilt_sigma_deg: float | None = None


class GroundVelocity(NamedTuple):
    """Speed and course over ground."""

    speed_mps: float | None = None
    course_deg: float | None = None


def speed_mps(field: bytes, unit_mps: float) -> float | None:
    """The speed of a field in a unit, None when it is empty. Some receivers sign it."""
    value = number(field)
    if value is None:
        return None
    speed = abs(value) * unit_mps
    if speed > _MAX_SPEED_MPS:
        raise ValueError(field)
    return speed


def baseline_heading(
    source: int,
    field: bytes,
    quality: Quality,
    sigma: float | None,
    pitch: bytes = b"",
    pitch_sigma: float | None = None,
) -> Heading:
    """The heading and the pitch of a baseline, None unless its ambiguities are fixed or at least
    floating."""
    known = quality in CARRIER
    deg = direction_deg(field) if known else None
    up_deg = tilt_deg(pitch) if known else None
    return Heading(source, deg, sigma or None, quality, up_deg, None, pitch_sigma or None)


def rmc_motion(f: list[bytes]) -> GroundVelocity:
    """Speed in knots and course of RMC."""
    return GroundVelocity(speed_mps(f[7], _KNOT_MPS), direction_deg(f[8]))


def vtg_motion(f: list[bytes]) -> GroundVelocity:
    """Speed, in km/h or else in knots, and course of VTG."""
    speed = speed_mps(f[7], 1 / 3.6) if f[8] == b"K" else None
    if speed is None and f[6] == b"N":
        speed = speed_mps(f[5], _KNOT_MPS)
    return GroundVelocity(speed, direction_deg(f[1]) if f[2] == b"T" else None)


def rmc_position(f: list[bytes]) -> Position | None:
    """The position of RMC, its quality from the mode indicator (unknown where it has none)."""
    quality = _RMC_QUALITY.get(f[12])
    if quality is None:
        return None
    lat = angle_deg(f[3], f[4], b"N", b"S", 90.0)
    return Position(BY_RMC, lat, angle_deg(f[5], f[6], b"E", b"W", 180.0), None, quality)
