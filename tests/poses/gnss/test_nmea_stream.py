"""Fixes from bytes as they come: when they are given, what is kept, what garbage cannot do."""

from __future__ import annotations

import tracemalloc
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from fieldgrid.geometry import Fix
from fieldgrid.poses import NmeaStream
from tests.poses.gnss.sentences import JUNE_15, NOON, SECOND, gga, parse, parse_nmea, rmc, sentence


def epoch(k: int) -> list[bytes]:
    """All sentences of one second, as a busy receiver mixes them."""
    time = f"1200{k:02}"
    return [
        gga(time, quality="4" if k % 5 else "5"),
        sentence("GNGSA,A,3,01,02,03,04,05,06,07,08,,,,,1.2,0.7,1.0"),
        sentence("GPGSV,1,1,01,02,45,123,44"),
        rmc(time),
        sentence(f"GNVTG,{k},T,,M,3.0,N,5.6,K,R"),
        sentence(f"GNGST,{time},0.4,0.3,0.2,7.6,0.01,0.02,0.03"),
        sentence(f"GNHPR,{time},{k}.5,1.0,0.0,4,47,0.00,0999"),
        sentence(f"PTNL,GGK,{time},061511,4139.02,N,00443.21,W,3,09,1.9,EHT790.3,M"),
        b"\xb5\x62\x01\x07$\x00#\x24\xd3\x00\x13",
    ]


PARTS = [part for k in range(12) for part in epoch(k)]
LOG = b"".join(PARTS)
FIXES = parse(LOG)


def stream(*chunks: bytes, **settings: int) -> list[Fix]:
    parser = NmeaStream(**settings)
    return [fix for chunk in chunks for fix in parser.feed(chunk)] + parser.finish()


def test_the_log_of_these_tests_is_read_whole() -> None:
    assert len(FIXES) == 12
    said = ("heading_sigma_deg", "roll_deg", "tilt_sigma_deg", "stamp_sigma_s")
    assert all(None not in fix._replace(**dict.fromkeys(said, 0.0)) for fix in FIXES)


# --- properties


@given(st.lists(st.integers(0, len(LOG)), max_size=60), st.integers(1, 4))
def test_fixes_do_not_depend_on_how_bytes_are_cut(cuts: list[int], late_epochs: int) -> None:
    edges = [0, *sorted(cuts), len(LOG)]
    chunks = [LOG[a:b] for a, b in pairwise(edges)]
    assert stream(*chunks, late_epochs=late_epochs) == FIXES


def test_a_stream_may_come_byte_by_byte() -> None:
    assert stream(*(LOG[k : k + 1] for k in range(len(LOG)))) == FIXES


GARBAGE = st.one_of(
    st.binary(max_size=80),
    st.text("$#*,.;0123456789ABGPRMCNSEWV\r\n", max_size=40).map(str.encode),
    st.sampled_from([b"$GPGGA,120003,41", b"#BESTNAVA,97;SOL", b"$", b"#", b"*00", b"\x1f\x8b"]),
)


@given(st.dictionaries(st.integers(0, len(PARTS)), GARBAGE, max_size=12))
def test_garbage_between_sentences_changes_no_fix(garbage: dict[int, bytes]) -> None:
    mixed = [garbage.get(k, b"") + part for k, part in enumerate(PARTS)]
    assert stream(b"".join(mixed), garbage.get(len(PARTS), b"")) == FIXES


@given(st.integers(0, len(LOG)), st.integers(0, len(LOG)))
def test_a_log_cut_anywhere_gives_only_fixes_that_the_whole_one_has(a: int, b: int) -> None:
    start, end = sorted((a, b))
    places = {fix[:5] for fix in FIXES}
    times = {fix.time_ns for fix in FIXES}
    for fix in stream(LOG[start:end]):
        # Where it is GGA that is cut off, GGK serves, and where that is cut off too, RMC.
        assert fix[:5] in places or (fix.time_ns in times and fix.height_m in (790.3, 0.0))


@given(st.lists(st.sampled_from(PARTS), max_size=60))
def test_sentences_in_any_order_are_read_in_peace(parts: list[bytes]) -> None:
    assert all(abs(fix.time_ns - NOON) <= 12 * SECOND for fix in stream(*parts))


# --- when


