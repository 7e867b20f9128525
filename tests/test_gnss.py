"""NMEA logs to fixes, and the verdicts on them."""

from __future__ import annotations

import csv
import io
import json
import math
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldgrid.errors import GnssError
from fieldgrid.gnss import (
    DEFAULT_LIMITS,
    Fix,
    GateLimits,
    NmeaLog,
    condition,
    parse_nmea,
    position_sigma_m,
)
from fieldgrid.trajectory import Status

SharedData = Callable[[str], Path]

SECOND = 1_000_000_000
JUNE_15 = 1_308_096_000 * SECOND  # 2011-06-15T00:00:00Z
NOON = JUNE_15 + 12 * 3600 * SECOND


def sentence(body: str) -> bytes:
    value = 0
    for byte in body.encode():
        value ^= byte
    return f"${body}*{value:02X}\r\n".encode()


def gga(time: str, *, quality: str = "4", lat: str = "4139.0227370", talker: str = "GP") -> bytes:
    return sentence(
        f"{talker}GGA,{time},{lat},N,00443.2141860,W,{quality},12,0.7,737.921,M,52.4,M,1.5,0138"
    )


def rmc(time: str, date: str = "150611", *, speed: str = "3.0", status: str = "A") -> bytes:
    return sentence(f"GPRMC,{time},{status},4139.02,N,00443.21,W,{speed},,{date},,,R")


def parse(*parts: bytes) -> list[Fix]:
    return parse_nmea(parts).fixes


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


def test_positions_without_any_date_are_an_error() -> None:
    with pytest.raises(GnssError, match="2 positions but no valid RMC or ZDA"):
        parse(gga("120000"), gga("120001"), rmc("120001", status="V"))


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
    assert parse_nmea(io.BytesIO(LOG)) == EXPECTED


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

    class OneLongLine(io.BytesIO):
        def readline(self, size: int | None = -1, /) -> bytes:
            raise AssertionError("a line of any length would be held in memory")

        __next__ = readline

    tracemalloc.start()
    log = parse_nmea(endless())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (len(log.fixes), log.broken) == (1, 1)
    assert peak < 1_000_000
    assert parse_nmea(OneLongLine(b"$GPGGA," + b"1" * 1_000_000)).broken == 1


# --- how sure a fix is

GOOD = Fix(NOON, 41.65, -4.72, 787.4, 4, 12, 0.7, 1.5)


@pytest.mark.parametrize(
    ("quality", "sigma_m", "expected"),
    [
        (4, None, 0.02),
        (5, None, 0.25),
        (2, None, 0.5),
        (9, None, 0.5),
        (1, None, 1.5),
        (4, 0.013, 0.013),
        (2, 0.27, 0.27),
        (4, 0.00001, 0.01),  # millimetres written for metres
        (2, 0.0003, 0.05),
        (1, 44.0, 44.0),  # who says that it is bad is believed
        (4, 0.0, 0.02),
        (4, math.nan, 0.02),
    ],
)
def test_position_sigma(quality: int, sigma_m: float | None, expected: float) -> None:
    fix = GOOD._replace(quality=quality, sigma_m=sigma_m)
    assert position_sigma_m(fix) == pytest.approx(expected)


# --- verdicts


def drive(
    count: int, *, speed_mps: float = 1.5, period_s: float = 0.2, told: bool = True
) -> list[Fix]:
    """Fixes of a drive due north at 5 Hz."""
    return [
        GOOD._replace(
            time_ns=NOON + round(k * period_s * SECOND),
            lat_deg=41.65 + north_deg(k * period_s * speed_mps),
            quality=2,
            sigma_m=0.3,
            speed_mps=speed_mps if told else None,
        )
        for k in range(count)
    ]


def north_deg(metres: float) -> float:
    return metres / 111_073.0


def moved(fixes: list[Fix], epochs: Iterable[int], metres: float) -> list[Fix]:
    """The fixes, those of some epochs moved north."""
    chosen = set(epochs)
    return [
        fix._replace(lat_deg=fix.lat_deg + north_deg(metres)) if k in chosen else fix
        for k, fix in enumerate(fixes)
    ]


def rejected(fixes: list[Fix], limits: GateLimits = DEFAULT_LIMITS) -> list[int]:
    verdicts = condition(fixes, limits)
    assert len(verdicts) == len(fixes)
    assert all(v.reason for v in verdicts if v.status is Status.REJECTED)
    return [k for k, verdict in enumerate(verdicts) if verdict.status is Status.REJECTED]


