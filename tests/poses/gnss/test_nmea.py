"""NMEA logs to fixes."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from tests.poses.gnss.sentences import JUNE_15, NOON, SECOND, gga, parse, parse_nmea, rmc, sentence

# --- sentences to fixes


def test_a_fix_is_what_all_sentences_of_its_epoch_say() -> None:
    (fix,) = parse(
        gga("103011.20"),
        rmc("103011.20", speed="3.0"),
        sentence("GPVTG,12.0,T,,M,9.9,N,99.9,K,R"),
        sentence("GPGST,103011.20,0.4,0.3,0.2,7.6,0.3,0.4,0.5"),
        sentence("GPHDT,271.5,T"),
    )
    assert fix.time_ns == 1_308_133_811_200_000_000
    assert fix.lat_deg == pytest.approx(41 + 39.022737 / 60, abs=1e-12)
    assert fix.lon_deg == pytest.approx(-(4 + 43.214186 / 60), abs=1e-12)
    assert fix.height_m == pytest.approx(737.921 + 52.4)
    assert (fix.quality, fix.satellites, fix.hdop, fix.age_s) == (4, 12, 0.7, 1.5)
    assert fix.speed_mps == pytest.approx(3.0 * 1852 / 3600)
    assert fix.sigma_m == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
    assert fix.heading_deg == pytest.approx(-88.5)


def test_south_and_east() -> None:
    body = "GNGGA,120000,3330.0,S,15115.0,E,1,08,1.0,10.0,M,20.0,M,,"
    (fix,) = parse(sentence(body), rmc("120000"))
    assert (fix.lat_deg, fix.lon_deg) == (-33.5, 151.25)


@pytest.mark.parametrize("talker", ["GP", "GN", "GL", "GA", "GB", "BD", "QZ"])
def test_any_talker_is_heard(talker: str) -> None:
    assert len(parse(gga("120000", talker=talker), rmc("120000"))) == 1


def test_the_speed_of_vtg_serves_without_rmc() -> None:
    zda = sentence("GPZDA,120000,15,06,2011,00,00")
    (fix,) = parse(zda, gga("120000"), sentence("GPVTG,12.0,T,,M,1.9,N,3.6,K,R"))
    assert fix.time_ns == NOON
    assert fix.speed_mps == pytest.approx(1.0)


def test_ths_counts_only_while_it_is_valid() -> None:
    fixes = parse(
        gga("120000"), rmc("120000"), sentence("GNTHS,77.5,A"), gga("120001"),
        sentence("GNTHS,12.0,V"),
    )  # fmt: skip
    assert [fix.heading_deg for fix in fixes] == [77.5, None]


def test_a_late_sentence_finds_its_epoch() -> None:
    gst = sentence("GPGST,120000.0,0.4,0.3,0.2,7.6,0.3,0.3,0.5")
    first, second = parse(rmc("120000.0"), gga("120000.0"), gga("120000.2"), gst)
    assert first.sigma_m == pytest.approx(0.3)
    assert second.sigma_m is None


def test_untimed_sentences_after_a_lost_fix_are_not_given_to_the_fix_before() -> None:
    lost = sentence("GPGGA,120001,,,,,0,00,,,M,,M,,")
    (fix,) = parse(rmc("120000"), gga("120000"), lost, sentence("GPHDT,10.0,T"))
    assert fix.heading_deg is None


def test_no_position_is_counted_and_gives_no_fix() -> None:
    log = parse_nmea(
        [
            rmc("120000"),
            gga("120000", quality="0"),
            sentence("GPGGA,120001,,,,,1,00,,,M,,M,,"),
            sentence("GPGGA,,,,,,0,00,,,M,,M,,"),
            gga("120002"),
        ]
    )
    assert (len(log.fixes), log.no_position) == (1, 3)


def test_a_second_position_of_an_epoch_is_counted() -> None:
    log = parse_nmea([rmc("120000"), gga("120000"), gga("120000", talker="GN", lat="4140.0")])
    assert (len(log.fixes), log.repeated) == (1, 1)
    assert log.fixes[0].lat_deg < 41.66


def test_a_missing_geoid_separation_is_counted() -> None:
    body = "GPGGA,120000,4139.0,N,00443.0,W,1,08,1.0,735.0,M,,M,,"
    log = parse_nmea([rmc("120000"), sentence(body)])
    assert (log.fixes[0].height_m, log.no_geoid) == (735.0, 1)


# --- the date


def test_positions_without_any_date_are_counted() -> None:
    log = parse_nmea([gga("120000"), gga("120001"), rmc("120001", status="V")])
    assert (log.fixes, log.undated) == ([], 2)


def test_no_position_at_all_is_no_error() -> None:
    assert parse(sentence("GPVTG,,T,,M,,N,,K,N")) == []


def test_a_date_serves_the_fixes_before_it() -> None:
    fixes = parse(gga("120000"), gga("120001"), gga("120002"), rmc("120002"))
    assert [fix.time_ns for fix in fixes] == [NOON, NOON + SECOND, NOON + 2 * SECOND]


def test_midnight_begins_a_new_day_with_and_without_a_new_date() -> None:
    midnight = JUNE_15 + 24 * 3600 * SECOND
    plain = parse(gga("235959.8"), rmc("235959.8"), gga("000000.0"), gga("000000.2"))
    dated = parse(gga("235959.8"), gga("000000.0"), rmc("000000.0", "160611"), gga("000000.2"))
    for fixes in (plain, dated):
        assert [fix.time_ns - midnight for fix in fixes] == [-SECOND // 5, 0, SECOND // 5]


def test_a_straggler_from_before_midnight_keeps_its_day() -> None:
    fixes = parse(rmc("235959"), gga("235959"), gga("000000"), gga("235958"), gga("000001"))
    assert [(fix.time_ns - JUNE_15) // SECOND - 86400 for fix in fixes] == [-1, 0, -2, 1]


def test_a_pause_of_a_working_day_keeps_the_day() -> None:
    fixes = parse(rmc("060000"), gga("060000"), gga("200000"))
    assert fixes[1].time_ns - fixes[0].time_ns == 14 * 3600 * SECOND


def test_a_leap_second_is_read() -> None:
    fixes = parse(rmc("235959.5", "301216"), gga("235959.5"), gga("235960.5"))
    assert fixes[1].time_ns - fixes[0].time_ns == SECOND


# --- damage


def test_a_wrong_checksum_is_counted_and_not_used() -> None:
    log = parse_nmea([rmc("120000"), gga("120000").replace(b"4139", b"4138"), gga("120001")])
    assert (len(log.fixes), log.bad_checksum, log.broken) == (1, 1, 0)


def test_a_truncated_and_a_merged_line_cost_only_themselves() -> None:
    cut = gga("120001")[:30]
    log = parse_nmea([rmc("120000"), gga("120000"), cut + b"\r\n", cut + gga("120002")])
    assert [fix.time_ns for fix in log.fixes] == [NOON, NOON + 2 * SECOND]
    assert (log.bad_checksum, log.broken) == (0, 2)


@pytest.mark.parametrize(
    "body",
    [
        "GPGGA,120061,4139.0,N,00443.0,W,1,08,1.0,735.0,M,52.4,M,,",
        "GPGGA,126000,4139.0,N,00443.0,W,1,08,1.0,735.0,M,52.4,M,,",
        "GPGGA,120000,4160.0,N,00443.0,W,1,08,1.0,735.0,M,52.4,M,,",
        "GPGGA,120000,9139.0,N,00443.0,W,1,08,1.0,735.0,M,52.4,M,,",
        "GPGGA,120000,4139.0,X,00443.0,W,1,08,1.0,735.0,M,52.4,M,,",
        "GPGGA,120000,4139.0,N,00443.0,W,1,08,1.0,nan,M,52.4,M,,",
        "GPGGA,120000,4139.0,N,00443.0,W,-1,08,1.0,735.0,M,52.4,M,,",
        "GPRMC,120000,A,4139.0,N,00443.0,W,1.0,,310211,,,A",
        "GPZDA,120000,15,06,9999,00,00",
        "GPZDA,120000,15,06,2150,00,00",  # later than a map can be of
    ],
)
def test_what_cannot_be_is_broken_however_good_its_checksum(body: str) -> None:
    log = parse_nmea([rmc("110000"), gga("110000"), sentence(body)])
    assert (len(log.fixes), log.broken) == (1, 1)


def test_a_sentence_needs_its_dollar() -> None:
    assert parse(gga("120000")[1:], rmc("120000"), gga("120001")) == parse(
        rmc("120000"), gga("120001")
    )


@pytest.mark.parametrize("chunk", [1, 100, 1000])
def test_a_sentence_longer_than_any_is_broken_however_it_arrives(chunk: int) -> None:
    data = sentence("GPXXX," + "1" * 300) + sentence("GPXXX," + "1" * 200)
    log = parse_nmea(data[k : k + chunk] for k in range(0, len(data), chunk))
    assert (log.sentences, log.broken) == (1, 1)


def test_sentences_between_binary_messages_are_found() -> None:
    binary = b"\xb5\x62\x01\x07$\x00\x24\xd3\x00\x13$GP\xff*00"
    log = parse_nmea([binary, rmc("120000"), binary + gga("120000") + binary])
    assert (len(log.fixes), log.broken) == (1, 0)


LOG = b"".join(
    [
        b"garbage\xff\x00",
        *(
            gga(f"1200{second:02}") + rmc(f"1200{second:02}") + b"\xb5\x62$\x01$GPGGA,12"
            for second in range(20)
        ),
    ]
)
EXPECTED = parse_nmea([LOG])


@given(st.lists(st.integers(0, len(LOG)), max_size=40))
def test_how_the_bytes_arrive_does_not_matter(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), len(LOG)]
    chunks = [LOG[a:b] for a, b in pairwise(edges)]
    assert parse_nmea(chunks) == EXPECTED


def test_bytes_may_arrive_one_by_one_or_from_a_file() -> None:
    assert len(EXPECTED.fixes) == 20
    assert parse_nmea(LOG[k : k + 1] for k in range(len(LOG))) == EXPECTED


@given(st.integers(0, len(LOG) - 1), st.integers(1, 255))
def test_a_flipped_byte_invents_no_position(at: int, flip: int) -> None:
    damaged = bytearray(LOG)
    damaged[at] ^= flip
    places = {fix[:4] for fix in EXPECTED.fixes}
    found = [fix[:4] for fix in parse_nmea([bytes(damaged)]).fixes]
    assert places.issuperset(found)
    assert len(found) >= 19


@given(st.lists(st.binary() | st.sampled_from([gga("120000"), rmc("120000"), b"$GPGGA,", b"$"])))
def test_garbage_is_read_in_peace(chunks: list[bytes]) -> None:
    log = parse_nmea([rmc("115959"), b"$", *chunks])
    assert log.sentences >= 1


@given(st.text("$*,.0123456789ABGPRMCNSEWV\r\n"), st.sampled_from(["GGA", "RMC", "ZDA", "GST"]))
def test_intact_nonsense_is_read_in_peace(fields: str, kind: str) -> None:
    parse_nmea([rmc("115959"), sentence(f"GP{kind},{fields}")])


def test_a_log_without_lines_takes_no_memory() -> None:
    def endless() -> Iterator[bytes]:
        yield rmc("120000") + gga("120000") + b"$GPGGA,"
        for _ in range(500):
            yield b"1" * 100_000

    tracemalloc.start()
    log = parse_nmea(endless())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (len(log.fixes), log.broken) == (1, 1)
    assert peak < 1_000_000