def test_a_fix_is_given_as_soon_as_its_epoch_is_closed() -> None:
    parser = NmeaStream(late_epochs=1)
    given_at = [[fix.time_ns for fix in parser.feed(b"".join(epoch(k)))] for k in range(3)]
    assert given_at == [[], [NOON], [NOON + SECOND]]
    assert [fix.time_ns for fix in parser.finish()] == [NOON + 2 * SECOND]
    assert parser.finish() == []


def test_a_line_is_read_when_it_ends() -> None:
    parser = NmeaStream(late_epochs=1)
    parser.feed(rmc("120000") + gga("120000") + gga("120001")[:-1])
    assert parser.feed(b"\n") != []


@pytest.mark.parametrize("settings", [{"late_epochs": 0}, {"max_undated": 0}])
def test_settings_that_cannot_be(settings: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="must be > 0"):
        NmeaStream(**settings)


# --- memory


def test_an_endless_stream_without_a_date_is_held_up_to_a_limit() -> None:
    parser = NmeaStream(max_undated=100)
    for k in range(3000):
        assert parser.feed(gga(f"12{k // 60:02}{k % 60:02}")) == []
    assert parser.counts.undated == 3000 - 4
    fixes = parser.feed(rmc("125000")) + parser.finish()
    assert len(fixes) == 100
    assert fixes[-1].time_ns == NOON + 2999 * SECOND


