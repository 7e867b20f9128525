"""The sentences that are read, a row each: the time of their epoch, and what their fields say.

A row takes the fields of a sentence, of which field 0 is the address. The logs in ASCII of
Unicore's UM98x receivers and of NovAtel's have a header of ten fields. Time in it is GPS time; a
receiver set to BeiDou time is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from fieldgrid.core import CARRIER, Quality
from fieldgrid.poses.gnss.fields import (
    DAY_NS,
    KMH_MPS,
    KNOT_MPS,
    LATITUDE,
    LONGITUDE,
    UnsaidError,
    angle_deg,
    course_deg,
    heading_deg,
    height_m,
    integer,
    number,
    of_day_ns,
    sigma_m,
    speed_mps,
    tilt_deg,
    unix_day,
    within,
)
from fieldgrid.poses.gnss.gps_time import unix_ns

Fields = list[bytes]
Moment = tuple[int, int | None]
"""Nanoseconds of a day, and which day since 1970 that is, None where it is not told."""


Says = dict[tuple[str, int], Callable[[Fields], dict[str, Any]]]
"""By subject and trust what a sentence says, as fields of the fix; UnsaidError where it says that
there is none. Of all that speak of a subject in an epoch the one of the most trust is believed, of
equals the first."""

Sentence = tuple[Callable[[Fields], Moment] | None, Says]
"""The moment of a sentence, None for one that belongs to the epoch before it, and what it says. One
of which the moment is not said is not used."""

POSITION, COARSE, HEADING = "position", "position of RMC", "heading"
MOTION, FALLBACK = "motion", "motion where nothing else tells it"
SIGMA, SOLUTION = "sigma", "solution"
"""What sentences speak of. RMC has no height and the coarsest quality; SOLUTION: whether there is
any."""

_COMPUTED = b"SOL_COMPUTED"
_CLOCK_SET = frozenset({b"FINE", b"FINESTEERING", b"FINEBACKUPSTEERING"})

_FIXED, _FLOAT = Quality.RTK_FIXED, Quality.RTK_FLOAT
_RMC = {
    b"": Quality.UNKNOWN,  # receivers before NMEA 2.3 say no more than "valid"
    b"A": Quality.GPS,
    b"D": Quality.DIFFERENTIAL,
    b"P": Quality.PPS,
    b"R": _FIXED,
    b"F": _FLOAT,
    b"E": Quality.ESTIMATED,
    b"M": Quality.MANUAL,
    b"S": Quality.SIMULATED,
}
_GGK = {
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
_KSXT = {1: Quality.GPS, 2: _FLOAT, 3: _FIXED}
_SOLUTIONS = {
    b"SINGLE": Quality.GPS,
    b"INS_PSRSP": Quality.GPS,
    b"PSRDIFF": Quality.DIFFERENTIAL,
    b"INS_PSRDIFF": Quality.DIFFERENTIAL,
    b"SBAS": Quality.SBAS,
    b"WAAS": Quality.SBAS,
    b"L1_FLOAT": _FLOAT,
    b"IONOFREE_FLOAT": _FLOAT,
    b"NARROW_FLOAT": _FLOAT,
    b"INS_RTKFLOAT": _FLOAT,
    b"L1_INT": _FIXED,
    b"WIDE_INT": _FIXED,
    b"NARROW_INT": _FIXED,
    b"INS_RTKFIXED": _FIXED,
    b"PPP_CONVERGING": Quality.DIFFERENTIAL,
    b"PPP": _FLOAT,
    b"INS": Quality.ESTIMATED,
    b"FIXEDPOS": Quality.MANUAL,
    b"FIXEDHEIGHT": Quality.GPS,
}
"""Qualities by the modes of RMC, the codes of GGK and KSXT, the types of solution of logs."""


def _known(quality: Quality | None) -> Quality:
    """A quality, UnsaidError where there is none."""
    if not quality:
        raise UnsaidError
    return quality


def _coded(code: bytes, qualities: Mapping[int, Quality]) -> Quality:
    return _known(qualities.get(integer(code) or 0))


@lru_cache
def _gga(code: bytes) -> Quality:
    return _known(Quality.of_code(integer(code) or 0)) if code else Quality.UNKNOWN


def _carrier(quality: Quality) -> Quality:
    """The quality of a baseline, which needs ambiguities that are fixed or at least floating."""
    return _known(quality if quality in CARRIER else None)


def _solution(kind: bytes, status: bytes) -> Quality:
    return _known(_SOLUTIONS.get(kind) if status == _COMPUTED else None)


def _solved(mode: bytes) -> bool:
    """Whether GSA, of one constellation, has a mode of a solution."""
    if mode == b"1":
        raise UnsaidError
    return bool(mode)


def _of_gps(status: bytes, week: bytes, of_week: bytes, unit_ms: int) -> Moment:
    if status not in _CLOCK_SET:
        raise UnsaidError
    # Milliseconds are what the receiver knows: rounding to them keeps epochs together.
    milliseconds = round((number(of_week) or 0.0) * unit_ms)
    day, of_day = divmod(unix_ns(integer(week) or 0, milliseconds * 1_000_000), DAY_NS)
    return of_day, day


def _by_ms(f: Fields) -> Moment:
    """The moment of the newer logs: idle time, time system, clock status, week, milliseconds."""
    return _of_gps(f[3] if f[2] == b"GPS" else b"", f[4], f[5], 1)


def _by_s(f: Fields) -> Moment:
    """That of NovAtel's and of older receivers: port, number, idle time, status, week, seconds."""
    return _of_gps(f[4], f[5], f[6], 1000)


