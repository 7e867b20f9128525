"""Makers' own sentences: Trimble's PTNL, the PASHR of many INS, Unicore's KSXT.

Each takes the fields of a sentence, its address being field 0, to what the log says of an epoch.
ValueError for what cannot be.
"""

from __future__ import annotations

from fieldgrid.core import Quality
from fieldgrid.poses.gnss.fields import (
    angle_deg,
    direction_deg,
    integer,
    number,
    tilt_deg,
    unix_day,
    within,
)
from fieldgrid.poses.gnss.nmea_epochs import EpochLog
from fieldgrid.poses.gnss.nmea_standard import state
from fieldgrid.poses.gnss.nmea_statements import (
    BY_ATTITUDE,
    BY_GGK,
    BY_KSXT,
    BY_PASHR,
    MAX_HEIGHT_M,
    GroundVelocity,
    Heading,
    Position,
    baseline_heading,
    speed_mps,
)

# The qualities of these makers' codes.
_FIXED, _FLOAT = Quality.RTK_FIXED, Quality.RTK_FLOAT
_AVR_QUALITY = {2: _FLOAT, 3: _FIXED}
_KSXT_QUALITY = {1: Quality.GPS, 2: _FLOAT, 3: _FIXED}
_GGK_QUALITY = {
    1: Quality.GPS,
    2: _FLOAT,
    3: _FIXED,
    4: Quality.DIFFERENTIAL,
    5: Quality.SBAS,
    6: _FLOAT,
    7: _FIXED,
    8: _FLOAT,
    9: _FIXED,
    10: _FLOAT,  # OmniSTAR HP, decimetres
    11: Quality.DIFFERENTIAL,
    12: _FLOAT,  # location RTK, as good as its base
    13: Quality.DIFFERENTIAL,
    14: _FLOAT,  # RTX, centimetres to decimetres
    15: _FLOAT,  # xFill
}


def ptnl(f: list[bytes], log: EpochLog) -> None:
    """Trimble's sentences, of which GGK has a position and AVR a heading."""
    if f[1] == b"GGK":
        _ggk(f, log)
    elif f[1] == b"AVR" and f[2] and f[4].lower() == b"yaw":
        quality = _AVR_QUALITY.get(integer(f[10]) or 0, Quality.NONE)
        up = f[5] if f[6].lower() == b"tilt" else b""
        state(log.at(f[2]), baseline_heading(BY_ATTITUDE, f[3], quality, None, up))


def _ggk(f: list[bytes], log: EpochLog) -> None:
    """Time, date mmddyy, position, quality, satellites, DOP, height: EHT ellipsoidal, or GHT."""
    quality = _GGK_QUALITY.get(integer(f[8]) or 0)
    if not (f[2] and f[4] and f[6] and f[11] and quality):
        log.refuse(log.at(f[2]) if f[2] else None, BY_GGK)
        return
    above, height = f[11][:3], f[11][3:]
    if above not in (b"EHT", b"GHT"):
        raise ValueError(f[11])
    position = Position(
        BY_GGK,
        angle_deg(f[4], f[5], b"N", b"S", 90.0),
        angle_deg(f[6], f[7], b"E", b"W", 180.0),
        within(height, MAX_HEIGHT_M),
        quality,
        integer(f[9]),
        has_geoid=above == b"EHT",  # the DOP is of position: taken for HDOP it would be too large
    )
    day = unix_day(f[3][2:4], f[3][:2], f[3][4:]) if f[3] else None
    epoch = log.at(f[2])
    if epoch.unix_day is None:
        epoch.unix_day = day
    log.place(epoch, position)


def pashr(f: list[bytes], log: EpochLog) -> None:
    """Heading, roll (right side down) and pitch (nose up), their sigmas, and the quality of the
    position: 0 is none, and then nothing counts.

    The last field, of the INS, differs from maker to maker. Ashtech's own PASHR, of which the
    first field is a word, is another sentence.
    """
    if f[3] != b"T" or not f[1]:
        return
    valid = integer(f[10]) not in (None, 0)
    sigma = number(f[9]) or None
    if not valid:
        state(log.at(f[1]), Heading(BY_PASHR, None, sigma))
        return
    tilt_sigma = max(tilt_deg(f[7]) or 0.0, tilt_deg(f[8]) or 0.0) or None
    tilt = (tilt_deg(f[5]), tilt_deg(f[4]), tilt_sigma)
    state(log.at(f[1]), Heading(BY_PASHR, direction_deg(f[2]), sigma, None, *tilt))


def ksxt(f: list[bytes], log: EpochLog) -> None:
    """Full UTC, decimal degrees, height above mean sea level, heading, pitch, course, speed in
    km/h."""
    if len(f[1]) < 14:
        return
    day = unix_day(f[1][6:8], f[1][4:6], f[1][:4])
    epoch = log.at(f[1][8:])
    if epoch.unix_day is None:
        epoch.unix_day = day
    quality = _KSXT_QUALITY.get(integer(f[10]) or 0)
    if quality and f[2] and f[3] and f[4]:
        lat, lon = within(f[3], 90.0), within(f[2], 180.0)
        height, satellites = within(f[4], MAX_HEIGHT_M), integer(f[13])
        motion = GroundVelocity(speed_mps(f[8], 1 / 3.6), direction_deg(f[7]))
        log.place(epoch, Position(BY_KSXT, lat, lon, height, quality, satellites, has_geoid=False))
        if epoch.motion is None:
            epoch.motion = motion
    else:
        log.refuse(epoch, BY_KSXT)
    state(
        epoch,
        baseline_heading(
            BY_ATTITUDE, f[5], _KSXT_QUALITY.get(integer(f[11]) or 0, Quality.NONE), None, f[6]
        ),
    )


DECODERS = {b"PTNL": ptnl, b"PASHR": pashr, b"KSXT": ksxt}
"""By name."""