def test_positions_without_a_date_take_the_first_day_that_is_given_across_midnight() -> None:
    day = JUNE_15 // (86_400 * SECOND)
    fixes = stream(gga("235959"), gga("000000"), first_day=day)
    assert [(fix.time_ns - JUNE_15) // SECOND for fix in fixes] == [86_399, 86_400]
    assert stream(rmc("120000"), gga("120000"), first_day=3)[0].time_ns == NOON


def test_an_endless_stream_takes_no_memory() -> None:
    noise = bytes(range(256)) * 40 + b"$GPGGA," + b"1" * 5000 + b"#BESTNAVA," + b"2" * 5000
    parser = NmeaStream(max_undated=10)
    tracemalloc.start()
    for k in range(300):
        parser.feed(noise + b"".join(epoch(k % 60)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


# --- what sentences are for


def test_gsa_gives_the_hdop_that_gga_lacks() -> None:
    body = "GPGGA,120000,4139.0,N,00443.0,W,1,08,,735.0,M,52.4,M,,"
    gsa = sentence("GPGSA,A,3,01,02,03,04,05,06,07,08,,,,,2.1,1.3,1.6")
    (fix,) = parse(rmc("120000"), sentence(body), gsa)
    assert fix.hdop == 1.3
    (fix,) = parse(rmc("120000"), gga("120000"), gsa)
    assert fix.hdop == 0.7


def test_gsa_can_say_that_there_is_no_fix() -> None:
    none, flat = (sentence(f"GNGSA,A,{mode},,,,,,,,,,,,,99.9,99.9,99.9") for mode in (1, 2))
    assert parse(rmc("120000"), gga("120000"), none) == []
    # One of several constellations may have none.
    assert len(parse(rmc("120000"), gga("120000"), none, flat)) == 1
    assert len(parse(rmc("120000"), gga("120000"), flat, none)) == 1
    found = parse_nmea([rmc("120000"), gga("120000"), none])
    assert found.no_position == 1


def test_course_and_speed_come_from_rmc_or_else_from_vtg() -> None:
    full = sentence("GPRMC,120000,A,4139.02,N,00443.21,W,3.0,190.0,150611,,,R")
    vtg = sentence("GPVTG,12.0,T,,M,9.9,N,18.0,K,R")
    slow = sentence("GPVTG,12.0,T,,M,1.0,N,,,R")
    for parts, expected in (
        ((full, gga("120000"), vtg), (3.0 * 1852 / 3600, -170.0)),
        ((rmc("120000"), gga("120000"), vtg), (3.0 * 1852 / 3600, 12.0)),
        ((rmc("120000", speed=""), gga("120000"), vtg), (5.0, 12.0)),
        ((rmc("120000", speed=""), gga("120000"), slow), (1852 / 3600, 12.0)),
        ((rmc("120000", speed=""), gga("120000")), (None, None)),
    ):
        (fix,) = parse(*parts)
        assert (fix.speed_mps, fix.course_deg) == pytest.approx(expected)


def test_untimed_sentences_of_a_lost_epoch_do_not_replace_those_before() -> None:
    lost = [part for part in epoch(1) if b"120001" not in part]
    (fix, _) = parse(*epoch(0), *lost, *epoch(2))
    assert fix == FIXES[0]


@pytest.mark.parametrize("field", ["9" * 200, "nan", "inf", "1e5", "1_0", "--1", "0x10", " 1"])
def test_numbers_that_cannot_be_are_read_in_peace(field: str) -> None:
    for body in (
        f"GPGGA,120001,4139.0,N,00443.0,W,1,08,{field},735.0,M,52.4,M,,",
        f"GPGGA,120001,4139.0,N,00443.0,W,1,08,1.0,{field},M,52.4,M,,",
        f"GPGGA,120001,4139.0,N,00443.0,W,1,08,1.0,735.0,M,{field},M,,",
        f"GPGGA,120001,{field},N,00443.0,W,1,08,1.0,735.0,M,52.4,M,,",
        f"GPGGA,120001,4139.0,N,00443.0,W,{field},08,1.0,735.0,M,52.4,M,,",
    ):
        log = parse_nmea([rmc("120000"), gga("120000"), sentence(body)])
        assert (len(log.fixes), log.broken) == (1, 1)
    for body in (
        f"GPGST,120000,0.4,0.3,0.2,7.6,{field},0.4,0.5",
        f"GPRMC,120000,A,4139.0,N,00443.0,W,{field},,150611,,,A",
        f"GPVTG,{field},T,,M,9.9,N,99.9,K,R",
        f"GPHDT,{field},T",
    ):
        log = parse_nmea([rmc("120000"), gga("120000"), sentence(body)])
        assert (len(log.fixes), log.broken) == (1, 1)


# --- RMC alone


def alone(time: str, mode: str = "A", *, fields: str = "4139.02,N,00443.21,W") -> bytes:
    return sentence(f"GPRMC,{time},A,{fields},3.0,12.0,150611,,,{mode}")


def test_a_log_of_rmc_alone_gives_fixes_of_no_height() -> None:
    log = parse_nmea([alone(f"1200{k:02}", "D") for k in range(40)])
    assert (len(log.fixes), log.no_height) == (40, 40)
    assert [fix.time_ns for fix in log.fixes] == [NOON + k * SECOND for k in range(40)]
    fix = log.fixes[0]
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((41 + 39.02 / 60, -4 - 43.21 / 60))
    assert (fix.height_m, fix.quality, fix.satellites, fix.course_deg) == (0.0, 2, None, 12.0)


@pytest.mark.parametrize(
    ("mode", "quality"), [("A", 1), ("D", 2), ("P", 3), ("R", 4), ("F", 5), ("E", 6), ("", -1)]
)
def test_the_mode_of_rmc_is_a_quality(mode: str, quality: int) -> None:
    assert [fix.quality for fix in parse(alone("120000", mode))] == [quality]


def test_rmc_that_has_no_position_gives_none() -> None:
    assert parse(alone("120000", "N")) == []
    assert parse(alone("120000", fields=",,,")) == []
    log = parse_nmea([alone("120000", fields="9139.02,N,00443.21,W")])
    assert (log.fixes, log.broken) == ([], 1)


@pytest.mark.parametrize("late", [0, 1, 10])
def test_rmc_never_stands_in_for_a_lost_gga(late: int) -> None:
    rmcs = [alone(f"1200{k:02}") for k in range(late + 5)]
    log = parse_nmea([*rmcs[:late], rmcs[late] + gga(f"1200{late:02}"), *rmcs[late + 1 :]])
    assert [fix.time_ns for fix in log.fixes] == [NOON + late * SECOND]
    assert log.no_height == 0


def test_rmc_alone_is_believed_after_a_while() -> None:
    parser = NmeaStream(late_epochs=1)
    given_at = [len(parser.feed(alone(f"1200{k:02}"))) for k in range(25)]
    assert given_at == [0] * 20 + [20, 1, 1, 1, 1]
    # And no longer, once there is something better.
    later = [*parser.feed(gga("120030")), *parser.feed(alone("120031")), *parser.finish()]
    assert [fix.time_ns // SECOND % 60 for fix in later] == [24, 30]
