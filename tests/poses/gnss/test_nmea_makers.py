"""Makers' own sentences and logs: the examples of their manuals and of real receivers."""

from __future__ import annotations

import math

import pytest

from fieldgrid.core import Quality
from fieldgrid.poses import unix_ns
from fieldgrid.poses.gnss.nmea import unicore_crc
from tests.poses.gnss.sentences import NOON, SECOND, gga, parse, parse_nmea, rmc, sentence

# As receivers wrote them.
UNIHEADING = (
    b"#UNIHEADINGA,78,GPS,FINE,2428,116060000,0,0,18,11;SOL_COMPUTED,NARROW_INT,1.4773,"
    b'179.0284,-2.4202,0.0000,0.8259,1.0921,"999",27,21,21,15,3,01,3,f3*5d424350\r\n'
)
UNIHEADING_FLOAT = (
    b"#UNIHEADINGA,93,GPS,FINE,2385,326588000,0,0,18,10;SOL_COMPUTED,NARROW_FLOAT,5.5208,"
    b'219.9783,24.6813,0.0000,16.4390,35.3287,"999",21,9,9,5,3,00,3,13*53e4320d\r\n'
)
UNIHEADING_NONE = (
    b"#UNIHEADINGA,97,GPS,FINE,2190,365174000,0,0,18,12;INSUFFICIENT_OBS,NONE,0.0000,0.0000,"
    b'0.0000,0.0000,0.0000,0.0000,"",0,0,0,0,0,00,0,0*ee072604\r\n'
)
HEADING = (
    b"#HEADINGA,COM2,0,23.0,FINE,2376,266819.200,112748,24,18;SOL_COMPUTED,NARROW_INT,0.7935,"
    b'309.5608,-1.6492,0.0000,0.2902,0.7118,"999",52,46,46,27,3,00,3,f3*91c43d2c\r\n'
)
BESTNAV = (  # the manual's example, but its CRC is wrong there
    b"#BESTNAVA,97,GPS,FINE,2294,472312000,0,0,18,16;SOL_COMPUTED,NARROW_FLOAT,40.0789588272,"
    b'116.2365102982,65.8312,-8.4925,WGS84,1.2221,1.1053,2.1970,"0",0.400,0.200,50,28,28,0,1,'
    b"12,12,41,SOL_COMPUTED,DOPPLER_VELOCITY,0.000,0.000,0.0046,335.592288,0.0045,0.0194,0.0123"
    b"*3e3517dd\r\n"
)
BESTPOS = (
    b"#BESTPOSA,COM1,0,60.5,FINESTEERING,2166,327153.000,02000000,b1f6,16248;SOL_COMPUTED,WAAS,"
    b'51.15043699323,-114.03067932462,1096.9772,-17.0000,WGS84,0.6074,0.5792,0.9564,"131",7.000,'
    b"0.000,42,34,34,28,00,0b,1f,37*47bbdc4f\r\n"
)
PVTSLN = (
    b"#PVTSLNA,79,GPS,FINE,2377,93246900,0,0,18,8;SINGLE,188.1621,34.60324214605,"
    b"-86.74943363150,7.5696,4.3304,3.4834,0.000,SINGLE,188.1621,34.60324214605,"
    b"-86.74943363150,-28.5587,19,17,19,17,-0.0933,-0.0469,-0.1506,NONE,0.0000,0.0000,0.0000,"
    b"0,0,0,0,2.8451,1.6314,0.8332,2.4753,2.3309,5.0,17,3,4,9,16,26,31,47,49,51,76,77,82,104,"
    b"179,182,196,205*d127bb24\r\n"
)
KSXT = (
    b"$KSXT,20211016083433.00,116.31296102,39.95817066,49.4911,223.57,-11.32,330.19,0.024,,1,3,"
    b"28,27,,,,-0.012,0.021,0.020,,*2D\r\n"
)
KSXT_CRC = (
    b"$KSXT,20201222075720.00,119.17084152,32.07387900,83.5770,269.94,1.19,207.28,0.001,,3,3,"
    b"25,25,-3.617,-4.468,-7.860,-0.000,-0.001,-0.022,1.0,56,*33736701\r\n"
)
GGK = b"$PTNL,GGK,102939.00,051910,5000.97323841,N,00827.62010742,E,5,09,1.9,EHT150.790,M*73\r\n"
AVR = b"$PTNL,AVR,212405.20,+52.1531,Yaw,-0.0806,Tilt,,,12.575,3,1.4,16*39\r\n"
PASHR = b"$PASHR,142509.000,179.885,T,-0.624,0.245,,0.029,0.029,0.502,2,3*17\r\n"
HPR = b"$GNHPR,074615.00,320.9610,-66.1712,000.0000,4,47,0.00,0999*45\r\n"


