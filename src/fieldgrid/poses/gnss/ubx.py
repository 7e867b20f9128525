"""UBX, the binary protocol of u-blox receivers, to fixes, whatever lies between the messages.

A message is B5 62, class, id, length, payload and Fletcher's checksum. Where the checksum does
not hold, the search goes on right behind the two sync bytes: a corrupt length swallows nothing.
The result does not depend on how the bytes arrive, and little more than one message is held.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldgrid.core import Quality
from fieldgrid.geometry import Fix, wrap_deg
from fieldgrid.poses.gnss.fields import DAY_NS, StreamCounts, clock_ns, day_number

_SYNC = b"\xb5\x62"
_FRAME = 8  # bytes around a payload
_MAX_PAYLOAD = 4096  # the longest, raw measurements of 92 signals, has 2960
_WEIGHTS = (np.arange(_MAX_PAYLOAD + 4, 0, -1) % 256).astype(np.uint8)

# iTOW, date and time, valid, nano; fixType, flags, satellites, lon, lat, height; hAcc;
# gSpeed, headMot; headAcc; flags3; headVeh (its last field is missing in u-blox 7).
_PVT = struct.Struct("<IHBBBBBB4xi BBxB iii 4xI 16x ii 4xI 2xH 4x")
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
_CARRIER = {1: Quality.RTK_FLOAT, 2: Quality.RTK_FIXED}
# RELPOSNED: fix and relative position valid, the base moves along, its heading valid.
_ATTITUDE = 1 << 0 | 1 << 2 | 1 << 5 | 1 << 8
_NORMALISED = 1 << 9  # the relative position has the length 1


@dataclass(slots=True)
class UbxCounts(StreamCounts):
    """Of a stream of messages.

    `messages` counts the intact ones of any kind; a solution without a time has no position,
    either. `unfixed_headings` counts relative positions from which no heading is taken: ambiguities
    not fixed, or a base that does not ride on the vehicle.
    """

    messages: int = 0
    unfixed_headings: int = 0


class UbxParser:
    """Fixes from a stream of bytes; a fix comes once its epoch is over.

    A fix is a NAV-PVT with what NAV-HPPOSLLH, NAV-DOP and NAV-RELPOSNED of the same time of
    week add. Its epoch is over at NAV-EOE, or when the next one but one begins. The heading is
    that from the base antenna to this one, where both ride on the vehicle (moving base, fixed
    ambiguities), else the receiver's own of the vehicle (fused with inertial sensors).
    """

    def __init__(self) -> None:
        self.counts = UbxCounts()
        self._held = b""
        # Of each time of week what NAV-PVT says of the fix, and what others add, the oldest first.
        self._open: dict[int, tuple[dict[str, Any], dict[str, Any]]] = {}
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
        self._read(data, last=False)
        done, self._done = self._done, []
        return done

    def close(self) -> list[Fix]:
        """The fixes that were still open when the stream ended."""
        self._read(b"", last=True)
        self._finish(len(self._open))
        done, self._done = self._done, []
        return done

    def _read(self, data: bytes, *, last: bool) -> None:
        """Read the messages that are whole by now, and keep the rest unless it is the last."""
        held, at = self._held + data, 0
        while (start := held.find(_SYNC, at)) >= 0:
            length = int.from_bytes(held[start + 4 : start + 6], "little")
            stop = start + _FRAME + length
            if length <= _MAX_PAYLOAD and stop > len(held) and not last:
                at = start
                break
            if length <= _MAX_PAYLOAD and stop <= len(held) and _checks(held[start + 2 : stop]):
                self.counts.messages += 1
                at = stop
                handler = self._handlers.get(held[start + 2 : start + 4])
                if handler is not None:
                    try:
                        handler(held[start + 6 : stop - 2])
                    except (ValueError, struct.error):
                        self.counts.broken += 1
            else:
                self.counts.bad_checksum += 1
                at = start + 2
        # Without a sync the last byte may be the first half of one, unless it is used already.
        self._held = held[at:] if start >= 0 else held[max(at, len(held) - 1) :]

    def _epoch(self, itow_ms: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """The open epoch of a time of week, or a new one, which ends the one before the last: a
        message may come one epoch late."""
        if itow_ms not in self._open:
            self._open[itow_ms] = {}, {}
            self._finish(len(self._open) - 2)
        return self._open[itow_ms]

    def _finish(self, count: int) -> None:
        """Close the first `count` open epochs."""
        for itow_ms in list(self._open)[: max(count, 0)]:
            fix, added = self._open.pop(itow_ms)
            if fix:
                self._done.append(Fix(**fix | added))

    def _pvt(self, payload: bytes) -> None:
        itow_ms, *civil, valid, nano, kind, flags, satellites, lon, lat, height, accuracy = (
            _PVT.unpack_from(payload)[:16]
        )
        speed, course, heading_accuracy, flags3 = _PVT.unpack_from(payload)[16:]
        if kind in (_NO_FIX, _TIME_ONLY) or valid & 3 != 3 or flags3 & 1:
            self.counts.no_position += 1
            return
        fix, _ = self._epoch(itow_ms)
        if fix:
            self.counts.repeated += 1
            return
        if abs(nano) > 1_000_000_000:
            raise ValueError(nano)
        fix |= {
            "time_ns": day_number(*civil[:3]) * DAY_NS + clock_ns(*civil[3:]) + nano,
            "lat_deg": _within(lat / 1e7, 90.0),
            "lon_deg": _within(lon / 1e7, 180.0),
            "height_m": height / 1e3,
            "quality": _quality(kind, flags),
            "satellites": satellites,
            "age_s": _AGE_S[min(flags3 >> 1 & 15, len(_AGE_S) - 1)],
            "sigma_m": accuracy / 1e3 / math.sqrt(2.0),  # it is the root of both variances
            "speed_mps": abs(speed) / 1e3,
            "course_deg": _wrapped_deg(course),
        }
        if flags >> 5 & 1 and len(payload) >= _HEAD_VEHICLE.size:
            (vehicle,) = _HEAD_VEHICLE.unpack_from(payload)
            fix["heading_deg"] = _wrapped_deg(vehicle)
            fix["heading_sigma_deg"] = heading_accuracy / 1e5

    def _hpposllh(self, payload: bytes) -> None:
        version, flags, itow_ms, lon, lat, height, lon_hp, lat_hp, height_hp, accuracy = (
            _HPPOSLLH.unpack(payload)
        )
        if version == 0 and not flags & 1:
            added = self._epoch(itow_ms)[1]
            added |= {
                "lat_deg": _within((100 * lat + lat_hp) / 1e9, 90.0),
                "lon_deg": _within((100 * lon + lon_hp) / 1e9, 180.0),
                "height_m": (10 * height + height_hp) / 1e4,
                "sigma_m": accuracy / 1e4 / math.sqrt(2.0),
            }

    def _relposned(self, payload: bytes) -> None:
        if payload[:1] != b"\x01" or len(payload) != _RELPOSNED.size:
            return  # version 0 has no heading
        _, itow_ms, *rough, heading, north, east, down, down_sigma, sigma, flags = (
            _RELPOSNED.unpack(payload)
        )
        # Without a moving base it is the direction from a base at the field's edge.
        if flags & _ATTITUDE != _ATTITUDE or _CARRIER.get(flags >> 3 & 3) != Quality.RTK_FIXED:
            self.counts.unfixed_headings += 1
            return
        north, east, down = (
            cm * 10.0 + rest / 10.0 for cm, rest in zip(rough, (north, east, down), strict=True)
        )
        level_mm = math.hypot(north, east)
        long_mm = math.hypot(level_mm, down)  # 0 without a baseline
        told = long_mm and not flags & _NORMALISED
        sigma_deg = math.degrees(math.atan2(down_sigma / 10.0, long_mm))
        added = self._epoch(itow_ms)[1]
        added |= {
            "heading_deg": _wrapped_deg(heading),
            "heading_sigma_deg": sigma / 1e5,
            "heading_quality": Quality.RTK_FIXED,
            "pitch_deg": math.degrees(math.atan2(-down, level_mm)) if long_mm else None,
            "tilt_sigma_deg": (sigma_deg or None) if told else None,
        }

    def _dop(self, payload: bytes) -> None:
        itow_ms, hdop = _DOP.unpack(payload)
        self._epoch(itow_ms)[1]["hdop"] = hdop / 100.0

    def _end_of_epoch(self, payload: bytes) -> None:
        (itow_ms,) = _ITOW.unpack(payload)
        if self._open and next(reversed(self._open)) == itow_ms:
            self._finish(len(self._open))


def _checks(body: bytes) -> bool:
    """Whether a message from its class to its checksum is intact. Everything is modulo 256."""
    counted = np.frombuffer(body, np.uint8, len(body) - 2)
    first = sum(body[:-2]) % 256
    second = np.dot(_WEIGHTS[-counted.size :], counted)
    return bool(first == body[-2] and second == body[-1])


def _quality(kind: int, flags: int) -> Quality:
    """The quality of a fix type and its flags."""
    if not flags & 1:
        return Quality.NONE  # the receiver's own masks do not let it pass
    if kind == _DEAD_RECKONING:
        return Quality.ESTIMATED
    return _CARRIER.get(flags >> 6, Quality.DIFFERENTIAL if flags & 2 else Quality.GPS)


def _wrapped_deg(field: int) -> float:
    return float(wrap_deg(field / 1e5))


def _within(angle_deg: float, limit_deg: float) -> float:
    if abs(angle_deg) > limit_deg:
        raise ValueError(angle_deg)
    return angle_deg