def _of_day(f: Fields) -> Moment:
    return of_day_ns(f[1]), None


def _ggk_height_m(field: bytes) -> float:
    if field[:3] not in (b"EHT", b"GHT"):
        raise ValueError(field)
    return height_m(field[3:] or field)


_UNIHEADING: Says = {
    (HEADING, 4): lambda f: {
        "heading_quality": _carrier(_solution(f[11], f[10])),
        "heading_deg": heading_deg(f[13]),
        "heading_sigma_deg": number(f[16]) or None,
        "pitch_deg": tilt_deg(f[14]),
        "tilt_sigma_deg": tilt_deg(f[17]) or None,
    }
}
_BESTPOS: Says = {
    (POSITION, 2): lambda f: {
        "quality": _solution(f[11], f[10]),
        "lat_deg": within(f[12], 90.0),
        "lon_deg": within(f[13], 180.0),
        "height_m": height_m(f[14], f[15]),
        "satellites": integer(f[24]),
        "age_s": number(f[21]),
        "sigma_m": sigma_m(f[17], f[18]),
    }
}
# Heading and pitch of two antennas. They cannot tell the roll, which is 0.
_TWO_ANTENNAS: Says = {
    (HEADING, 2): lambda f: {
        "heading_quality": _coded(f[5], {4: _FIXED, 5: _FLOAT}),
        "heading_deg": heading_deg(f[2]),
        "pitch_deg": tilt_deg(f[3]),
    }
}