def log(body: str) -> bytes:
    return b"#%b*%08x\r\n" % (body.encode(), unicore_crc(body.encode()))


def heading_of(*parts: bytes) -> tuple[float | None, float | None, int | None]:
    """The heading that sentences of 12:00 add to a fix, its sigma and its quality."""
    (fix,) = parse(rmc("120000"), gga("120000"), *parts)
    return fix.heading_deg, fix.heading_sigma_deg, fix.heading_quality


# --- positions


def test_ggk_alone_gives_dated_fixes() -> None:
    found = parse_nmea([GGK])
    (fix,) = found.fixes
    assert fix.time_ns == 1_274_264_979 * SECOND  # 2010-05-19T10:29:39Z
    assert fix.lat_deg == pytest.approx(50 + 0.97323841 / 60, abs=1e-12)
    assert fix.lon_deg == pytest.approx(8 + 27.62010742 / 60, abs=1e-12)
    assert (fix.height_m, fix.quality, fix.satellites, fix.hdop) == (150.790, 9, 9, None)
    assert (found.no_geoid, found.no_height) == (0, 0)


@pytest.mark.parametrize(("code", "quality"), [(1, 1), (2, 5), (3, 4), (4, 2), (7, 4), (10, 5)])
def test_the_quality_codes_of_ggk_are_its_own(code: int, quality: int) -> None:
    body = f"PTNL,GGK,120000,061511,4139.0,N,00443.0,W,{code},09,1.9,GHT737.900,M"
    found = parse_nmea([sentence(body)])
    assert [fix.quality for fix in found.fixes] == [quality]
    assert found.fixes[0].time_ns == NOON
    assert found.no_geoid == 1  # GHT is above the geoid


def test_ggk_without_a_solution_gives_no_fix() -> None:
    found = parse_nmea([b"$PTNL,GGK,,,,,,,0,00,,,M*30\r\n"])
    assert (found.fixes, found.no_position, found.broken) == ([], 1, 0)


@pytest.mark.parametrize("height", ["150.790", "XHT150.790", "EHT", "EHTnan", "EHT1e3"])
def test_a_height_of_ggk_that_cannot_be(height: str) -> None:
    body = f"PTNL,GGK,120000,061511,4139.0,N,00443.0,W,3,09,1.9,{height},M"
    found = parse_nmea([sentence(body)])
    assert (found.fixes, found.broken) == ([], 1)


def test_ksxt_alone_gives_dated_fixes() -> None:
    found = parse_nmea([KSXT])
    (fix,) = found.fixes
    assert fix.time_ns == 1_634_373_273 * SECOND  # 2021-10-16T08:34:33Z
    assert fix[1:6] == (39.95817066, 116.31296102, 49.4911, 1, 27)
    assert fix.speed_mps == pytest.approx(0.024 / 3.6)
    assert (fix.heading_deg, fix.heading_quality) == (pytest.approx(-136.43), 4)
    assert fix.course_deg == pytest.approx(-29.81)
    assert found.no_geoid == 1


def test_ksxt_may_end_with_a_crc() -> None:
    (fix,) = parse(KSXT_CRC)
    assert (fix.quality, fix.heading_quality, fix.heading_deg) == (4, 4, pytest.approx(-90.06))
    assert parse_nmea([KSXT_CRC.replace(b"32.07", b"32.08")]).bad_checksum == 1


def test_bestnav_alone_gives_fixes() -> None:
    (fix,) = parse(BESTNAV)
    assert fix.time_ns == unix_ns(2294, 472_312_000_000_000)
    assert (fix.lat_deg, fix.lon_deg) == (40.0789588272, 116.2365102982)
    assert fix.height_m == pytest.approx(65.8312 - 8.4925)
    assert (fix.quality, fix.satellites, fix.age_s) == (5, 28, 0.4)
    assert fix.sigma_m == pytest.approx(math.sqrt((1.2221**2 + 1.1053**2) / 2))
    assert (fix.speed_mps, fix.course_deg) == (0.0046, pytest.approx(335.592288 - 360))