@pytest.mark.parametrize("told", [True, False])
def test_a_clean_drive_is_accepted_whole(told: bool) -> None:
    assert rejected(drive(100, told=told)) == []
    assert rejected(drive(100, speed_mps=11.5, told=told)) == []


def test_noise_within_the_told_accuracy_is_no_jump() -> None:
    standing = drive(100, speed_mps=0.0)
    assert rejected(moved(standing, range(0, 100, 3), 1.0)) == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"quality": 6}, "quality 6 (estimated) is not allowed"),
        ({"quality": 0}, "quality 0 (none) is not allowed"),
        ({"quality": 77}, "quality 77 (unknown) is not allowed"),
        ({"satellites": 4}, "4 satellites < 5"),
        ({"hdop": 5.2}, "HDOP 5.2 > 4"),
        ({"hdop": math.nan}, "HDOP nan > 4"),
        ({"quality": 2, "age_s": 25.0}, "differential age 25 s > 10 s"),
        ({"lat_deg": math.nan}, "not all numbers"),
        ({"height_m": math.inf}, "not all numbers"),
        ({"lat_deg": 91.0}, "are not on Earth"),
        ({"lon_deg": -180.5}, "are not on Earth"),
        ({"height_m": 20_000.0}, "height 20000.0 m is outside"),
        ({"lat_deg": 0.0, "lon_deg": 0.0}, "latitude 0, longitude 0"),
    ],
)
def test_each_gate_says_why(change: dict[str, float], reason: str) -> None:
    bad = GOOD._replace(**change)
    (verdict,) = condition([bad])
    assert verdict.status is Status.REJECTED
    assert reason in verdict.reason
    # It must not keep the good ones around it from being judged.
    after = GOOD._replace(time_ns=NOON + 2 * SECOND)
    between = bad._replace(time_ns=NOON + SECOND)
    assert rejected([GOOD, between, after]) == [1]
    assert rejected([between, after]) == [0]


@pytest.mark.parametrize(
    "change",
    [
        {"satellites": None, "hdop": None, "age_s": None},
        {"satellites": 5},
        {"hdop": 4.0},
        {"age_s": 10.0},
        {"quality": 1, "age_s": 25.0},  # no correction is used, so its age says nothing
        {"quality": 9, "age_s": 25.0},
    ],
)
def test_what_is_just_good_enough_passes(change: dict[str, float]) -> None:
    assert rejected([GOOD._replace(**change)]) == []


def test_limits_can_be_set() -> None:
    limits = GateLimits(allowed_quality=frozenset({4}), min_satellites=6)
    fixes = [GOOD._replace(time_ns=NOON + k, quality=q) for k, q in enumerate((4, 5))]
    assert rejected(fixes, limits) == [1]
    assert rejected([GOOD._replace(satellites=5)], limits) == [0]


def test_time_must_increase() -> None:
    fixes = drive(10)
    fixes[4] = fixes[4]._replace(time_ns=fixes[3].time_ns)
    fixes[7] = fixes[2]
    verdicts = condition(fixes)
    assert [k for k, v in enumerate(verdicts) if v.status is Status.REJECTED] == [4, 7]
    assert verdicts[4].reason == "time is that of the last accepted fix"
    assert verdicts[7].reason == "time is 0.8 s before the last accepted fix"


def test_one_stamp_in_the_future_condemns_only_itself() -> None:
    fixes = drive(10)
    for k in (0, 5):
        late = fixes[k]._replace(time_ns=fixes[k].time_ns + 3600 * SECOND)
        verdicts = condition([*fixes[:k], late, *fixes[k + 1 :]])
        assert [i for i, v in enumerate(verdicts) if v.status is Status.REJECTED] == [k]
        assert "after that of the next fix" in verdicts[k].reason


@pytest.mark.parametrize("told_sigma_m", [0.3, None])
@pytest.mark.parametrize("metres", [5.2, -5.2])
@pytest.mark.parametrize("length", [1, 2, 7])
def test_multipath_is_rejected_and_left_again(
    length: int, metres: float, told_sigma_m: float | None
) -> None:
    epochs = range(40, 40 + length)
    # A jump back is met by the vehicle, which could have driven there before it ends.
    fixes = [fix._replace(sigma_m=told_sigma_m) for fix in moved(drive(100), epochs, metres)]
    assert rejected(fixes) == list(epochs)


