"""Which kind of log a file is: by its content, whatever its name."""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid.core import ConfigError, GnssError, NoFramesError, RecordingError
from fieldgrid.recordings import Columns, DriveOptions, files, open_drive
from fieldgrid.recordings.tables.logs import read_fix_log
from tests.poses.gnss.sentences import gga, rmc
from tests.poses.gnss.test_ubx import ITOW_MS, message, pvt

SharedData = Callable[[str], Path]

NMEA = (
    b"$GPRMC,103011.00,A,4139.022737,N,00443.214186,W,0.039,,150611,,,D*6A\r\n"
    b"$GPGGA,103011.00,4139.022737,N,00443.214186,W,2,08,1.0,737.921,M,52.4,M,3.4,0138*58\r\n"
)
TABLE = b"time_ns,lat_deg,lon_deg,height_m,quality\n1308133811000000000,41.65,-4.72,787.4,4\n"
UBX = pvt() + pvt(1, ITOW_MS + 1000)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "drive.dat"


@pytest.mark.parametrize(("data", "count"), [(NMEA, 1), (TABLE, 1), (UBX, 2)])
@pytest.mark.parametrize("packed", [False, True])
def test_the_content_tells_the_kind(data: bytes, count: int, packed: bool, path: Path) -> None:
    path.write_bytes(gzip.compress(data) if packed else data)
    log = read_fix_log(path)
    assert (len(log.fixes), log.notes) == (count, ())


def test_what_is_said_of_columns_is_for_tables(path: Path) -> None:
    columns = Columns({"time": "t", "lat": "a", "lon": "b"})
    path.write_bytes(NMEA)
    assert len(read_fix_log(path, columns).fixes) == 1
    path.write_bytes(b't,a,b,raw\n1308133811,41,-4,"' + NMEA[:-2] + b'"\n')
    assert read_fix_log(path, columns).fixes[0].lat_deg == 41.0
    assert read_fix_log(path).fixes[0].quality == 2


def test_of_two_protocols_the_one_with_more_positions_is_taken(path: Path) -> None:
    path.write_bytes(NMEA + UBX)
    log = read_fix_log(path)
    assert (len(log.fixes), log.fixes[0].quality) == (2, 1)
    assert log.notes == ("drive.dat: 2 positions in UBX and 1 in NMEA; UBX is taken.",)
    second = NMEA.replace(b"103011", b"103012").replace(b"*6A", b"*69").replace(b"*58", b"*5B")
    path.write_bytes(UBX[: len(pvt())] + NMEA + second)
    log = read_fix_log(path)
    assert (len(log.fixes), log.fixes[0].quality) == (2, 2)
    assert "NMEA is taken" in log.notes[0]


def test_messages_without_a_position_are_said(path: Path) -> None:
    path.write_bytes(message((10, 9), bytes(60)))
    log = read_fix_log(path)
    assert len(log.fixes) == 0
    assert log.notes == ("drive.dat: 1 UBX message, but no NAV-PVT with a position; switch it on.",)


@pytest.mark.parametrize("data", [b"", b"\r\n", b"\0" * 1000])
def test_an_empty_file_is_said_to_be_empty(data: bytes, path: Path) -> None:
    path.write_bytes(data)
    log = read_fix_log(path)
    assert (len(log.fixes), log.notes) == (0, ("drive.dat: the file is empty.",))


@pytest.mark.parametrize("data", [b"\x7fELF" + bytes(range(256)), b"just words\nof a diary\n"])
def test_what_is_no_log(data: bytes, path: Path) -> None:
    path.write_bytes(data)
    with pytest.raises(GnssError, match=r"drive\.dat is no bag and no GNSS log that is known"):
        read_fix_log(path)


def test_damaged_gzip_is_named(path: Path) -> None:
    path.write_bytes(gzip.compress(TABLE * 100)[:-9])
    with pytest.raises(RecordingError, match=r"drive\.dat is a damaged gzip file"):
        read_fix_log(path)


def test_a_bomb_is_not_unpacked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MAX_LOG_BYTES", 1 << 20)
    path.write_bytes(gzip.compress(NMEA + bytes(2 << 20)))
    with pytest.raises(RecordingError, match="more than 1048576 bytes, unpacked; cut it"):
        read_fix_log(path)


def test_what_is_not_there(tmp_path: Path) -> None:
    for missing in (tmp_path / "no.nmea", tmp_path / "no\0.nmea", tmp_path):
        with pytest.raises(RecordingError, match=r"cannot be read|not a regular file"):
            read_fix_log(missing)


def test_a_log_is_a_drive_without_frames(shared_data: SharedData) -> None:
    path = shared_data("vineyard_two_lanes") / "gnss" / "gnss_rtk.nmea"
    with open_drive(path) as drive:
        assert (drive.kind, drive.name, drive.gnss_source) == ("GNSS log", "gnss_rtk", path.name)
        assert drive.fixes() == read_fix_log(path).fixes
        assert drive.gnss_sha256() == hashlib.sha256(path.read_bytes()).hexdigest()
        assert [stream.role for stream in drive.streams()] == ["fix"]
        with pytest.raises(NoFramesError, match="is a GNSS log and has no frames"):
            drive.recording()
    for options in (
        DriveOptions("other.nmea"),
        DriveOptions(topics={"left": "/a"}),
        DriveOptions(mounting=Path("mounting.json")),
        DriveOptions(image_time_offset_ns=0),
    ):
        with pytest.raises(ConfigError, match="leave --"):
            open_drive(path, options)


def test_every_real_log_is_read_or_refused_in_a_sentence(shared_data: SharedData) -> None:
    for folder in ("gnss/gpsd_corpus", "gnss/nmea_misc"):
        for path in sorted(shared_data(folder).iterdir()):
            try:
                fixes = read_fix_log(path).fixes
            except (GnssError, RecordingError):
                continue
            assert all(abs(fix.lat_deg) <= 90 and abs(fix.lon_deg) <= 180 for fix in fixes)


def test_a_log_is_the_same_however_many_fixes_are_held_at_once(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Records become columns while a log is read; no fix is lost or moved at a seam."""
    path.write_bytes(rmc("115959") + b"".join(gga(f"1200{k:02}") for k in range(40)))
    at_once = read_fix_log(path).fixes
    assert len(at_once) == 40
    for held in (1, 100, 1000):
        monkeypatch.setattr("fieldgrid.recordings.tables.stream_log._CHUNK", held)
        assert read_fix_log(path).fixes == at_once