def test_pvtsln_alone_gives_fixes() -> None:
    (fix,) = parse(PVTSLN)
    assert fix.time_ns == unix_ns(2377, 93_246_900_000_000)
    assert (fix.lat_deg, fix.lon_deg) == (34.60324214605, -86.74943363150)
    assert fix.height_m == pytest.approx(188.1621 - 28.5587)
    assert (fix.quality, fix.satellites, fix.hdop, fix.heading_deg) == (1, 17, 0.8332, None)


def test_gps_time_is_utc_less_the_leap_seconds_of_its_day() -> None:
    noon_gps = unix_ns(2294, 0) // SECOND
    assert noon_gps == 1_703_376_000 - 18  # 2023-12-24
    assert unix_ns(1640, 0) // SECOND == 1_307_836_800 - 15  # 2011-06-12
    assert unix_ns(0, 0) // SECOND == 315_964_800
    # 2016-12-31T23:59:60 was the last one.
    before, after = (unix_ns(1930, s * SECOND) // SECOND for s in (16, 19))
    assert (before, after) == (1_483_228_799, 1_483_228_801)
    for week, of_week_ns in ((-1, 0), (11_000, 0), (2000, -1), (2000, 604_800 * SECOND)):
        with pytest.raises(ValueError, match="GPS week"):
            unix_ns(week, of_week_ns)


def test_gga_goes_before_all_others() -> None:
    ggk = sentence("PTNL,GGK,120000,061511,4140.0,N,00443.0,W,3,09,1.9,EHT1.0,M")
    for parts in ([ggk, gga("120000")], [gga("120000"), ggk]):
        found = parse_nmea(parts)
        assert [fix.height_m for fix in found.fixes] == [pytest.approx(790.321)]
        assert found.repeated == 0


@pytest.mark.parametrize(
    "header",
    ["97,GPS,UNKNOWN,2294,472312000", "97,BDS,FINE,938,472312000", "97,GPS,FINE,99999,472312000"],
)
def test_a_log_without_gps_time_is_not_used(header: str) -> None:
    body = BESTNAV[1:-11].decode().partition(";")[2]
    assert parse(log(f"BESTNAVA,{header},0,0,18,16;{body}")) == []


def test_a_log_with_a_wrong_crc_is_not_used() -> None:
    found = parse_nmea([BESTNAV.replace(b"40.07", b"40.08")])
    assert (found.fixes, found.bad_checksum) == ([], 1)


# --- headings


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("GNTRA,120000,101.78,1.19,-0.01,4,10,0.00,0004", (101.78, None, 4)),
        ("GNTRA,120000,101.78,1.19,-0.01,5,10,0.00,0004", (101.78, None, 5)),
        ("GNTRA,120000,101.78,1.19,-0.01,1,10,0.00,0004", (None, None, None)),
        ("GNTRA,120000,0.00,0.00,0.00,0,0,0.00,", (None, None, None)),
        ("GNHPR,120000,320.961,-66.1,000.0,4,47,0.00,0999", (-39.039, None, 4)),
        ("PTNL,AVR,120000,+52.1531,Yaw,-0.0806,Tilt,,,12.575,3,1.4,16", (52.1531, None, 4)),
        ("PTNL,AVR,120000,+52.1531,Yaw,-0.0806,Tilt,,,12.575,2,1.4,16", (52.1531, None, 5)),
        ("PTNL,AVR,120000,+52.1531,Yaw,-0.0806,Tilt,,,12.575,1,1.4,16", (None, None, None)),
        ("PTNL,AVR,120000,+52.1531,Yaw,-0.0806,Tilt,,,12.575,0,1.4,16", (None, None, None)),
        ("PASHR,120000,181.0,T,-0.6,0.2,,0.029,0.029,0.502,2,3", (-179.0, 0.502, None)),
        ("PASHR,120000,181.0,T,-0.6,0.2,,0.029,0.029,0.000,1,1", (-179.0, None, None)),
        ("PASHR,120000,181.0,T,-0.6,0.2,,0.029,0.029,0.502,0,0", (None, None, None)),
        ("PASHR,120000,,T,,,,,,,1,0", (None, None, None)),
        ("PASHR,ATT,120000,181.0,-0.6,0.2,0.1,0.1,0", (None, None, None)),
        ("GNTHS,77.5,E", (77.5, None, None)),
        ("GNTHS,77.5,M", (None, None, None)),
        ("GNHDT,271.5,T", (-88.5, None, None)),
        ("GNHDT,,T", (None, None, None)),
        ("GNHDT,361.5,T", (None, None, None)),
        ("GNHDT,nan,T", (None, None, None)),
    ],
)
def test_a_heading_counts_only_where_its_sentence_calls_it_good(
    body: str, expected: tuple[float | None, float | None, int | None]
) -> None:
    assert heading_of(sentence(body)) == pytest.approx(expected)


