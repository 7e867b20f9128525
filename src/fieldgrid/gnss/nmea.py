"""NMEA 0183 logs to fixes, whatever lies between the sentences.

A sentence is what stands between one ``$`` and the next. That alone frames the log: a broken
or merged line ends where the next sentence starts, binary messages and garbage match nothing,
the result does not depend on how the bytes arrive, and no more than one sentence is held.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

from fieldgrid.angles import wrap_deg
from fieldgrid.errors import GnssError
from fieldgrid.gnss.fields import (
    angle_deg,
    checksum,
    integer,
    number,
    of_day_ns,
    required,
    unix_day,
)
from fieldgrid.gnss.fix import Fix

_MAX_SENTENCE = 256  # bytes; the standard's 82 are exceeded by many receivers
_CHUNK = 1 << 16
_ADDRESS = re.compile(rb"[A-Z][A-Z0-9]{3,9},")
_SENTENCE = re.compile(rb"([A-Z][A-Z0-9]{3,9}),([ -)+-~]*)\*([0-9A-Fa-f]{2})")

_DAY_NS = 86_400_000_000_000
_KNOT_MPS = 1852.0 / 3600.0
_LATE_EPOCHS = 4  # a sentence may come this many epochs after the one that it belongs to


class NmeaLog(NamedTuple):
    """The fixes of a log in its order, and what was found on the way.

    `sentences` counts the intact ones of any kind, `bad_checksum` the complete ones whose
    checksum is wrong, `broken` those that are cut, merged, or say nothing that can be.
    `no_position` counts GGA sentences without a fix, `repeated` those of an epoch that has
    its position already, `no_geoid` fixes whose height lacks the geoid separation.
    """

    fixes: list[Fix]
    sentences: int = 0
    bad_checksum: int = 0
    broken: int = 0
    no_position: int = 0
    repeated: int = 0
    no_geoid: int = 0


def parse_nmea(data: Iterable[bytes]) -> NmeaLog:
    """Fixes of an NMEA log, given as chunks of bytes of any size or as an open binary file.

    A fix is a GGA sentence with what RMC, VTG, GST, HDT and THS of the same epoch add. RMC or
    ZDA give the date; :class:`GnssError` when there are positions and no date anywhere.
    Sentences without a time of their own (VTG, HDT, THS) belong to the epoch before them.
    """
    parser = _Parser()
    for segment in _segments(_chunks(data)):
        parser.take(segment)
    return parser.log()


def _chunks(data: Iterable[bytes]) -> Iterable[bytes]:
    # Iterating over a file would give lines, and garbage may hold no end of line at all.
    if isinstance(data, io.IOBase):
        return iter(lambda: data.read(_CHUNK), b"")
    return data


def _segments(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """What follows each ``$``, cut to the length that a sentence can have."""

    def split() -> Iterator[bytes]:
        pending = b""
        for chunk in chunks:
            first, *others = chunk.split(b"$")
            pending = (pending + first[:_MAX_SENTENCE])[:_MAX_SENTENCE]
            for other in others:
                yield pending
                pending = other[:_MAX_SENTENCE]
        yield pending

    return islice(split(), 1, None)  # what precedes the first `$` is no sentence


class _Position(NamedTuple):
    lat_deg: float
    lon_deg: float
    height_m: float
    quality: int
    satellites: int | None
    hdop: float | None
    age_s: float | None


@dataclass(slots=True)
class _Epoch:
    """What the sentences of one time of day have said so far."""

    of_day_ns: int
    position: _Position | None = None
    unix_day: int | None = None
    rmc_speed_mps: float | None = None
    vtg_speed_mps: float | None = None
    sigma_m: float | None = None
    heading_deg: float | None = None


class _Parser:
    """Collects epochs from sentences. A malformed field raises ValueError within."""

    def __init__(self) -> None:
        self._epochs: list[_Epoch] = []
        self._current: _Epoch | None = None
        self._sentences = self._bad_checksum = self._broken = 0
        self._no_position = self._repeated = self._no_geoid = 0
        self._handlers: dict[bytes, Callable[[list[bytes]], None]] = {
            b"GGA": self._gga,
            b"RMC": self._rmc,
            b"ZDA": self._zda,
            b"VTG": self._vtg,
            b"GST": self._gst,
            b"HDT": self._hdt,
            b"THS": self._ths,
        }

    def take(self, segment: bytes) -> None:
        """One candidate: everything after a ``$``."""
        match = _SENTENCE.match(segment)
        if match is None:
            self._broken += _ADDRESS.match(segment) is not None
            return
        if checksum(segment[: match.end(2)]) != int(match[3], 16):
            self._bad_checksum += 1
            return
        self._sentences += 1
        address = match[1]
        handler = self._handlers.get(address[2:])
        if handler is None or address.startswith(b"P"):  # P: a maker's own sentence
            return
        try:
            handler(match[2].split(b",") + [b""] * 14)
        except ValueError:
            self._broken += 1

    def log(self) -> NmeaLog:
        """The fixes with their dates, and the counts."""
        return NmeaLog(
            _dated_fixes(self._epochs),
            self._sentences,
            self._bad_checksum,
            self._broken,
            self._no_position,
            self._repeated,
            self._no_geoid,
        )

    def _epoch(self, of_day_ns: int) -> _Epoch:
        """The epoch of a time of day: a recent one, or a new one."""
        for epoch in reversed(self._epochs[-_LATE_EPOCHS:]):
            if epoch.of_day_ns == of_day_ns:
                self._current = epoch
                return epoch
        self._current = _Epoch(of_day_ns)
        self._epochs.append(self._current)
        return self._current

    def _gga(self, f: list[bytes]) -> None:
        if not (f[0] and f[1] and f[3] and f[8]) or integer(f[5]) in (None, 0):
            self._no_position += 1
            # Untimed sentences that follow must not be taken for the epoch before.
            self._current = self._epoch(of_day_ns(f[0])) if f[0] else None
            return
        position = _Position(
            lat_deg=angle_deg(f[1], f[2], b"N", b"S", 90.0),
            lon_deg=angle_deg(f[3], f[4], b"E", b"W", 180.0),
            height_m=required(f[8]) + (number(f[10]) or 0.0),
            quality=integer(f[5]) or 0,
            satellites=integer(f[6]),
            hdop=number(f[7]),
            age_s=number(f[12]),
        )
        epoch = self._epoch(of_day_ns(f[0]))
        if epoch.position is not None:
            self._repeated += 1
            return
        epoch.position = position
        self._no_geoid += not f[10]

    def _rmc(self, f: list[bytes]) -> None:
        if f[1] != b"A" or not f[0]:
            return  # a receiver without a fix writes the date of its last battery
        speed, day = number(f[6]), unix_day(f[8][:2], f[8][2:4], f[8][4:]) if f[8] else None
        epoch = self._epoch(of_day_ns(f[0]))
        epoch.unix_day = day
        epoch.rmc_speed_mps = None if speed is None else abs(speed) * _KNOT_MPS

    def _zda(self, f: list[bytes]) -> None:
        if not (f[0] and f[1] and f[2] and f[3]):
            return
        day = unix_day(f[1], f[2], f[3])
        epoch = self._epoch(of_day_ns(f[0]))
        if epoch.unix_day is None:
            epoch.unix_day = day

    def _vtg(self, f: list[bytes]) -> None:
        speed = number(f[6]) if f[7] == b"K" else None
        if self._current is not None and speed is not None:
            self._current.vtg_speed_mps = abs(speed) / 3.6

    def _gst(self, f: list[bytes]) -> None:
        north, east = number(f[5]), number(f[6])
        if f[0] and north is not None and east is not None:
            self._epoch(of_day_ns(f[0])).sigma_m = ((north**2 + east**2) / 2.0) ** 0.5

    def _hdt(self, f: list[bytes]) -> None:
        heading = number(f[0])
        if self._current is not None and heading is not None and f[1] == b"T":
            self._current.heading_deg = float(wrap_deg(heading))

    def _ths(self, f: list[bytes]) -> None:
        if f[1] in (b"A", b"E"):  # autonomous or dead reckoning; V is invalid
            self._hdt([f[0], b"T"])


def _dated_fixes(epochs: list[_Epoch]) -> list[Fix]:
    """Fixes of the epochs with a position; a date holds until the next, across midnight."""
    positions = sum(epoch.position is not None for epoch in epochs)
    days = _days_counted(epochs)
    shift = next(
        (e.unix_day - d for e, d in zip(epochs, days, strict=True) if e.unix_day is not None), None
    )
    if positions and shift is None:
        raise GnssError(
            f"The log has {positions} positions but no valid RMC or ZDA sentence, which alone "
            "give their date; let the receiver write RMC besides GGA."
        )
    fixes = []
    for epoch, day in zip(epochs, days, strict=True):
        if epoch.unix_day is not None:
            shift = epoch.unix_day - day
        if epoch.position is None or shift is None:
            continue
        p, rmc = epoch.position, epoch.rmc_speed_mps
        fixes.append(
            Fix(
                (day + shift) * _DAY_NS + epoch.of_day_ns,
                *p,
                sigma_m=epoch.sigma_m,
                speed_mps=epoch.vtg_speed_mps if rmc is None else rmc,
                heading_deg=epoch.heading_deg,
            )
        )
    return fixes


def _days_counted(epochs: list[_Epoch]) -> list[int]:
    """Days since the first epoch, from the times of day alone.

    Half a day back is the next day. Nearly a whole day ahead is a straggler from before
    midnight; less than that is a logger that was switched off.
    """
    days, day, last_ns = [], 0, None
    for epoch in epochs:
        if last_ns is not None:
            ahead_ns = epoch.of_day_ns - last_ns
            day += (ahead_ns < -_DAY_NS // 2) - (ahead_ns > 23 * _DAY_NS // 24)
        days.append(day)
        last_ns = epoch.of_day_ns
    return days
