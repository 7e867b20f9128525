"""Solutions of RTKLIB: their time scales, ways to write a place, qualities and errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import FieldgridError, Quality, RecordingError
from fieldgrid.geometry import geodetic_to_ecef
from fieldgrid.recordings import DriveOptions, FixLog, columns_from_text, open_drive
from fieldgrid.recordings.tables.logs import read_fix_log

NOON_NS = 1_717_243_200_000_000_000  # 2024-06-01 12:00:00 UTC, week 2316, 561618 s of GPS
LAT, LON, HEIGHT_M = 41.651234567, -4.721234567, 800.1234
FRAME = (
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
    "ns=# of satellites)"
)
HEADER = f"""% program   : RTKLIB ver.demo5 b34
% obs start : 2024/06/01 12:00:18.0 GPST (week2316 561618.0s)
% ref pos   : 41.650000000  -4.720000000   800.0000
%
{FRAME}
"""
PLACE = "  latitude(deg) longitude(deg)  height(m)"
REST = "   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"
VALUES = "   1  12   0.0080   0.0060   0.0190  -0.0020   0.0080  -0.0240   1.20    4.5"
DEGREES = f"{LAT:14.9f} {LON:14.9f} {HEIGHT_M:10.4f}"


def text(scale: str, time: str, place: str = DEGREES, columns: str = PLACE) -> str:
    return f"{HEADER}%  {scale:20}{columns}{REST}\n{time}  {place}{VALUES}\n"


def read(folder: Path, content: str, columns: str = "", name: str = "rover.pos") -> FixLog:
    (folder / name).write_text(content, encoding="ascii")
    return read_fix_log(folder / name, columns_from_text(columns) if columns else None)


GPST = text("GPST", "2024/06/01 12:00:18.250")


@pytest.mark.parametrize(
    ("scale", "time"),
    [
        ("GPST", "2024/06/01 12:00:18.250"),
        ("GPST", "2316 561618.250"),
        ("UTC", "2024/06/01 12:00:00.250"),
        ("JST", "2024/06/01 21:00:00.250"),
    ],
)
def test_times_of_each_scale(scale: str, time: str, tmp_path: Path) -> None:
    log = read(tmp_path, text(scale, time))
    (fix,) = log.fixes
    assert fix.time_ns == NOON_NS + 250_000_000
    assert (fix.lat_deg, fix.lon_deg, fix.height_m) == (LAT, LON, HEIGHT_M)
    assert (fix.quality, fix.satellites, fix.age_s) == (Quality.RTK_FIXED, 12, 1.2)
    # Along one axis: the root of the mean square of 8 and 6 mm.
    assert fix.sigma_m == pytest.approx(0.00707107, abs=1e-8)
    assert scale.replace("JST", "UTC+9 h") in log.notes[0]


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_columns_parted_by_a_mark(mark: str, tmp_path: Path) -> None:
    *remarks, names, row = GPST.splitlines()
    scale, *columns = names.lstrip("% ").split()
    day, *words = row.split()
    content = "\n".join(
        [*remarks, f"%  {mark.join([scale, *columns])}", f"{day} {mark.join(words)}"]
    )
    (fix,) = read(tmp_path, content).fixes
    assert (fix.time_ns, fix.lat_deg, fix.satellites) == (NOON_NS + 250_000_000, LAT, 12)


def test_degrees_minutes_and_seconds(tmp_path: Path) -> None:
    """Also south of the equator by less than a degree, where the sign stands before a zero."""
    place = "   -0 39 04.44444   -4 43 16.44444   800.1234"
    columns = "   latitude(d'\")  longitude(d'\")  height(m)"
    (fix,) = read(tmp_path, text("GPST", "2024/06/01 12:00:18.0", place, columns)).fixes
    assert fix.lat_deg == pytest.approx(-(39 / 60 + 4.44444 / 3600), abs=1e-12)
    assert fix.lon_deg == pytest.approx(-(4 + 43 / 60 + 16.44444 / 3600), abs=1e-12)
    assert (fix.height_m, fix.quality) == (HEIGHT_M, Quality.RTK_FIXED)


def test_earth_centred_coordinates(tmp_path: Path) -> None:
    place = " ".join(f"{float(v):14.4f}" for v in geodetic_to_ecef(LAT, LON, HEIGHT_M))
    columns = "  x-ecef(m)      y-ecef(m)      z-ecef(m)"
    content = text("GPST", "2024/06/01 12:00:18.0", place, columns)
    content = content.replace("sdn(m)   sde(m)   sdu(m)", "sdx(m)   sdy(m)   sdz(m)")
    (fix,) = read(tmp_path, content).fixes
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((LAT, LON), abs=1e-9)
    assert fix.height_m == pytest.approx(HEIGHT_M, abs=2e-4)
    assert fix.sigma_m == pytest.approx(np.sqrt((8**2 + 6**2 + 19**2) / 3) / 1000)


@pytest.mark.parametrize(
    ("code", "quality"),
    [
        (0, Quality.NONE),
        (1, Quality.RTK_FIXED),
        (2, Quality.RTK_FLOAT),
        (3, Quality.SBAS),
        (4, Quality.DIFFERENTIAL),
        (5, Quality.GPS),
        (6, Quality.DIFFERENTIAL),
        (7, Quality.ESTIMATED),
        (8, Quality.UNKNOWN),
    ],
)
def test_qualities_are_not_those_of_gga(code: int, quality: Quality, tmp_path: Path) -> None:
    (fix,) = read(tmp_path, GPST.replace("   1  12 ", f"   {code}  12 ")).fixes
    assert fix.quality is quality


@pytest.mark.parametrize("words", ["0.0000   0.0000", "1e300 0.0060", "inf 0.0060"])
def test_an_error_that_is_none_says_nothing(words: str, tmp_path: Path) -> None:
    with np.errstate(all="raise"):
        (fix,) = read(tmp_path, GPST.replace("0.0080   0.0060", words)).fixes
    assert fix.sigma_m is None


def test_an_age_beyond_numbers_says_nothing(tmp_path: Path) -> None:
    age = GPST.splitlines()[-1].split()[-2]
    (fix,) = read(tmp_path, GPST.replace(f" {age} ", " 1e999 ")).fixes
    assert fix.age_s is None


def test_heights_above_the_geoid_are_told(tmp_path: Path) -> None:
    content = GPST.replace("WGS84/ellipsoidal", "WGS84/geodetic")
    assert "above mean sea level" in read(tmp_path, content).notes[1]


def test_without_a_header_the_clock_must_be_said(tmp_path: Path) -> None:
    """As Emlid's receivers write solutions."""
    rows = GPST.splitlines()[-1] + "\n"
    with pytest.raises(RecordingError, match=r"has no header.*--columns time_zone=GPST for"):
        read(tmp_path, rows, name="raw.LLH")
    for said, ahead_s in (("GPST", 18), ("UTC", 0)):
        (fix,) = read(tmp_path, rows, f"time_zone={said}", "raw.LLH").fixes
        assert fix.time_ns == NOON_NS + (18 - ahead_s) * 10**9 + 250_000_000
        assert (fix.lat_deg, fix.quality, fix.age_s) == (LAT, Quality.RTK_FIXED, 1.2)
    assert "quality is taken for RTKLIB's Q" in read(tmp_path, rows, "time_zone=UTC").notes[0]


