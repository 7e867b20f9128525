"""UBX, the binary protocol of u-blox receivers, to fixes, whatever lies between the messages.

A message is B5 62, class, id, length, payload and Fletcher's checksum. Where the checksum does
not hold, the search goes on right behind the two sync bytes: a corrupt length swallows nothing.
The result does not depend on how the bytes arrive, and little more than one message is held.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import date
from typing import Any

import numpy as np

from fieldgrid.core import Quality
from fieldgrid.geometry import Fix, wrap_deg
from fieldgrid.poses.gnss.fields import FIRST_YEAR, LAST_YEAR

_SYNC = b"\xb5\x62"
_FRAME = 8  # bytes around a payload
_MAX_PAYLOAD = 4096  # the longest, raw measurements of 92 signals, has 2960
_LATE_EPOCHS = 1  # a message may come this many epochs after the one that it belongs to

_UNIX_DAY = date(1970, 1, 1).toordinal()
_DAY_S = 86_400
_WEIGHTS = (np.arange(_MAX_PAYLOAD + 4, 0, -1) % 256).astype(np.uint8)

# iTOW, date and time, valid, nano; fixType, flags, satellites, lon, lat, height; hAcc;
# gSpeed, headMot; headAcc; flags3; headVeh (its last field is missing in u-blox 7).
_PVT = struct.Struct("<IHBBBBBB4xi BBxB iii 4xI 16x ii 4xI 2xH")
_PVT_BYTES = 84
_HEAD_VEHICLE = struct.Struct("<84xi")
_HPPOSLLH = struct.Struct("<B2xBI iii 4x bbb x I 4x")
# iTOW; north, east, down (cm); heading; the same to 0.1 mm; sigmas of down (0.1 mm) and heading;
# flags.
_RELPOSNED = struct.Struct("<B3xI iii 4x i 4x bbb 9x I 4x I 4x I")
_DOP = struct.Struct("<I 8x H 4x")
_ITOW = struct.Struct("<I")

# NAV-PVT's age of corrections: the upper end of each of its steps, in seconds.
_AGE_S = (None, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 120.0)

_NO_FIX, _DEAD_RECKONING, _TIME_ONLY = 0, 1, 5
_FLOAT, _FIXED = 1, 2
# RELPOSNED: fix and relative position valid, the base moves along, its heading valid.
_ATTITUDE = 1 << 0 | 1 << 2 | 1 << 5 | 1 << 8
_NORMALISED = 1 << 9  # the relative position has the length 1


@dataclass(slots=True)
class UbxCounts:
    """What was found in a stream of messages so far.

    `messages` counts the intact ones of any kind, `bad_checksum` what starts like a message
    and is none, `broken` messages that say what cannot be. `no_position` counts solutions
    without a position or without a time, `repeated` those of an epoch that has its position
    already. `unfixed_headings` counts relative positions from which no heading is taken:
    ambiguities not fixed, or a base that does not ride on the vehicle.
    """

    messages: int = 0
    bad_checksum: int = 0
    broken: int = 0
    no_position: int = 0
    repeated: int = 0
    unfixed_headings: int = 0


class _Framer:
    """Cuts a stream into messages: class and id as two bytes, and payload."""

    def __init__(self, counts: UbxCounts) -> None:
        self._held = bytearray()
        self._counts = counts

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        self._held += data
        return self._cut(last=False)

    def close(self) -> Iterator[tuple[bytes, bytes]]:
        return self._cut(last=True)

    def _cut(self, last: bool) -> Iterator[tuple[bytes, bytes]]:
        held, at = bytes(self._held), 0
        while (found := held.find(_SYNC, at)) >= 0:
            at = found
            length = int.from_bytes(held[at + 4 : at + 6], "little")
            stop = at + _FRAME + length
            complete = len(held) >= at + 6
            if not complete or (length <= _MAX_PAYLOAD and stop > len(held)):
                if not last:
                    break
                self._counts.bad_checksum += 1
                at += 2
            elif length > _MAX_PAYLOAD or not _checks(held[at + 2 : stop]):
                self._counts.bad_checksum += 1
                at += 2
            else:
                self._counts.messages += 1
                yield held[at + 2 : at + 4], held[at + 6 : stop - 2]
                at = stop
        # Without a sync the last byte may be the first half of one, unless it is used already.
        self._held = bytearray(held[at:] if found >= 0 else held[max(at, len(held) - 1) :])


def _checks(body: bytes) -> bool:
    """Whether a message from its class to its checksum is intact. Everything is modulo 256."""
    counted = np.frombuffer(body, np.uint8, len(body) - 2)
    first = sum(body[:-2]) % 256
    second = np.dot(_WEIGHTS[-counted.size :], counted)
    return bool(first == body[-2] and second == body[-1])


@dataclass(slots=True)
class _Epoch:
    """What the messages of one time of week have said so far."""

    itow_ms: int
    fix: Fix | None = None
    added: dict[str, Any] = field(default_factory=dict)  # fields of the fix by other messages

    def whole(self) -> list[Fix]:
        """The fix of the epoch with all that was added, or nothing."""
        return [] if self.fix is None else [self.fix._replace(**self.added)]


class UbxParser:
    """Fixes from a stream of bytes; a fix comes once its epoch is over.

    A fix is a NAV-PVT with what NAV-HPPOSLLH, NAV-DOP and NAV-RELPOSNED of the same time of
    week add. Its epoch is over at NAV-EOE, or when the next one but one begins. The heading is
    that from the base antenna to this one, where both ride on the vehicle (moving base, fixed
    ambiguities), else the receiver's own of the vehicle (fused with inertial sensors).
    """

    def __init__(self) -> None:
        self.counts = UbxCounts()
        self._framer = _Framer(self.counts)
        self._open: list[_Epoch] = []
        self._done: list[Fix] = []
        self._handlers: dict[bytes, Callable[[bytes], None]] = {
            b"\x01\x04": self._dop,
            b"\x01\x07": self._pvt,
            b"\x01\x14": self._hpposllh,
            b"\x01\x3c": self._relposned,
            b"\x01\x61": self._end_of_epoch,
        }

    def feed(self, data: bytes) -> list[Fix]:
        """The fixes that are complete with these bytes."""
        return self._take(self._framer.feed(data))

    def close(self) -> list[Fix]:
        """The fixes that were still open when the stream ended."""
        return self._take(self._framer.close()) + self._finish(len(self._open))

    def _take(self, messages: Iterator[tuple[bytes, bytes]]) -> list[Fix]:
        for kind, payload in messages:
            handler = self._handlers.get(kind)
            if handler is not None:
                try:
                    handler(payload)
                except (ValueError, struct.error):
                    self.counts.broken += 1
        done, self._done = self._done, []
        return done

    def _epoch(self, itow_ms: int) -> _Epoch:
        """The open epoch of a time of week, or a new one, which ends an old one."""
        for epoch in reversed(self._open):
            if epoch.itow_ms == itow_ms:
                return epoch
        self._open.append(_Epoch(itow_ms))
        self._done += self._finish(len(self._open) - 1 - _LATE_EPOCHS)
        return self._open[-1]

    def _finish(self, count: int) -> list[Fix]:
        """The fixes of the first `count` open epochs, which are closed."""
        over, self._open = self._open[: max(count, 0)], self._open[max(count, 0) :]
        return [fix for epoch in over for fix in epoch.whole()]

    def _pvt(self, payload: bytes) -> None:
        if len(payload) < _PVT_BYTES:
            raise ValueError(len(payload))
        fields = _PVT.unpack_from(payload)
        itow_ms, civil, valid, nano = fields[0], fields[1:7], fields[7], fields[8]
        kind, flags, satellites, lon, lat, height, accuracy = fields[9:16]
        speed, course, heading_accuracy, flags3 = fields[16:]
        if kind in (_NO_FIX, _TIME_ONLY) or valid & 3 != 3 or flags3 & 1:
            self.counts.no_position += 1
            return
        epoch = self._epoch(itow_ms)
        if epoch.fix is not None:
            self.counts.repeated += 1
            return
        age = flags3 >> 1 & 15
        year, month, day, hour, minute, second = civil
        if not (FIRST_YEAR <= year <= LAST_YEAR and hour < 24 and minute < 60 and second <= 60):
            raise ValueError(civil)
        if abs(nano) > 1_000_000_000:
            raise ValueError(nano)
        days = date(year, month, day).toordinal() - _UNIX_DAY
        epoch.fix = Fix(
            time_ns=((days * _DAY_S + (hour * 60 + minute) * 60 + second) * 1_000_000_000 + nano),
            lat_deg=_within(lat / 1e7, 90.0),
            lon_deg=_within(lon / 1e7, 180.0),
            height_m=height / 1e3,
            quality=_quality(kind, flags),
            satellites=satellites,
            age_s=_AGE_S[min(age, len(_AGE_S) - 1)],
            sigma_m=_per_axis(accuracy / 1e3),
            speed_mps=abs(speed) / 1e3,
            course_deg=_wrapped_deg(course),
        )
        if flags >> 5 & 1 and len(payload) >= _HEAD_VEHICLE.size:
            (vehicle,) = _HEAD_VEHICLE.unpack_from(payload)
            own = {
                "heading_deg": _wrapped_deg(vehicle),
                "heading_sigma_deg": heading_accuracy / 1e5,
            }
            epoch.added = own | epoch.added

    def _hpposllh(self, payload: bytes) -> None:
        version, flags, itow_ms, lon, lat, height, lon_hp, lat_hp, height_hp, accuracy = (
            _HPPOSLLH.unpack(payload)
        )
        if version == 0 and not flags & 1:
            self._epoch(itow_ms).added |= {
                "lat_deg": _within((100 * lat + lat_hp) / 1e9, 90.0),
                "lon_deg": _within((100 * lon + lon_hp) / 1e9, 180.0),
                "height_m": (10 * height + height_hp) / 1e4,
                "sigma_m": _per_axis(accuracy / 1e4),
            }

    def _relposned(self, payload: bytes) -> None:
        if payload[:1] != b"\x01" or len(payload) != _RELPOSNED.size:
            return  # version 0 has no heading
        _, itow_ms, *rough, heading, north, east, down, down_sigma, sigma, flags = (
            _RELPOSNED.unpack(payload)
        )
        # Without a moving base it is the direction from a base at the field's edge.
        if flags & _ATTITUDE == _ATTITUDE and flags >> 3 & 3 == _FIXED:
            apart_mm = [
                cm * 10.0 + rest / 10.0 for cm, rest in zip(rough, (north, east, down), strict=True)
            ]
            pitch_deg, tilt_sigma_deg = _pitch_deg(apart_mm, down_sigma / 10.0)
            self._epoch(itow_ms).added |= {
                "heading_deg": _wrapped_deg(heading),
                "heading_sigma_deg": sigma / 1e5,
                "heading_quality": Quality.RTK_FIXED,
                "pitch_deg": pitch_deg,
                "tilt_sigma_deg": None if flags & _NORMALISED else tilt_sigma_deg,
            }
        else:
            self.counts.unfixed_headings += 1

    def _dop(self, payload: bytes) -> None:
        itow_ms, hdop = _DOP.unpack(payload)
        self._epoch(itow_ms).added["hdop"] = hdop / 100.0

    def _end_of_epoch(self, payload: bytes) -> None:
        (itow_ms,) = _ITOW.unpack(payload)
        if self._open and self._open[-1].itow_ms == itow_ms:
            self._done += self._finish(len(self._open))


def _quality(kind: int, flags: int) -> Quality:
    """The quality of a fix type and its flags."""
    if not flags & 1:
        return Quality.NONE  # the receiver's own masks do not let it pass
    if kind == _DEAD_RECKONING:
        return Quality.ESTIMATED
    carrier = flags >> 6
    if carrier in (_FLOAT, _FIXED):
        return Quality.RTK_FIXED if carrier == _FIXED else Quality.RTK_FLOAT
    return Quality.DIFFERENTIAL if flags & 2 else Quality.GPS


def _per_axis(accuracy_m: float) -> float:
    """1 sigma along one axis of u-blox's accuracy, which is the root of both variances."""
    return accuracy_m / math.sqrt(2.0)


def _pitch_deg(apart_mm: list[float], down_sigma_mm: float) -> tuple[float | None, float | None]:
    """How much a baseline north, east, down rises, and its sigma; None for one of no length."""
    north, east, down = apart_mm
    long_mm = math.sqrt(north * north + east * east + down * down)
    if not long_mm:
        return None, None
    pitch_deg = math.degrees(math.atan2(-down, math.hypot(north, east)))
    return pitch_deg, math.degrees(math.atan2(down_sigma_mm, long_mm)) or None


def _wrapped_deg(field: int) -> float:
    return float(wrap_deg(field / 1e5))


def _within(angle_deg: float, limit_deg: float) -> float:
    if abs(angle_deg) > limit_deg:
        raise ValueError(angle_deg)
    return angle_deg