def test_a_jump_says_how_large_it_is() -> None:
    verdict = condition(moved(drive(20), [10], 5.0))[10]
    assert verdict.reason.startswith("jump of 5.30 m in 0.20 s implies 27 m/s; speed and accuracy")


def test_a_jump_too_fast_for_any_vehicle_is_rejected_without_a_speed() -> None:
    assert rejected(moved(drive(50, told=False), [20], 15.0)) == [20]


def test_a_solution_that_has_moved_is_followed_from_a_marked_seam() -> None:
    fixes = moved(drive(100), range(40, 100), 30.0)
    verdicts = condition(fixes)
    found = rejected(fixes)
    assert found == list(range(40, 55))  # 3 s at 5 Hz
    assert all(verdicts[k].reason.startswith("jump of") for k in found)
    assert verdicts[55].reason.startswith("the solution has moved: 16 fixes agree on it; jump of")
    assert {v.reason for k, v in enumerate(verdicts) if k not in found and k != 55} == {""}


def test_a_move_needs_fixes_enough_and_time_enough() -> None:
    slow = moved(drive(40, period_s=1.0, speed_mps=0.0), range(10, 40), 60.0)
    assert rejected(slow) == list(range(10, 19))  # the tenth fix, 9 s later
    fast = moved(drive(200, period_s=0.02), range(50, 200), 30.0)
    assert rejected(fast) == list(range(50, 200))  # 3 s are reached with the next one


def test_jumps_that_do_not_agree_are_no_move() -> None:
    fixes = drive(100)
    fixes = moved(moved(fixes, range(40, 70, 2), 40.0), range(41, 70, 2), -40.0)
    assert rejected(fixes) == list(range(40, 70))  # 6 s, and 15 fixes on either side


def test_no_fix_has_no_verdict() -> None:
    assert condition([]) == []


# --- real logs


def test_no_disturbance_of_the_decimetre_log_gets_through(shared_data: SharedData) -> None:
    folder = shared_data("vineyard_two_lanes")
    log = read(folder / "gnss" / "gnss_sf1.nmea")
    assert (len(log.fixes), log.no_position, log.bad_checksum, log.broken) == (403, 15, 2, 4)
    error = {
        int(row["timestamp_utc_s"].replace(".", "")) * 1_000_000: (
            float(row["err_E"]),
            float(row["err_N"]),
        )
        for row in csv.DictReader(
            (folder / "truth" / "gnss_sf1_errors.csv").read_text().splitlines()
        )
    }
    events = json.loads((folder / "truth" / "gnss_sf1_events.json").read_text())
    start_ns = min(error)
    disturbed = {
        start_ns + (event["first_epoch"] + k) * SECOND // 5
        for event in events
        if event["type"] == "multipath_jump"
        for k in range(event["n_epochs"])
    }

    def beyond_bias_m(time_ns: int) -> float:
        """Error of a fix less the slow bias: the median of the calm fixes within 5 s."""
        calm = [e for t, e in error.items() if abs(t - time_ns) < 5 * SECOND and t not in disturbed]
        bias = [median(values) for values in zip(*calm, strict=True)]
        return math.dist(error[time_ns], bias)

    verdicts = condition(log.fixes)
    accepted = [
        f.time_ns for f, v in zip(log.fixes, verdicts, strict=True) if v.status is Status.OK
    ]
    assert [t for t in accepted if beyond_bias_m(t) > 1.5] == []
    assert len(accepted) == 403 - len(disturbed)  # and nothing good was lost


def test_nothing_of_the_centimetre_log_is_rejected(shared_data: SharedData) -> None:
    log = read(shared_data("vineyard_two_lanes") / "gnss" / "gnss_rtk.nmea")
    assert (len(log.fixes), log.bad_checksum + log.broken) == (437, 0)
    assert rejected(log.fixes) == []


def test_real_receivers_are_understood(shared_data: SharedData) -> None:
    corpus = shared_data("gnss/gpsd_corpus")
    rtk = read(corpus / "nmea-rtk.log").fixes
    assert (len(rtk), rtk[0].quality) == (122, 2)
    compass = read(corpus / "skytraq-PX1172RH_DS.log").fixes
    assert compass[0].heading_deg == pytest.approx(-115.72)
    for path in sorted(corpus.glob("*.log")):
        with suppress(GnssError):  # some have no date, which is the one thing to complain of
            condition(read(path).fixes)


def read(path: Path) -> NmeaLog:
    with path.open("rb") as file:
        return parse_nmea(file)