SENTENCES: dict[bytes, Sentence] = {
    b"GGA": (
        _of_day,
        {
            (POSITION, 5): lambda f: {
                "quality": _gga(f[6]),
                "lat_deg": angle_deg(f[2], f[3], LATITUDE),
                "lon_deg": angle_deg(f[4], f[5], LONGITUDE),
                "height_m": height_m(f[9], f[11]),
                "satellites": integer(f[7]),
                "hdop": number(f[8]),
                "age_s": number(f[13]),
                "has_geoid": bool(f[11]),
            },
        },
    ),
    b"RMC": (
        # A receiver without a fix writes the date of its last battery.
        lambda f: (
            of_day_ns(f[1] if f[2] == b"A" else b""),
            unix_day(f[9][:2], f[9][2:4], f[9][4:]),
        ),
        {
            (MOTION, 1): lambda f: {
                "speed_mps": speed_mps(f[7], KNOT_MPS),
                "course_deg": course_deg(f[8]),
            },
            (COARSE, 0): lambda f: {
                "quality": _known(_RMC.get(f[12])),
                "lat_deg": angle_deg(f[3], f[4], LATITUDE),
                "lon_deg": angle_deg(f[5], f[6], LONGITUDE),
            },
        },
    ),
    b"VTG": (
        None,
        {
            (FALLBACK, 0): lambda f: {
                "speed_mps": speed_mps(f[7], KMH_MPS)
                if f[7] and f[8] == b"K"
                else speed_mps(f[5] if f[6] == b"N" else b"", KNOT_MPS),
                "course_deg": course_deg(f[1] if f[2] == b"T" else b""),
            },
        },
    ),
    b"GSA": (
        None,
        {(SOLUTION, 0): lambda f: {"hdop": number(f[16] if _solved(f[2]) else b"")}},
    ),
    b"GST": (
        _of_day,
        {(SIGMA, 0): lambda f: {"sigma_m": s} if (s := sigma_m(f[6], f[7])) else {}},
    ),
    b"ZDA": (lambda f: (of_day_ns(f[1]), unix_day(f[2], f[3], f[4])), {}),
    b"HDT": (
        None,
        {(HEADING, 0): lambda f: {"heading_deg": heading_deg(f[1] if f[2] == b"T" else b"")}},
    ),
    b"THS": (
        None,
        {
            # Autonomous or estimated; anything else is no heading.
            (HEADING, 1): lambda f: {
                "heading_deg": heading_deg(f[1] if f[2] in (b"A", b"E") else b"")
            },
        },
    ),
    b"TRA": (_of_day, _TWO_ANTENNAS),  # ComNav's
    b"HPR": (_of_day, _TWO_ANTENNAS),  # Unicore's
    b"PTNL,AVR": (
        lambda f: (of_day_ns(f[2]), None),
        {
            (HEADING, 2): lambda f: {
                "heading_quality": _coded(f[10], {2: _FLOAT, 3: _FIXED}),
                "heading_deg": heading_deg(f[3] if f[4].lower() == b"yaw" else b""),
                "pitch_deg": tilt_deg(f[5] if f[6].lower() == b"tilt" else b""),
            },
        },
    ),
    b"PTNL,GGK": (
        lambda f: (of_day_ns(f[2]), unix_day(f[3][2:4], f[3][:2], f[3][4:])),
        {
            # Its DOP is of position: taken for HDOP it would be too large.
            (POSITION, 4): lambda f: {
                "quality": _coded(f[8], _GGK),
                "lat_deg": angle_deg(f[4], f[5], LATITUDE),
                "lon_deg": angle_deg(f[6], f[7], LONGITUDE),
                "height_m": _ggk_height_m(f[11]),
                "satellites": integer(f[9]),
                "has_geoid": f[11][:1] == b"E",
            },
        },
    ),
    b"PASHR": (
        # Ashtech's own PASHR, of which the first field is a word, is another sentence.
        lambda f: (of_day_ns(f[1] if f[3] == b"T" else b""), None),
        {
            # Roll has the right side down, pitch the nose up. The last field, of the INS, differs
            # from maker to maker.
            (HEADING, 3): lambda f: {
                "heading_deg": heading_deg(f[2] if integer(f[10]) else b""),
                "heading_sigma_deg": number(f[9]) or None,
                "pitch_deg": tilt_deg(f[5]),
                "roll_deg": tilt_deg(f[4]),
                "tilt_sigma_deg": max(tilt_deg(f[7]) or 0.0, tilt_deg(f[8]) or 0.0) or None,
            },
        },
    ),
    b"KSXT": (
        lambda f: (of_day_ns(f[1][8:]), unix_day(f[1][6:8], f[1][4:6], f[1][:4])),
        {
            (POSITION, 3): lambda f: {
                "quality": _coded(f[10], _KSXT),
                "lat_deg": within(f[3], 90.0),
                "lon_deg": within(f[2], 180.0),
                "height_m": height_m(f[4]),
                "satellites": integer(f[13]),
                "has_geoid": False,
            },
            (MOTION, 0): lambda f: {
                "speed_mps": speed_mps(f[8], KMH_MPS),
                "course_deg": course_deg(f[7]),
            },
            (HEADING, 2): lambda f: {
                "heading_quality": _carrier(_coded(f[11], _KSXT)),
                "heading_deg": heading_deg(f[5]),
                "pitch_deg": tilt_deg(f[6]),
            },
        },
    ),
    b"#UNIHEADINGA": (_by_ms, _UNIHEADING),
    b"#HEADINGA": (_by_s, _UNIHEADING),
    b"#HEADING2A": (_by_s, _UNIHEADING),
    b"#DUALANTENNAHEADINGA": (_by_s, _UNIHEADING),
    b"#BESTPOSA": (_by_s, _BESTPOS),
    b"#BESTNAVA": (
        _by_ms,
        {
            **_BESTPOS,
            (MOTION, 0): lambda f: {
                "speed_mps": speed_mps(f[35] if f[31] == _COMPUTED else b"", 1.0),
                "course_deg": course_deg(f[36] if f[31] == _COMPUTED else b""),
            },
        },
    ),
    b"#PVTSLNA": (
        _by_ms,
        {
            (POSITION, 1): lambda f: {
                "quality": _solution(f[10], _COMPUTED),
                "lat_deg": within(f[12], 90.0),
                "lon_deg": within(f[13], 180.0),
                "height_m": height_m(f[11], f[22]),
                "satellites": integer(f[24]),
                "hdop": number(f[40]),
                "age_s": number(f[17]),
                "sigma_m": sigma_m(f[15], f[16]),
            },
            (HEADING, 2): lambda f: {
                "heading_quality": _carrier(_solution(f[30], _COMPUTED)),
                "heading_deg": heading_deg(f[32]),
                "pitch_deg": tilt_deg(f[33]),
            },
        },
    ),
}
"""By formatter, any talker; by the name of a maker's own sentence; by that of a log."""