@pytest.mark.parametrize("mark", [" ", ","])
@pytest.mark.parametrize("rest", ["", " 0.0080 0.0060", " 0 0 0 0 0 0 0 0"])
def test_any_log_without_a_header_is_not_taken_for_one(
    mark: str, rest: str, tmp_path: Path
) -> None:
    """Its quality 1 may be that of GGA, a single position."""
    words = f"{LAT} {LON} {HEIGHT_M} 1 12{rest}".replace(" ", mark)
    with pytest.raises(FieldgridError):
        read(tmp_path, f"2024/06/01 12:00:00.0{mark}{words}\n" * 3, "time_zone=UTC")


def test_without_a_header_most_rows_tell_how_wide_one_is(tmp_path: Path) -> None:
    row = GPST.splitlines()[-1]
    rows = "\n".join([f"{row} 2024/06", *[row] * 8, ""])
    assert len(read(tmp_path, rows, "time_zone=GPST").fixes) == 9


@pytest.mark.parametrize(
    "second",
    [
        text("UTC", "2024/06/01 12:00:01.0"),
        text("GPST", "2316 561619.0").replace("WGS84/ellipsoidal", "WGS84/geodetic"),
        GPST.replace("   sdn(m)   sde(m)", "   sde(m)   sdn(m)"),
    ],
)
def test_a_second_header_must_agree_with_the_first(second: str, tmp_path: Path) -> None:
    """Of files that were joined."""
    assert len(read(tmp_path, GPST + GPST).fixes) == 2
    with pytest.raises(RecordingError, match=r"another header among its rows.*file of its own"):
        read(tmp_path, GPST + second)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (GPST.replace("GPST  ", "DateTime"), "calls its time 'DateTime'.*say which they are"),
        (GPST.replace("latitude(deg)", "e-baseline(m)"), "base station.*out-solformat = llh"),
        (GPST.replace("=WGS84", "=Tokyo"), "in the datum Tokyo; let RTKLIB write them in WGS84"),
        (GPST.replace("  ns   sdn", "   sdn"), "lacks the columns Q and ns"),
        (text("UTC", "2316 561618.250"), "weeks of UTC; let RTKLIB write times as GPST"),
    ],
)
def test_what_is_not_read_says_what_to_do(content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=message):
        read(tmp_path, content)


def test_damaged_lines_are_skipped_and_counted(tmp_path: Path) -> None:
    row = GPST.splitlines()[-1]
    damaged = [
        row[:40],  # the file was cut off there, or the next line merged
        row.replace("06/01", "16/41"),
        row.replace("41.65", "141.65"),
        row.replace("0.0080", "0.00x0"),
        row.replace("18.250", "1825"),
        row.replace("06/01", "06/31"),
        row.replace("2024/06/01 12:00:18.250", "2316 561618.250"),  # others have dates
    ]
    log = read(tmp_path, "\n".join([GPST.rstrip(), *damaged, "% a remark", row, ""]))
    assert len(log.fixes) == 2
    assert log.notes[-1] == "rover.pos: 7 damaged lines skipped."


def test_it_is_found_in_a_recording_and_opens_as_a_drive(tmp_path: Path) -> None:
    (tmp_path / "gnss").mkdir()
    (tmp_path / "gnss" / "rover.pos").write_text(GPST, encoding="ascii")
    with open_drive(tmp_path) as drive:
        assert (drive.gnss_source, len(drive.fixes())) == ("gnss/rover.pos", 1)
    with open_drive(tmp_path / "gnss" / "rover.pos", DriveOptions()) as drive:
        assert drive.kind == "GNSS log"


@settings(max_examples=60)
@given(st.data())
def test_any_damage_is_fixes_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(GPST.encode() + GPST.encode().splitlines(keepends=True)[-1] * 3)
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(
            st.sampled_from(b"0159.,;-/ %eni\n\xff")
        )
    path = tmp_path_factory.getbasetemp() / "any.pos"
    path.write_bytes(bytes(content))
    try:
        fixes = read_fix_log(path).fixes
    except FieldgridError:
        return
    assert np.isfinite(fixes.lat_deg).all()
