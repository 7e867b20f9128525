"""The sentences of NMEA 0183, and those of receivers that follow its manner.

Each takes the fields of a sentence, its address being field 0, to what the log says of an epoch.
ValueError for what cannot be.
"""

from __future__ import annotations

import math

from fieldgrid.core import Quality
from fieldgrid.poses.gnss.fields import angle_deg, direction_deg, integer, number, unix_day, within
from fieldgrid.poses.gnss.nmea_epochs import Epoch, EpochLog
from fieldgrid.poses.gnss.nmea_statements import (
    BY_ATTITUDE,
    BY_GGA,
    BY_HDT,
    BY_THS,
    MAX_HEIGHT_M,
    Heading,
    Position,
    baseline_heading,
    rmc_motion,
)


def gga(f: list[bytes], log: EpochLog) -> None:
    """Position, quality, satellites, HDOP, height, geoid, age of the correction."""
    quality = _gga_quality(f[6])
    if not (f[1] and f[2] and f[4] and f[9]) or quality is Quality.NONE:
        log.refuse(log.at(f[1]) if f[1] else None, BY_GGA)
        return
    position = Position(
        BY_GGA,
        angle_deg(f[2], f[3], b"N", b"S", 90.0),
        angle_deg(f[4], f[5], b"E", b"W", 180.0),
        within(f[9], MAX_HEIGHT_M) + (within(f[11], MAX_HEIGHT_M) if f[11] else 0.0),
        quality,
        integer(f[7]),
        number(f[8]),
        number(f[13]),
        None,
        bool(f[11]),
    )
    log.place(log.at(f[1]), position)


def _gga_quality(field: bytes) -> Quality:
    code = integer(field)
    return Quality.UNKNOWN if code is None else Quality.of_code(code)


def rmc(f: list[bytes], log: EpochLog) -> None:
    """Date, speed, course, and a position for logs that have no other."""
    if f[2] != b"A" or not f[1]:
        return  # a receiver without a fix writes the date of its last battery
    motion = rmc_motion(f)
    day = unix_day(f[9][:2], f[9][2:4], f[9][4:]) if f[9] else None
    epoch = log.at(f[1])
    epoch.motion = motion
    if day is not None:
        epoch.unix_day = day
    if epoch.position is None and epoch.rmc is None and f[3] and f[5]:
        epoch.rmc = f


def vtg(f: list[bytes], log: EpochLog) -> None:
    """Speed and course for epochs without RMC. The second of an epoch belongs to a lost one."""
    if log.current is not None and log.current.vtg is None:
        log.current.vtg = f


def gsa(f: list[bytes], log: EpochLog) -> None:
    """Fix mode, the best of all constellations, and HDOP for logs whose GGA has none."""
    epoch = log.current
    if epoch is not None and f[2] in (b"1", b"2", b"3"):
        epoch.solution = max(epoch.solution, f[2])
        epoch.gsa_hdop = epoch.gsa_hdop or f[16]


def gst(f: list[bytes], log: EpochLog) -> None:
    """The receiver's own sigma: of its north and east errors, the mean along one axis."""
    north, east = number(f[6]), number(f[7])
    if f[1] and north is not None and east is not None:
        log.at(f[1]).sigma_m = math.sqrt((north * north + east * east) / 2.0)


def zda(f: list[bytes], log: EpochLog) -> None:
    """The date, for epochs without RMC."""
    if f[1] and f[2] and f[3] and f[4]:
        day = unix_day(f[2], f[3], f[4])
        epoch = log.at(f[1])
        if epoch.unix_day is None:
            epoch.unix_day = day


def hdt(f: list[bytes], log: EpochLog) -> None:
    """True heading, without a word on how good it is."""
    heading = direction_deg(f[1])
    if heading is not None and f[2] == b"T":
        state(log.current, Heading(BY_HDT, heading))


def ths(f: list[bytes], log: EpochLog) -> None:
    """True heading and its mode: autonomous or estimated; anything else is no heading."""
    state(log.current, Heading(BY_THS, direction_deg(f[1]) if f[2] in (b"A", b"E") else None))


def tra(f: list[bytes], log: EpochLog) -> None:
    """Heading, pitch and quality of two antennas: ComNav's TRA, and Unicore's HPR alike. They
    cannot tell the roll, which is 0."""
    if f[1]:
        heading = baseline_heading(BY_ATTITUDE, f[2], _gga_quality(f[5]), None, f[3])
        state(log.at(f[1]), heading)


def state(epoch: Epoch | None, heading: Heading) -> None:
    """A heading of an epoch: that of the best source is kept, also when it says "none"."""
    if epoch is not None and heading.source > epoch.heading.source:
        epoch.heading = heading


DECODERS = {
    b"GGA": gga,
    b"RMC": rmc,
    b"VTG": vtg,
    b"GSA": gsa,
    b"GST": gst,
    b"ZDA": zda,
    b"HDT": hdt,
    b"THS": ths,
    b"TRA": tra,
    b"HPR": tra,
}
"""By formatter, any talker."""
