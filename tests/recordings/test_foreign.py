"""Files and folders of other programs: what is not read is named, with what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.core import GnssError, RecordingError
from fieldgrid.recordings import DriveOptions, open_drive
from fieldgrid.recordings.tables.logs import read_fix_log
from tests.poses.gnss.sentences import gga, rmc, sentence
from tests.recordings.test_fix_table import START_NS

NOISE = bytes(range(90)) * 5


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.gpx", b'<?xml version="1.0"?>\n<gpx version="1.1"><trk>', "GPX track.*gpsbabel -i gpx"),
        ("a.kml", b"<?xml?><kml><Document>", "is KML.*give the log of the receiver"),
        ("a.json", b'{"type": "FeatureCollection", "features": []}', "is GeoJSON.*ogr2ogr"),
        ("b.json", b'{\n "width": 3, "rows": [1, 2]}', "is JSON.*give the log of the receiver"),
        ("b.xml", b'<?xml version="1.0"?>\n<tasks/>', "is XML.*give the log of the receiver"),
        ("Field.txt", b"2024-April-07 06:50:41 PM\n$FieldDir\nNew\n", "AgOpenGPS.*let AgIO log"),
        (
            "a.24o",
            b"     3.03           OBSERVATION DATA    M                   RINEX VERSION / TYPE\n",
            r"is RINEX.*rnx2rtkp, and give its \.pos file",
        ),
        ("a.rtcm3", b"\xd3\x00\x13\x3e\xd0\x00" + NOISE, "is RTCM 3.*rnx2rtkp"),
        ("a.sbf", b"$@\x12\x34\xa7\x0f\x60\x00" + NOISE, "Septentrio's SBF.*NMEA"),
        ("a.gps", b"\xaa\x44\x12\x1c\x2a\x00" + NOISE, "binary log of NovAtel.*NMEA"),
        ("a.T04", b"\x00\x10" + NOISE, "raw log of Trimble.*RINEX"),
        ("a.ulg", b"ULog\x01\x12\x35\x01" + NOISE, "ULog of PX4.*ulog2csv"),
        ("a.bin", b"\xa3\x95\x80\x80\x59" + NOISE, "DataFlash.*mavlogdump"),
        ("a.xlsx", b"PK\x03\x04" + NOISE, "ZIP archive.*save a spreadsheet as CSV"),
        ("a.gpkg", b"SQLite format 3\0" + NOISE, "SQLite database, no bag"),
        ("a.svo", b"SVO" + NOISE, "of a ZED camera.*nanoseconds"),
        ("a.svo2", b"\x89MCAP0\r\n" + NOISE, "of a ZED camera.*nanoseconds"),
    ],
)
def test_a_log_of_another_program_is_named(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        open_drive(tmp_path / name)
    assert "and not read; " in str(caught.value)
    # The same of a log that --gnss names.
    (tmp_path / "drive" / "gnss").mkdir(parents=True)
    if not name.startswith("a.svo2"):
        with pytest.raises(RecordingError, match=message):
            open_drive(tmp_path / "drive", DriveOptions(gnss=tmp_path / name))


def test_sentences_among_foreign_messages_are_read(tmp_path: Path) -> None:
    """A receiver of Septentrio writes both into one file."""
    sentence = b"$GPGGA,120000.00,4139.0000,N,00443.0000,W,4,12,0.8,750.0,M,50.0,M,1.0,0000*57\r\n"
    rmc = b"$GPRMC,120000.00,A,4139.0000,N,00443.0000,W,0.0,0.0,010624,,,R*51\r\n"
    (tmp_path / "a.sbf").write_bytes(b"$@\x12\x34\xa7\x0f" + NOISE + b"\r\n" + sentence + rmc)
    (fix,) = read_fix_log(tmp_path / "a.sbf").fixes
    assert (fix.time_ns, fix.lat_deg) == (START_NS, 41.65)


@pytest.mark.parametrize("start", [b"\xd3\x00\x13\x3e\xd0\x00", b"$@\x12\x34", b"\xaa\x44\x12\x1c"])
def test_sentences_long_after_the_start_are_read(start: bytes, tmp_path: Path) -> None:
    content = start + NOISE * 200 + b"\r\n" + rmc("120000.00") + gga("120000.00")
    (tmp_path / "a.log").write_bytes(content)
    assert len(read_fix_log(tmp_path / "a.log").fixes) == 1
    # Positions without a date are reported as such, and no fixes at all as the kind of the file.
    (tmp_path / "a.log").write_bytes(content.replace(b"RMC", b"RMX"))
    with pytest.raises(GnssError, match="no valid RMC or ZDA"):
        read_fix_log(tmp_path / "a.log")
    (fix,) = read_fix_log(tmp_path / "a.log", epoch_ns=START_NS).fixes
    assert fix.time_ns // 10**9 % 86_400 == 43_200
    assert 0 <= START_NS - fix.time_ns + 43_200 * 10**9 < 86_400 * 10**9
    (tmp_path / "a.log").write_bytes(start + NOISE * 200 + b"\r\n" + sentence("GPGSA,A,1"))
    with pytest.raises(RecordingError, match="and not read; "):
        read_fix_log(tmp_path / "a.log")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("left000000.png", "right000000.png"), "as ZED's export writes: move them into left/"),
        (("run_Infrared_1_12.5.png",), "as RealSense's rs-convert writes: put Infrared 1 into"),
        (("drive.nmea", "remarks.txt"), r"It holds drive\.nmea: give such a file itself"),
        (("remarks.txt",), r"give one of these\.$"),
    ],
)
def test_a_folder_of_another_program_is_named(
    names: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    for name in names:
        (tmp_path / name).write_bytes(b"\x89")
    with pytest.raises(RecordingError, match=message):
        open_drive(tmp_path)