@pytest.mark.parametrize("raw", [AVR, PASHR, HPR])
def test_headings_as_receivers_wrote_them(raw: bytes) -> None:
    time = {AVR: "212405.20", PASHR: "142509.000", HPR: "074615.00"}[raw]
    (fix,) = parse(rmc(time), gga(time), raw)
    expected = {AVR: 52.1531, PASHR: 179.885, HPR: 320.961 - 360.0}[raw]
    assert fix.heading_deg == pytest.approx(expected)


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (UNIHEADING, (179.0284, 0.8259, 4)),
        (UNIHEADING_FLOAT, (219.9783 - 360.0, 16.439, 5)),
        (UNIHEADING_NONE, (None, None, None)),
        (HEADING, (309.5608 - 360.0, 0.2902, 4)),
    ],
)
def test_headings_of_unicore_logs(
    raw: bytes, expected: tuple[float | None, float | None, int | None]
) -> None:
    seconds = {UNIHEADING: 116_060, UNIHEADING_FLOAT: 326_588, UNIHEADING_NONE: 365_174}.get(raw)
    week = {UNIHEADING: 2428, UNIHEADING_FLOAT: 2385, UNIHEADING_NONE: 2190}.get(raw, 2376)
    of_week_ns = 266_819_200_000_000 if seconds is None else seconds * SECOND
    utc = unix_ns(week, of_week_ns)
    of_day = utc % (86_400 * SECOND) // 1_000_000
    hours, minutes = of_day // 3_600_000, of_day // 60_000 % 60
    time = f"{hours:02}{minutes:02}{of_day % 60_000 / 1000:06.3f}"
    (fix,) = parse(gga(time), raw)
    assert fix.time_ns == utc  # the log alone has the date
    found = (fix.heading_deg, fix.heading_sigma_deg, fix.heading_quality)
    assert found == pytest.approx(expected)


def test_the_better_source_of_a_heading_is_believed_also_when_it_has_none() -> None:
    hdt = sentence("GNHDT,10.0,T")
    invalid = sentence("GNTHS,10.0,V")
    tra = sentence("GNTRA,120000,11.0,1.19,-0.01,4,10,0.00,0004")
    lost = sentence("GNTRA,120000,11.0,1.19,-0.01,0,10,0.00,0004")
    for first, second in ((hdt, invalid), (invalid, hdt), (hdt, lost), (lost, hdt)):
        assert heading_of(first, second) == (None, None, None)
    assert heading_of(hdt, tra) == heading_of(tra, hdt) == (11.0, None, 4)


def test_the_position_of_novatel() -> None:
    (fix,) = parse(BESTPOS)
    assert fix.time_ns == unix_ns(2166, 327_153_000_000_000)
    assert (fix.lat_deg, fix.lon_deg) == (51.15043699323, -114.03067932462)
    assert fix.height_m == pytest.approx(1096.9772 - 17.0)
    assert (fix.quality, fix.satellites, fix.age_s) == (Quality.SBAS, 34, 7.0)
    assert fix.sigma_m == pytest.approx(math.hypot(0.6074, 0.5792) / math.sqrt(2.0))


def test_novatel_without_a_clock_or_a_solution_says_nothing() -> None:
    body = BESTPOS[1:-11].decode()
    for change in (("FINESTEERING", "COARSE"), ("SOL_COMPUTED,WAAS", "INSUFFICIENT_OBS,NONE")):
        assert parse(log(body.replace(*change))) == []
