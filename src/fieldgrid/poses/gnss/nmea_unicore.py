"""Logs in ASCII of Unicore's UM98x receivers and NovAtel's: a header, ``;``, and the fields.

HEADINGA, HEADING2A, DUALANTENNAHEADINGA and BESTPOSA have the header of NovAtel and of older
receivers: port, number, idle time, clock status, week, seconds. The newer logs have idle time,
time system, clock status, week, milliseconds. Time is GPS time; a receiver set to BeiDou time is
not read.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from fieldgrid.core import Quality
from fieldgrid.poses.gnss.fields import direction_deg, integer, number, required, tilt_deg, within
from fieldgrid.poses.gnss.gps_time import unix_ns
from fieldgrid.poses.gnss.nmea_epochs import Epoch, EpochLog
from fieldgrid.poses.gnss.nmea_standard import state
from fieldgrid.poses.gnss.nmea_statements import (
    BY_ATTITUDE,
    BY_BESTNAV,
    BY_PVTSLN,
    BY_UNIHEADING,
    MAX_HEIGHT_M,
    GroundVelocity,
    Position,
    baseline_heading,
    speed_mps,
)

_CLOCK_SET = frozenset({b"FINE", b"FINESTEERING", b"FINEBACKUPSTEERING"})
_NOVATEL_HEADERS = frozenset({b"HEADINGA", b"HEADING2A", b"DUALANTENNAHEADINGA", b"BESTPOSA"})
_PAD = [b""] * 32

_QUALITY = {
    b"SINGLE": Quality.GPS,
    b"INS_PSRSP": Quality.GPS,
    b"PSRDIFF": Quality.DIFFERENTIAL,
    b"INS_PSRDIFF": Quality.DIFFERENTIAL,
    b"SBAS": Quality.SBAS,
    b"WAAS": Quality.SBAS,
    b"L1_FLOAT": Quality.RTK_FLOAT,
    b"IONOFREE_FLOAT": Quality.RTK_FLOAT,
    b"NARROW_FLOAT": Quality.RTK_FLOAT,
    b"INS_RTKFLOAT": Quality.RTK_FLOAT,
    b"L1_INT": Quality.RTK_FIXED,
    b"WIDE_INT": Quality.RTK_FIXED,
    b"NARROW_INT": Quality.RTK_FIXED,
    b"INS_RTKFIXED": Quality.RTK_FIXED,
    b"PPP_CONVERGING": Quality.DIFFERENTIAL,
    b"PPP": Quality.RTK_FLOAT,
    b"INS": Quality.ESTIMATED,
    b"FIXEDPOS": Quality.MANUAL,
    b"FIXEDHEIGHT": Quality.GPS,
}
"""The qualities of the types of solution."""


def uniheading(body: list[bytes], epoch: Epoch, log: EpochLog) -> None:
    """Heading and pitch of the baseline between the antennas, their sigmas and the type of its
    solution."""
    quality = _quality(body[0], body[1])
    sigma, pitch_sigma = number(body[6]), tilt_deg(body[7])
    state(epoch, baseline_heading(BY_UNIHEADING, body[3], quality, sigma, body[4], pitch_sigma))


def bestpos(body: list[bytes], epoch: Epoch, log: EpochLog) -> None:
    """Position with its sigmas, age and satellites; in BESTNAV with speed in m/s and course."""
    quality = _quality(body[0], body[1])
    if quality is Quality.NONE:
        log.refuse(epoch, BY_BESTNAV)
        return
    position = Position(
        BY_BESTNAV,
        within(body[2], 90.0),
        within(body[3], 180.0),
        within(body[4], MAX_HEIGHT_M) + within(body[5], MAX_HEIGHT_M),
        quality,
        integer(body[14]),
        None,
        number(body[11]),
        _sigma_m(body[7], body[8]),
    )
    motion = None
    if body[21] == b"SOL_COMPUTED":
        motion = GroundVelocity(speed_mps(body[25], 1.0), direction_deg(body[26]))
    log.place(epoch, position)
    epoch.motion = epoch.motion or motion


def pvtsln(body: list[bytes], epoch: Epoch, log: EpochLog) -> None:
    """Position with its sigmas, age, satellites, HDOP; heading and pitch of the baseline."""
    of_baseline = _QUALITY.get(body[20], Quality.NONE)
    state(epoch, baseline_heading(BY_ATTITUDE, body[22], of_baseline, None, body[23]))
    quality = _QUALITY.get(body[0], Quality.NONE)
    if quality is Quality.NONE:
        log.refuse(epoch, BY_PVTSLN)
        return
    position = Position(
        BY_PVTSLN,
        within(body[2], 90.0),
        within(body[3], 180.0),
        within(body[1], MAX_HEIGHT_M) + within(body[12], MAX_HEIGHT_M),
        quality,
        integer(body[14]),
        number(body[30]),
        number(body[7]),
        _sigma_m(body[5], body[6]),
    )
    log.place(epoch, position)


def _quality(status: bytes, solution: bytes) -> Quality:
    return _QUALITY.get(solution, Quality.NONE) if status == b"SOL_COMPUTED" else Quality.NONE


def _epoch(header: list[bytes], log: EpochLog) -> Epoch | None:
    """The epoch of a header, None when the receiver's clock is not set or not GPS time."""
    if header[0] in _NOVATEL_HEADERS:
        status, week, of_week, unit_ns = header[4], header[5], header[6], 1_000_000_000
    elif header[2] == b"GPS":
        status, week, of_week, unit_ns = header[3], header[4], header[5], 1_000_000
    else:
        return None
    if status not in _CLOCK_SET:
        return None
    # Milliseconds are what the receiver knows: rounding to them keeps epochs together.
    milliseconds = round(required(of_week) * unit_ns / 1e6)
    return log.at_utc(unix_ns(integer(week) or 0, milliseconds * 1_000_000))


def _sigma_m(lat_std: bytes, lon_std: bytes) -> float | None:
    north, east = number(lat_std), number(lon_std)
    if north is None or east is None:
        return None
    return math.sqrt((north * north + east * east) / 2.0) or None


def _of_log(
    read: Callable[[list[bytes], Epoch, EpochLog], None], f: list[bytes], log: EpochLog
) -> None:
    """Reads the fields behind the header of a log, if that has a time."""
    header, _, body = b",".join(f).partition(b";")
    epoch = _epoch(header.split(b",") + _PAD, log)
    if epoch is not None:
        read(body.split(b",") + _PAD, epoch, log)


_READERS = {
    b"#UNIHEADINGA": uniheading,
    b"#HEADINGA": uniheading,
    b"#HEADING2A": uniheading,
    b"#DUALANTENNAHEADINGA": uniheading,
    b"#BESTNAVA": bestpos,
    b"#BESTPOSA": bestpos,
    b"#PVTSLNA": pvtsln,
}

DECODERS: dict[bytes, Callable[[list[bytes], EpochLog], None]] = {
    name: partial(_of_log, read) for name, read in _READERS.items()
}
"""By name."""
