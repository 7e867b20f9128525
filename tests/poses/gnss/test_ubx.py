"""UBX: frames out of any bytes, and epochs out of messages."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import Fix
from fieldgrid.poses import UbxParser
from tests.poses.gnss.sentences import parse_ubx

SharedData = Callable[[str], Path]

START_NS = 1_717_243_200_000_000_000  # 2024-06-01 12:00:00
ITOW_MS = 561_618_000
FIXED, FLOATING, CORRECTED = 2 << 6 | 3, 1 << 6 | 3, 3


def message(kind: tuple[int, int], payload: bytes) -> bytes:
    body = bytes(kind) + len(payload).to_bytes(2, "little") + payload
    first = second = 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return b"\xb5\x62" + body + bytes((first, second))


def pvt(second: int = 0, itow_ms: int = ITOW_MS, length: int = 92, **changes: Any) -> bytes:
    said = {
        "year": 2024, "month": 6, "valid": 7, "nano": 0, "kind": 3, "flags": 1, "satellites": 17,
        "lon": -4_7200000_0 // 10, "lat": 41_6500000, "height": 787_400, "accuracy": 1414,
        "speed": 1500, "course": 270_00000, "flags3": 0, "vehicle": 0, **changes,
    }  # fmt: skip
    payload = struct.pack(
        "<IHBBBBBBIiBBBBiiiiIIiiiiiIIHHIiHH",
        itow_ms, said["year"], said["month"], 1, 12, 0, second, said["valid"], 20, said["nano"],
        said["kind"], said["flags"], 0, said["satellites"], said["lon"], said["lat"],
        said["height"], 735_000, said["accuracy"], 900, 0, 0, 0, said["speed"], said["course"],
        50, 2_00000, 130, said["flags3"], 0, said["vehicle"], 0, 0,
    )  # fmt: skip
    assert len(payload) == 92
    return message((1, 7), payload[:length])


def hpposllh(itow_ms: int = ITOW_MS, version: int = 0, flags: int = 0) -> bytes:
    return message(
        (1, 0x14),
        struct.pack(
            "<BHBIiiiibbbbII", version, 0, flags, itow_ms, -47200000, 416500000, 787400, 735000,
            -12, 34, 5, 6, 141, 200,
        ),
    )  # fmt: skip


def relposned(
    itow_ms: int = ITOW_MS,
    flags: int = 0b1_0011_0111,
    version: int = 1,
    ned_cm: tuple[int, int, int] = (0, 0, 0),
    ned_tenths_mm: tuple[int, int, int] = (0, 0, 0),
) -> bytes:
    return message(
        (1, 0x3C),
        struct.pack(
            "<BBHIiiiiiIbbbbIIIIIII", version, 0, 0, itow_ms, *ned_cm, 100, 350_00000, 0,
            *ned_tenths_mm, 0, 100, 110, 120, 130, 40000, 0, flags,
        ),
    )  # fmt: skip


def dop(itow_ms: int = ITOW_MS) -> bytes:
    return message((1, 4), struct.pack("<IHHHHHHH", itow_ms, 1, 2, 3, 4, 71, 6, 7))


def end_of_epoch(itow_ms: int = ITOW_MS) -> bytes:
    return message((1, 0x61), struct.pack("<I", itow_ms))


PLAIN = Fix(
    START_NS, 41.65, -4.72, 787.4, 1, 17, sigma_m=1.414 / math.sqrt(2), speed_mps=1.5,
    course_deg=-90.0,
)  # fmt: skip


def only(data: bytes) -> Fix:
    (fix,) = parse_ubx([data]).fixes
    return fix


def test_a_pvt_is_a_fix() -> None:
    assert only(pvt()) == PLAIN


def test_high_precision_dop_and_heading_of_the_epoch_add_to_it() -> None:
    fix = only(pvt(flags=FIXED) + hpposllh() + dop() + relposned())
    assert fix == PLAIN._replace(
        quality=4, lat_deg=41.650000034, lon_deg=-4.720000012, height_m=787.4005, hdop=0.71,
        sigma_m=pytest.approx(0.0141 / math.sqrt(2)), heading_deg=-10.0, heading_sigma_deg=0.4,
        heading_quality=4,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "quality"),
    [
        ({"flags": 1}, 1),
        ({"flags": CORRECTED}, 2),
        ({"flags": FLOATING}, 5),
        ({"flags": FIXED}, 4),
        ({"flags": FIXED & ~1}, 0),
        ({"kind": 1}, 6),
        ({"kind": 4, "flags": FIXED}, 4),
    ],
)
def test_flags_make_the_quality(changes: dict[str, int], quality: int) -> None:
    assert only(pvt(**changes)).quality == quality


@pytest.mark.parametrize("changes", [{"kind": 0}, {"kind": 5}, {"valid": 1}, {"flags3": 1}])
def test_solutions_without_position_or_time_are_counted(changes: dict[str, int]) -> None:
    log = parse_ubx([pvt(**changes)])
    assert (log.fixes, log.no_position, log.broken) == ([], 1, 0)


@pytest.mark.parametrize(
    "changes",
    [{"lat": 900000001}, {"lon": -1800000001}, {"month": 13}, {"year": 1979}, {"length": 83}],
)
def test_messages_that_say_what_cannot_be_are_broken(changes: dict[str, int]) -> None:
    log = parse_ubx([pvt(**changes)])
    assert (log.fixes, log.broken) == ([], 1)


def test_nanoseconds_may_lie_before_the_second() -> None:
    assert only(pvt(second=1, nano=-250)).time_ns == START_NS + 999_999_750


def test_the_age_of_corrections_is_the_upper_end_of_its_step() -> None:
    assert only(pvt(flags3=4 << 1)).age_s == 10.0
    assert only(pvt(flags3=15 << 1)).age_s == 120.0


def test_a_u_blox_7_has_a_shorter_pvt() -> None:
    assert only(pvt(length=84)) == PLAIN


def test_a_fused_heading_is_taken_where_it_is_valid_and_yields_to_two_antennas() -> None:
    fused = pvt(flags=1 | 1 << 5, vehicle=90_00000)
    fix = only(fused)
    assert (fix.heading_deg, fix.heading_sigma_deg, fix.heading_quality) == (90.0, 2.0, None)
    assert fix.pitch_deg is None
    assert only(fused + relposned()).heading_deg == -10.0


def test_two_antennas_tell_how_the_way_between_them_rises() -> None:
    # 1.20 m long and 10.5 cm up: the second antenna is the higher one.
    fix = only(pvt() + relposned(ned_cm=(118, -20, -10), ned_tenths_mm=(0, 0, -50)))
    assert fix.pitch_deg == pytest.approx(math.degrees(math.atan2(0.105, math.hypot(1.18, 0.20))))
    # 12 mm over that length
    assert fix.tilt_sigma_deg == pytest.approx(math.degrees(0.012 / 1.2014), rel=1e-3)
    assert fix.roll_deg is None
    lower = only(pvt() + relposned(ned_cm=(118, -20, 10), ned_tenths_mm=(0, 0, 50)))
    assert lower.pitch_deg == pytest.approx(-fix.pitch_deg)


def test_a_relative_position_of_length_one_has_no_sigma_of_its_rise() -> None:
    fix = only(pvt() + relposned(flags=0b11_0011_0111, ned_cm=(99, 0, -17)))
    assert (fix.pitch_deg, fix.tilt_sigma_deg) == (pytest.approx(9.744, abs=0.01), None)


@pytest.mark.parametrize(
    "flags",
    [
        0b0_0011_0111,  # heading not valid
        0b1_0000_0111 | 1 << 5 | 1 << 3,  # ambiguities float
        0b1_0001_0111,  # the base stands: the direction is not that of a vehicle
        0b1_0011_0011,  # relative position not valid
    ],
)
def test_a_relative_position_that_is_no_heading(flags: int) -> None:
    log = parse_ubx([pvt() + relposned(flags=flags)])
    assert (log.fixes[0].heading_deg, log.unfixed_headings) == (None, 1)


def test_versions_that_are_not_known_add_nothing() -> None:
    assert only(pvt() + hpposllh(version=1) + relposned(version=0)) == PLAIN
    assert only(pvt() + hpposllh(flags=1)) == PLAIN


def test_messages_may_come_an_epoch_late() -> None:
    log = parse_ubx([pvt() + pvt(1, ITOW_MS + 1000) + relposned() + pvt(2, ITOW_MS + 2000)])
    assert [fix.heading_deg for fix in log.fixes] == [-10.0, None, None]


def test_a_repeated_position_is_counted() -> None:
    log = parse_ubx([pvt() + pvt(lat=0)])
    assert (log.fixes, log.repeated) == ([PLAIN], 1)


def test_a_fix_comes_as_soon_as_its_epoch_is_over() -> None:
    parser = UbxParser()
    assert parser.feed(pvt()) == []
    assert parser.feed(end_of_epoch()) == [PLAIN]
    assert parser.feed(pvt(1, ITOW_MS + 1000)) == []
    assert parser.feed(pvt(2, ITOW_MS + 2000)) == []
    assert len(parser.feed(pvt(3, ITOW_MS + 3000))) == 1
    assert len(parser.close()) == 2


def test_corrupt_lengths_and_checksums_swallow_nothing() -> None:
    good = pvt()
    wrong = bytearray(good)
    wrong[10] ^= 1
    lying = b"\xb5\x62\x01\x07\xff\x0f"  # 4095 bytes that are not there
    too_long = b"\xb5\x62\x01\x07\xff\xff"
    log = parse_ubx([bytes(wrong) + lying + too_long + b"\xb5" + good + b"\xb5\x62\x01"])
    assert log.fixes == [PLAIN]
    assert log.bad_checksum == 4


STREAM = b"".join(
    pvt(k, ITOW_MS + 1000 * k) + hpposllh(ITOW_MS + 1000 * k) + b"$GPGSV,x*00\r\n\xb5"
    for k in range(4)
)


@settings(deadline=None)
@given(st.lists(st.integers(0, len(STREAM)), max_size=20))
def test_the_result_does_not_depend_on_how_bytes_arrive(cuts: list[int]) -> None:
    places = [0, *sorted(cuts), len(STREAM)]
    chunks = [STREAM[a:b] for a, b in pairwise(places)]
    assert parse_ubx(chunks) == parse_ubx([STREAM])
    assert len(parse_ubx(chunks).fixes) == 4


@settings(deadline=None)
@given(st.binary(max_size=200), st.binary(max_size=200), st.integers(1, 300))
def test_garbage_around_costs_nothing(before: bytes, after: bytes, step: int) -> None:
    data = before + STREAM + after
    log = parse_ubx(data[k : k + step] for k in range(0, len(data), step))
    assert log == parse_ubx([data])
    assert len(log.fixes) >= 3  # the end of `before` may start a frame that swallows none


@settings(deadline=None)
@given(st.binary(max_size=120), st.sampled_from([(1, 4), (1, 7), (1, 0x14), (1, 0x3C), (1, 0x61)]))
def test_any_payload_is_survived(payload: bytes, kind: tuple[int, int]) -> None:
    for fix in parse_ubx([message(kind, payload) + pvt()]).fixes:
        assert abs(fix.lat_deg) <= 90.0
        assert abs(fix.lon_deg) <= 180.0


def test_accuracy_is_that_of_both_axes_together(shared_data: SharedData) -> None:
    """NAV-COV of the same epoch has the variances: their root sum is NAV-PVT's accuracy."""
    data = (shared_data("gnss/nmea_misc") / "pyubx2_pygpsdata-NAV.log").read_bytes()
    at = data.find(b"\xb5\x62\x01\x36") + 6
    north, _, _, east, _, _ = struct.unpack_from("<6f", data, at + 16)
    (fix,) = parse_ubx([data]).fixes
    assert fix.sigma_m == pytest.approx(math.sqrt((north + east) / 2.0), abs=1e-3)


def test_real_receivers_are_read(shared_data: SharedData) -> None:
    folder = shared_data("gnss/gpsd_corpus")
    for name, count in (("ublox-zed-f9p-hp", 29), ("ublox-neo-m8n", 24), ("ublox-zed-f9r", 30)):
        data = (folder / f"{name}.log").read_bytes()
        assert len(parse_ubx([data]).fixes) == count


def test_a_last_byte_that_was_used_begins_no_other_message() -> None:
    """A checksum that ends in B5 before a stray 62: the pair is no start of a message."""
    ending = next(
        m for k in range(1 << 16) if (m := message((6, 1), k.to_bytes(2, "little")))[-1] == 0xB5
    )
    data = ending + b"\x62" + pvt()
    whole = parse_ubx([data])
    assert (whole.messages, whole.bad_checksum) == (2, 0)
    for k in range(len(data)):
        assert parse_ubx([data[:k], data[k:]]) == whole
