"""Tables of fixes: common names, units and times, and what is said where they are not common."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import ConfigError, LimitError, RecordingError
from fieldgrid.core.input_limits import limited
from fieldgrid.geometry import Fix
from fieldgrid.recordings import Columns, FixLog, columns_from_text, open_drive
from fieldgrid.recordings.tables.logs import read_fix_log
from fieldgrid.recordings.tables.qualities import read_quality

SharedData = Callable[[str], Path]

START_NS = 1_717_243_200_000_000_000  # 2024-06-01 12:00:00 UTC
START_S = START_NS // 10**9


def read(folder: Path, text: str | bytes, columns: str = "") -> FixLog:
    path = folder / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_fix_log(path, columns_from_text(columns) if columns else None)


def only(folder: Path, text: str | bytes, columns: str = "") -> Fix:
    (fix,) = read(folder, text, columns).fixes
    return fix


def fails(folder: Path, text: str, match: str, columns: str = "") -> None:
    with pytest.raises(RecordingError, match=match):
        read(folder, text, columns)


# --- time


@pytest.mark.parametrize(
    ("name", "cell", "extra_ns"),
    [
        ("time", "2024-06-01T12:00:00.175+00:00", 175_000_000),
        ("time", "2024-06-01T14:00:00.175+02:00", 175_000_000),
        ("time", "2024-06-01 08:00:00.5 UTC-04:00", 500_000_000),
        ("Time", "2024-06-01T12:00:00Z", 0),
        ("utc", "2024/06/01 12:00:00.123456789 UTC", 123_456_789),
        ("Computer_Time", "2024-06-01-12-00-00-175", 175_000_000),
        ("timestamp", "20240601T120000.25Z", 250_000_000),
        ("timestamp", "20240601120000", 0),
        ("timestamp", f"{START_S}", 0),
        ("timestamp_s", f"{START_S}.000000001", 1),
        ("t", f"{START_S}000", 0),
        ("stamp_us", f"{START_S}000001", 1000),
        ("rosbagTimestamp", f"{START_S}000000001", 1),
        ("timestamp_raw", "1.7172432E+018", 0),
        ("t_days1980_s", f"{START_S - 315_532_800}.473", 473_000_000),
    ],
)
def test_times_are_read_as_they_are_written(
    name: str, cell: str, extra_ns: int, tmp_path: Path
) -> None:
    assert only(tmp_path, f"{name},lat,lon\n{cell},41,-4\n").time_ns == START_NS + extra_ns


@pytest.mark.parametrize(
    ("said", "cell"),
    [
        ("time=x,time_units=s", f"{START_S}"),
        ("time=x,time_units=gps_s", f"{START_S - 315_964_800 + 18}"),
        ("time=x,time_units=gps_ms", f"{START_S - 315_964_800 + 18}000"),
        ("time=x,time_units=gps_ns", f"{START_S - 315_964_800 + 18}000000000"),
        ("time=x,time_zone=GPST", "2024/06/01 12:00:18.000"),
        ("time=x,time_zone=-04:00", "2024-06-01 08:00:00"),
        ("time=x,time_zone=+2", "2024-06-01T14:00:00"),
        ("time=x,time_zone=utc", "2024-06-01T12:00:00"),
        ("time=x,time_zone=-11:30", "2024-06-01 00:30:00.000"),
        ("time=x,time_zone=+2", "2024-06-01T12:00:00Z"),
        ("time=x,time_epoch=2024-06-01T12:00:00Z", "0"),
        ("time=x,time_epoch=2024-06-01 11:59:00", "60.0"),
        ("time=x,time_units=ms,time_epoch=2024-06-01T14:00:00+02:00", "0"),
        ("time=x,time_epoch=2024-05-26T00:00:00Z", "561600"),  # seconds of its week
    ],
)
def test_what_is_said_of_a_time_counts(said: str, cell: str, tmp_path: Path) -> None:
    assert only(tmp_path, f"x,lat,lon\n{cell},41,-4\n", said).time_ns == START_NS


def test_a_date_may_stand_beside_the_time_of_day(tmp_path: Path) -> None:
    log = read(tmp_path, "date;time;lat;lon\n2024-06-01;12:00:00,5;41,5;-4\n")
    assert log.fixes[0].time_ns == START_NS + 500_000_000
    assert "time from 'time' and 'date' (date and time, no zone: taken as UTC)" in log.notes[0]


@pytest.mark.parametrize(
    "cell", ["2024-06-01 2:30:15 PM", "01.06.2024 11:59:59 a.m.", "6/1/2024 2:30:15 PM"]
)
def test_hours_of_half_a_day_are_refused(cell: str, tmp_path: Path) -> None:
    fails(tmp_path, f"time,lat,lon\n{cell},41,-4\n", "with hours from 0 to 23")


@pytest.mark.parametrize("cell", ["1" * 100_000, "1" * 50_000 + "." + " " * 50_000 + "x"])
def test_a_long_cell_is_refused_at_once(cell: str, tmp_path: Path) -> None:
    """A latitude, or a height with its unit; digits of any number are one number."""
    fails(tmp_path, f"time,lat,lon,height\n2024-06-01T12:00:00Z,{cell}N,-4,1\n", "is not a number")
    fails(
        tmp_path, f"time,lat,lon,height\n2024-06-01T12:00:00Z,41,-4,{cell}ft\n", "is not a number"
    )


def test_of_two_times_the_one_that_does_not_repeat_is_taken(tmp_path: Path) -> None:
    rows = [f"{START_S + k // 4},{START_S * 1000 + 250 * k},41,-4" for k in range(8)]
    log = read(tmp_path, "\n".join(["sec_stamp,ms_stamp,lat,lon", *rows]))
    assert log.fixes[1].time_ns == START_NS + 250_000_000


@pytest.mark.parametrize("cell", ["", "0", "nan", "1970-01-01T00:00:07", "9" * 23, "9900000000"])
def test_rows_without_a_time_are_counted(cell: str, tmp_path: Path) -> None:
    row = "2024-06-01T12:00:00" if "-" in cell else START_S
    log = read(tmp_path, f"time,lat,lon\n{row},41,-4\n{cell},41,-4\n")
    assert len(log.fixes) == 1
    assert log.notes[-1] == "log.csv: 1 row without a time after 1980 skipped."


def test_a_time_that_is_none_names_its_line(tmp_path: Path) -> None:
    fails(tmp_path, f"time,lat,lon\n{START_S},41,-4\nnoon,4,4\n", r"line 3: time 'noon' is no UTC")
    text = "time,lat,lon\n2024-06-01T12:00:00,41,-4\n2024-06-31T12:00:00,41,-4\n"
    fails(tmp_path, text, r"line 3: time '2024-06-31T12:00:00' is no UTC time")
    fails(
        tmp_path, "elapsed_time,lat,lon\n1,2,3\n", "has no column with UTC times; name it: time ="
    )


# --- names, units, values


def test_common_names_are_guessed_and_said(tmp_path: Path) -> None:
    log = read(
        tmp_path,
        "\ufeffGPS Time;Latitude (deg);lng;Ellipsoidal height [m];numSV;HDOP;diff_age;hAcc [mm];"
        "Ground Speed (km/h);true heading;headAcc;COG;fix_quality\n"
        f"{START_S};41,5;-4,5;787,4;14;0,7;1,5;1414,2136;36,0;350,5;0,25;90;RTK Float\n",
    )
    assert log.fixes[0] == Fix(
        START_NS, 41.5, -4.5, 787.4, 5, 14, 0.7, 1.5, pytest.approx(1.0), pytest.approx(10.0),
        -9.5, 0.25, course_deg=90.0,
    )  # fmt: skip
    assert log.notes == (
        "log.csv: time from 'GPS Time' (s since 1970).",
        "log.csv: lat from 'Latitude (deg)', lon from 'lng', height from 'Ellipsoidal height [m]', "
        "quality from 'fix_quality', satellites from 'numSV', hdop from 'HDOP', age from "
        "'diff_age', speed from 'Ground Speed (km/h)', heading from 'true heading', heading_sigma "
        "from 'headAcc', course from 'COG', accuracy from 'hAcc [mm]'.",
    )


@pytest.mark.parametrize(
    ("name", "metres_a_second"),
    [("speed", 2.0), ("gps_speed_kmh", 2 / 3.6), ("speed_knots", 2 * 1852 / 3600),
     ("drive_speed_0p1kmh", 0.2 / 3.6), ("speed_mph", 0.89408), ("gSpeed_mm_s", 0.002)],
)  # fmt: skip
def test_units_of_speed_are_in_the_name(name: str, metres_a_second: float, tmp_path: Path) -> None:
    fix = only(tmp_path, f"time,lat,lon,{name}\n{START_S},41,-4,-2\n")
    assert fix.speed_mps == pytest.approx(metres_a_second)


@pytest.mark.parametrize(
    ("units", "cell", "heading"),
    [("deg", "270", -90.0), ("rad", f"{math.pi / 2}", 90.0), ("deg_ccw_east", "90", 0.0),
     ("rad_ccw_east", f"{math.pi}", -90.0)],
)  # fmt: skip
def test_a_heading_is_taken_in_the_convention_that_is_said(
    units: str, cell: str, heading: float, tmp_path: Path
) -> None:
    text = f"time,lat,lon,yaw\n{START_S},41,-4,{cell}\n"
    assert only(tmp_path, text).heading_deg is None  # a yaw may count either way
    fix = only(tmp_path, text, f"heading=yaw,heading_units={units}")
    assert fix.heading_deg == pytest.approx(heading)


def test_a_heading_that_is_marked_as_not_valid_is_none(tmp_path: Path) -> None:
    rows = [f"{START_S + k},41,-4,10,{valid}\n" for k, valid in enumerate(["True", "False", "", 1])]
    log = read(tmp_path, "time,lat,lon,heading_deg,head_valid\n" + "".join(rows))
    assert [fix.heading_deg for fix in log.fixes] == [10.0, None, None, 10.0]


def test_rows_without_a_position_are_counted_and_empty_lines_are_not(tmp_path: Path) -> None:
    rows = f"{START_S},,\n\n{START_S},nan,-4\n{START_S},41,-4\n{START_S}"
    log = read(tmp_path, f"time,lat,lon\n{rows}")
    assert len(log.fixes) == 1
    assert log.notes[-1] == "log.csv: 3 rows without a position skipped."


def test_values_that_are_missing_are_none_and_heights_zero(tmp_path: Path) -> None:
    fix = only(tmp_path, f"time,lat,lon,alt,hdop,sats,speed\n{START_S},41,-4,N/A,,,NaN\n")
    assert fix == Fix(START_NS, 41.0, -4.0, 0.0)
    log = read(tmp_path, f"time,lat,lon\n{START_S},41,-4\n")
    assert "log.csv: no column height_m; heights are taken as 0 m." in log.notes


def test_without_a_quality_the_stated_error_judges(tmp_path: Path) -> None:
    rows = [f"{START_S + k},41,-4,{s}\n" for k, s in enumerate((0.014, 0.3, 2.0, "", 0))]
    log = read(tmp_path, "time,lat,lon,sigma_m\n" + "".join(rows))
    assert [fix.quality for fix in log.fixes] == [4, -1, -1, -1, -1]
    assert "stated errors up to 5 cm are taken for RTK fixed" in log.notes[-1]


@pytest.mark.parametrize(
    ("cell", "code"),
    [
        ("4", 4), ("5.0", 5), ("RTK Fixed", 4), ("RTK_FLOAT", 5), ("DGPS", 2), ("No Fix", 0),
        ("GPS fix", 1), ("single", 1), ("SBAS", 9), ("FIX", 4), ("3D fix", 1), ("float", 5),
        ("['fix', 'float']", 5), ("['fix', 'fix']", 4), ("", -1), ("n/a", -1), ("nan", -1),
        ("Estimated", 6), ("PPP", 2),
        ("narrow_int", 4), ("invalid", 0), ("none", 0), ("DGPS fix", 2),
    ],
)  # fmt: skip
def test_qualities_are_numbers_or_words(cell: str, code: int) -> None:
    assert read_quality(cell, numbers_are_gga=True) == code


def test_a_quality_that_is_not_known_is_said(tmp_path: Path) -> None:
    log = read(tmp_path, f"time,lat,lon,quality\n{START_S},41,-4,splendid\n{START_S},41,-4,15\n")
    assert [fix.quality for fix in log.fixes] == [-1, -1]
    assert log.notes[-1] == "log.csv: quality '15', 'splendid' is not known; taken as unknown."
    status = read(tmp_path, f"time,lat,lon,status\n{START_S},41,-4,2\n")  # NavSatFix: 2 is GBAS
    assert (status.fixes[0].quality, "not known" in status.notes[-1]) == (-1, True)


# --- the text itself


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_delimiters_and_encodings(delimiter: str, encoding: str, tmp_path: Path) -> None:
    text = f"time,lat,lon,où\r\n{START_S},41,-4,là\r\n".replace(",", delimiter)
    assert only(tmp_path, text.encode(encoding)) == Fix(START_NS, 41.0, -4.0, 0.0)


@pytest.mark.parametrize(
    "text",
    [
        "#timestamp,lat,lon\n{t},41,-4\n",
        "# made by a logger, version 3\n# in June\ntime,lat,lon\n{t},41,-4\n",
        "sep=;\ntime;lat;lon\n{t};41;-4\n",
        '\n"time","lat","lon"\n"{t}","41","-4"\n',
        "time,lat,lon\n{t},41,-4\n\0\0\0\0",
    ],
)
def test_remarks_hints_and_quotes(text: str, tmp_path: Path) -> None:
    assert only(tmp_path, text.format(t=START_S)).lat_deg == 41.0


def test_a_damaged_cell_names_its_line(tmp_path: Path) -> None:
    head = f"# a remark\ntime,lat,lon\n{START_S},41,-4\n"
    fails(tmp_path, head + f"{START_S},4x1,-4\n", r"log\.csv, line 4: lat '4x1' is not a number")


@pytest.mark.parametrize(
    ("columns", "match"),
    [
        ("lat=b", "has no column 'b' for lat; it has: time, lat, lon"),
        ("time=b", "has no column 'b' for time"),
    ],
)
def test_a_column_that_is_not_there_is_named(columns: str, match: str, tmp_path: Path) -> None:
    fails(tmp_path, f"time,lat,lon\n{START_S},41,-4\n", match, columns)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("lat", "'lat' is not KEY=COLUMN"),
        ("latt=a", "'latt' cannot be mapped; known are time, lat"),
        ("lat=a,lat=b", "lat is given twice"),
        ("lat=a,speed_units=furlongs", "speed_units is 'furlongs'; give one of mps"),
        ("lat=a,time_zone=CET", r"'CET' is no time zone like \+02:00 \(how far .* or UTC; correct"),
        ("lat=a,time_epoch=noon", "time_epoch is 'noon'; give a moment of UTC"),
        ("lat=a,time_epoch=1970-01-01", "time_epoch is '1970-01-01'; give a moment of UTC"),
        ("time_epoch=2024-06-01,time_zone=+2", "leave time_zone and the GPS scale out"),
    ],
)
def test_a_mapping_that_cannot_be(text: str, match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        columns_from_text(text)


def test_a_role_can_be_switched_off(tmp_path: Path) -> None:
    text = f"time,lat,lon,heading_deg\n{START_S},41,-4,10\n"
    assert only(tmp_path, text).heading_deg == 10.0
    assert only(tmp_path, text, "heading=").heading_deg is None
    assert read_fix_log(tmp_path / "log.csv", Columns({"heading": ""})).fixes[0].heading_deg is None


def test_many_rows_are_read_alike(tmp_path: Path) -> None:
    rows = [f"{START_S + k},{41 + k * 1e-6:.6f},-4,{k % 6}" for k in range(20_000)]
    log = read(tmp_path, "time,lat,lon,quality\n" + "\n".join(rows))
    assert len(log.fixes) == 20_000
    assert log.fixes[-1] == Fix(START_NS + 19_999 * 10**9, 41.019999, -4.0, 0.0, 19_999 % 6)


@settings(deadline=None)
@given(st.text(max_size=300))
def test_any_text_is_a_table_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text(f"time,lat,lon,quality,satellites\n{text}", encoding="utf-8", newline="")
    try:
        log = read_fix_log(path)
    except RecordingError:
        return
    assert all(fix.time_ns > 0 for fix in log.fixes)


# --- real logs


@pytest.mark.parametrize(
    ("name", "count", "quality", "has_heading"),
    [
        ("gnss/acorn_rover/around_barn_gps.csv", 175, 4, True),
        ("gnss/isoxml_harvester/csv/TotalsTests_TLG00003.csv", 4336, 1, False),
        ("gnss/lawn_tractor_5hz/collins_dr_62_A_from_rosbag_run1.csv", 8788, -1, False),
        ("gnss/padova_tractor/padova_part1_0650_0828.csv", 5871, -1, True),
        ("gnss/tractor2025/compact/stationary_engine_on_20260805.csv", 1189, 4, True),
        ("vineyard_gnss_rows/Image_GPS.csv", 2085, -1, False),
        ("kitti_oxts/2011_09_26_drive_0001.csv", 108, 4, True),
    ],
)
def test_logs_of_all_kinds_are_read(
    name: str, count: int, quality: int, has_heading: bool, shared_data: SharedData
) -> None:
    log = read_fix_log(shared_data(name))
    first = log.fixes[0]
    assert (len(log.fixes), first.quality, first.heading_deg is not None) == (
        count, quality, has_heading,
    )  # fmt: skip


def test_a_gyro_of_another_unit_has_another_clock(shared_data: SharedData, tmp_path: Path) -> None:
    log = shared_data("kitti_oxts/2011_09_26_drive_0001.csv")
    (tmp_path / "gnss").mkdir()
    shutil.copy(log, tmp_path / "gnss")
    with open_drive(tmp_path) as drive:
        fixes = drive.fixes()
    assert (fixes.stamp_sigma_s == 0.0).all()
    (tmp_path / "imu").mkdir()
    rows = (f"{ns / 1e9:.3f},0.0,0.0,0.1\n" for ns in fixes.time_ns.tolist())
    header = "timestamp_utc_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s\n"
    (tmp_path / "imu" / "imu.csv").write_text(header + "".join(rows))
    with open_drive(tmp_path) as drive:
        assert np.isnan(drive.fixes().stamp_sigma_s).all()


def test_oxts_rows_bring_their_gyro(shared_data: SharedData) -> None:
    log = read_fix_log(shared_data("kitti_oxts/2011_09_30_drive_0020.csv"))
    gyro = log.motion.gyro
    assert gyro is not None
    interpolated = sum(fix.quality == 6 for fix in log.fixes)
    assert len(gyro.time_ns) == len(log.fixes) - interpolated
    assert (gyro.time_ns[1:] > gyro.time_ns[:-1]).all()


def test_a_table_of_too_many_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text("time_s,lat_deg,lon_deg\n" + "1000000000,41.0,2.0\n" * 30)
    assert len(read_fix_log(path).fixes) == 30
    with limited(rows=29), pytest.raises(LimitError, match=r"long\.csv has more than 29 rows; cut"):
        read_fix_log(path)


# --- positions that are not decimal degrees

DAY = "2011-06-15T10:30:11Z"


@pytest.mark.parametrize(
    ("lat", "lon"),
    [
        ("41.65 N", "4.72 W"),
        ("N41.65", "w 4.72"),
        ("41°39'0\"N", "4°43'12.0\"W"),
        ("41 39 0", "-4 43 12"),
        ("41° 39.0' N", "4° 43.2' W"),
        ("416500000", "-47200000"),
    ],
)
def test_ways_of_writing_a_position(tmp_path: Path, lat: str, lon: str) -> None:
    fix = only(tmp_path, f"time;lat;lon\n{DAY};{lat};{lon}\n".replace('"', "″"))
    assert fix.lat_deg == pytest.approx(41.65, abs=1e-9)
    assert fix.lon_deg == pytest.approx(-4.72, abs=1e-9)


@pytest.mark.parametrize("lat", ["41.65 W", "-41.65 S", "41 70 0", "N41.65N", "forty"])
def test_a_text_that_is_no_latitude(tmp_path: Path, lat: str) -> None:
    fails(tmp_path, f"time;lat;lon\n{DAY};{lat};4.72\n", "is not a number")


def test_degrees_and_minutes_in_one_number(tmp_path: Path) -> None:
    text = f"time,lat,lon\n{DAY},4139.0,-443.2\n"
    fails(tmp_path, text, r"lat 4139 and lon -443.2 .* --columns lat_lon_units=ddmm")
    fix = only(tmp_path, text, "lat_lon_units=ddmm")
    assert (fix.lat_deg, fix.lon_deg) == (pytest.approx(41.65), pytest.approx(-4.72))


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (
            "easting,northing",
            "northing and easting in metres .* --columns crs=EPSG:32630",
        ),
        ("lon,lat", r"lat 4612300 and lon 357000\.5 are no degrees; .* --columns crs=EPSG:32630"),
        (
            "east,height",
            r"has no column lat_deg.* name it: lat = .COLUMN. in .* or --columns lat=COLUMN",
        ),
    ],
)
def test_coordinates_of_a_projection(tmp_path: Path, names: str, match: str) -> None:
    text = f"time,{names}\n{DAY},357000.5,4612300\n"
    fails(tmp_path, text, match)
    if "height" not in names:
        fix = only(tmp_path, text, "crs=EPSG:32630")
        assert (fix.lat_deg, fix.lon_deg) == (
            pytest.approx(41.6493, abs=1e-3),
            pytest.approx(-4.7175, abs=1e-3),
        )


def test_projections_that_cannot_be(tmp_path: Path) -> None:
    text = f"time,x,y\n{DAY},357000.5,4612300\n"
    with pytest.raises(ConfigError, match="which PROJ does not know"):
        read(tmp_path, text, "crs=EPSG:99999")
    with pytest.raises(ConfigError, match="leave lat_lon_units out"):
        columns_from_text("crs=EPSG:32630,lat_lon_units=e7")


# --- what spreadsheets and loggers in Europe write


def test_umlauts_in_utf_8_without_a_byte_order_mark(tmp_path: Path) -> None:
    text = f"Zeit;Länge;Breite\n{DAY};-4,72;41,65\n"
    for encoded in (text.encode(), text.encode("latin-1"), text.encode("utf-8-sig")):
        fix = only(tmp_path, encoded, "time=Zeit,lon=Länge,lat=Breite")
        assert fix.lon_deg == -4.72


@pytest.mark.parametrize(
    "stamp", ["15.06.2011 10:30:11,25", "15.6.2011 10:30:11.25", "15.06.2011, 10:30:11.250"]
)
def test_a_date_with_its_day_first(tmp_path: Path, stamp: str) -> None:
    fix = only(tmp_path, f"time;lat;lon\n{stamp};41,65;-4,72\n")
    assert fix.time_ns == 1_308_133_811_250_000_000
    day, clock = stamp.replace(",", " ", 1).split(maxsplit=1) if ", " in stamp else stamp.split()
    fix = only(tmp_path, f"date;time;lat;lon\n{day};{clock};41,65;-4,72\n")
    assert fix.time_ns == 1_308_133_811_250_000_000


def test_a_time_of_day_alone(tmp_path: Path) -> None:
    text = "time,lat,lon\n10:30:11.25,41.65,-4.72\n"
    fails(tmp_path, text, r"time '10:30:11.25' can not be read .* time_epoch=")
    empty = text + ",41.65,-4.72\n"
    fix = only(tmp_path, empty, "time_epoch=2011-06-15T00:00:00Z")  # no time is not the time 0
    assert fix.time_ns == 1_308_133_811_250_000_000


# --- as other programs write them


@pytest.mark.parametrize("name", ["GPST", "gpst", "Time (GPST)"])
def test_dates_of_the_clock_of_gps(name: str, tmp_path: Path) -> None:
    log = read(tmp_path, f"{name},lat,lon\n2024/06/01 12:00:18.5,41,-4\n")
    assert log.fixes[0].time_ns == START_NS + 500_000_000
    assert "date and time of GPS" in log.notes[0]
    zoned = only(tmp_path, f"{name},lat,lon\n2024-06-01T12:00:00Z,41,-4\n")
    assert zoned.time_ns == START_NS


@pytest.mark.parametrize("name", ["gpstime", "gpsTime", "GPSTimeStamp", "gps_time"])
def test_gpst_within_a_word_is_not_the_clock_of_gps(name: str, tmp_path: Path) -> None:
    assert only(tmp_path, f"{name},lat,lon\n2024-06-01 12:00:00,41,-4\n").time_ns == START_NS


def test_the_clock_of_gps_for_a_number_is_refused(tmp_path: Path) -> None:
    """Numbers have a unit; that the zone would be ignored was not reported."""
    text = f"time,lat,lon\n{START_S}000,41,-4\n"
    fails(tmp_path, text, "leave time_zone out.*--columns time_units=gps_ms ", "time_zone=GPST")
    assert only(tmp_path, text, "time_zone=UTC").time_ns == START_NS
    fails(tmp_path, text, r"leave time_zone out.*--gnss-offset SECONDS", "time_zone=+02:00")
    gps_s = "time,lat,lon\n1401278418,41,-4\n"
    assert only(tmp_path, gps_s, "time_zone=GPST,time_units=gps_s").time_ns == START_NS


@pytest.mark.parametrize(
    ("week", "tow"),
    [
        ("GPS Week", "Seconds of Week"),
        ("week", "sow"),
        ("GPSWeek", "GPSSeconds"),
        ("WNc", "TOW"),
        ("GWk", "GMS"),
        ("gps_week", "iTOW_ms"),
    ],
)
def test_weeks_of_gps_by_their_names(week: str, tow: str, tmp_path: Path) -> None:
    of_week = "561618250" if "MS" in tow.upper() else "561618.25"
    assert (
        only(tmp_path, f"{week},{tow},lat,lon\n2316,{of_week},41,-4\n").time_ns
        == START_NS + 25 * 10**7
    )


def test_a_zone_is_not_of_weeks(tmp_path: Path) -> None:
    text = "week,tow,lat,lon\n2316,561618.0,41,-4\n"
    for zone in ("+02:00", "UTC"):
        message = "time_zone is .*, but tow '561618.0' is a number; leave time_zone out"
        fails(tmp_path, text, message, f"time_zone={zone}")
    assert only(tmp_path, text, "time_zone=GPST").time_ns == START_NS


def test_a_column_beside_weeks_that_begin_anew_is_named(tmp_path: Path) -> None:
    text = f"timestamp,week,tow,lat,lon\n{START_S},268,561618,41,-4\n"
    fails(
        tmp_path,
        text,
        "week 268 is before 1999.*add 2048.*, or name a column .*--columns time=COL",
    )
    assert only(tmp_path, text, "time=timestamp").time_ns == START_NS


def test_heights_of_rows_without_a_fix_do_not_count(tmp_path: Path) -> None:
    """Receivers write any height before their first position."""
    rows = [
        f"{START_S + k},41,-4,{h},{q}" for k, (h, q) in enumerate([(-17e3, 0)] * 2 + [(700, 4)])
    ]
    header = "time,lat,lon,alt,quality"
    assert len(read(tmp_path, "\n".join([header, *rows])).fixes) == 3
    rows[2] = rows[2].replace("700", "700000")
    fails(tmp_path, "\n".join([header, *rows]), "alt is 700000 m, higher than any field")


def test_heights_are_judged_by_the_whole_file(tmp_path: Path) -> None:
    """Not by each block of rows."""
    heights = [-17e3] * 9_000 + [700] * 9_001
    rows = [f"{START_S + k},41,-4,{h}" for k, h in enumerate(heights)]
    assert len(read(tmp_path, "\n".join(["time,lat,lon,alt", *rows])).fixes) == 18_001


def test_a_time_of_week_is_no_time_by_itself(tmp_path: Path) -> None:
    """Its milliseconds are as large as seconds since 1970 once were."""
    text = "timestamp,timeOfWeek,lat,lon\n77000000,561618000,41,-4\n"
    fails(tmp_path, text, r"no column with UTC times .*week=COLUMN,tow=COLUMN")


@pytest.mark.parametrize(
    ("name", "cell", "height_m"),
    [
        ("alt_ft", "1000", 304.8),
        ("Altitude (feet)", "1000", 304.8),
        ("Elevation [US ft]", "3937", 1200.0),
        ("altitude (meters)", "750.5", 750.5),
        ("alt", "1000 ft", 304.8),
        ("alt", "750.5 m", 750.5),
        ("alt_mm", "750500", 750.5),
        ("alt_mm", "750.5 m", 750.5),
    ],
)
def test_units_of_heights(name: str, cell: str, height_m: float, tmp_path: Path) -> None:
    fix = only(tmp_path, f"time,lat,lon,{name}\n{START_S},41,-4,{cell}\n")
    assert fix.height_m == pytest.approx(height_m, rel=1e-12)


@pytest.mark.parametrize(
    ("lat", "lon", "unit", "said"),
    [
        ("lat_e7", "lon_e7", 1e-7, ""),
        ("Latitude [rad]", "Longitude [rad]", 180.0 / math.pi, ""),
        ("lat_rad", "lon_rad", 180.0 / math.pi, ""),
        ("lat", "lon", 180.0 / math.pi, "lat_lon_units=rad"),
    ],
)
def test_units_of_positions(lat: str, lon: str, unit: float, said: str, tmp_path: Path) -> None:
    text = f"time,{lat},{lon}\n{START_S},{41.65 / unit!r},{-4.72 / unit!r}\n"
    fix = only(tmp_path, text, said)
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((41.65, -4.72), abs=1e-12)


def test_a_height_in_an_unknown_unit_is_an_error(tmp_path: Path) -> None:
    fails(tmp_path, f"time,lat,lon,alt\n{START_S},41,-4,7 ells\n", "alt '7 ells' is not a number")


def test_heights_that_no_field_has_are_refused(tmp_path: Path) -> None:
    """As of u-blox, PX4 and MAVLink, which count millimetres."""
    text = f"time,lat,lon,alt\n{START_S},410000000,-40000000,800100\n"
    fails(tmp_path, text, r"alt is 800100 m.*--columns height_units=mm for")
    fix = only(tmp_path, text, "height_units=mm")
    assert (fix.lat_deg, fix.height_m) == (pytest.approx(41.0), pytest.approx(800.1))


def test_the_height_above_the_ellipsoid_goes_first(tmp_path: Path) -> None:
    names = "alt,alt_ellipsoid", "altitude_msl_m,altitude_ellipsoid_m", "height,H-Ell"
    for pair in names:
        assert only(tmp_path, f"time,lat,lon,{pair}\n{START_S},41,-4,750,800\n").height_m == 800.0


def test_topics_as_names(tmp_path: Path) -> None:
    """As PlotJuggler writes them."""
    text = f"__time,/fix/latitude,/fix/longitude,/fix/altitude\n{START_S}.0,41,-4,800\n"
    assert only(tmp_path, text).height_m == 800.0
