"""ISO 11783-10 time logs: what the header declares, and what a hostile one does."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Quality, RecordingError
from fieldgrid.geometry import Fix
from fieldgrid.recordings.tables.logs import read_fix_log

SharedData = Callable[[str], Path]

START_NS = 1_717_243_200_000_000_000  # 2024-06-01 12:00:00
DAY = 16_223  # of that, since 1980
NOON_MS = 43_200_000
FULL = '<TIM A="" D="4"><PTN A="" B="" C="" D="" E="" F="" G="" H="" I=""/>{}</TIM>'
PLAIN = '<TIM A="" D="4"><PTN A="" B="" D=""/>{}</TIM>'
SPEED = '<DLV A="008D" B="" C="DET-1"/><DLV A="018d" B="" C="DET-1"/>'


def values(*pairs: tuple[int, int]) -> bytes:
    return bytes([len(pairs)]) + b"".join(struct.pack("<Bi", *pair) for pair in pairs)


def full(second: int = 0, lat: int = 416500000, hdop: int = 7, utc: int = NOON_MS) -> bytes:
    local = struct.pack("<IH", NOON_MS + 7_200_000 + 1000 * second, DAY)
    position = struct.pack("<iiiBHHB", lat, -47200000, 787400, 4, 13, hdop, 17)
    return local + position + struct.pack("<IH", utc + 1000 * second, DAY)


def plain(second: int = 0, status: int = 15, days: int = DAY) -> bytes:
    time = struct.pack("<IH", NOON_MS + 1000 * second, days)
    return time + struct.pack("<iiB", 416500000, -47200000, status)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path, FULL.format(SPEED), full() + values((0, 1), (1, -1500)) + full(1) + values())
    return tmp_path


def write(folder: Path, header: str, data: bytes, name: str = "TLG00001") -> None:
    (folder / f"{name}.XML").write_text(header)
    (folder / f"{name}.bin").write_bytes(data)


def test_all_attributes_are_read_and_values_hold_until_they_change(folder: Path) -> None:
    log = read_fix_log(folder / "TLG00001.bin")
    first = Fix(START_NS, 41.65, -4.72, 787.4, 4, 17, 0.7, speed_mps=1.5)
    assert list(log.fixes) == [first, first._replace(time_ns=START_NS + 10**9)]
    assert log.notes == ("TLG00001.bin: speed from the logged value DDI 018D.",)


def test_header_and_folder_lead_to_the_log(folder: Path) -> None:
    (folder / "TASKDATA.XML").write_text("<ISO11783_TaskData/>")
    expected = read_fix_log(folder / "TLG00001.bin")
    for path in (folder / "TLG00001.XML", folder / "TASKDATA.XML", folder):
        assert read_fix_log(path) == expected
    write(folder, PLAIN.format(""), plain() + values(), "TLG00002")
    with pytest.raises(RecordingError, match=r"2 time logs: TLG00001\.bin, TLG00002\.bin; give on"):
        read_fix_log(folder)


def test_what_is_not_there_is_assumed_and_said(folder: Path) -> None:
    write(folder, PLAIN.format(""), plain() + values() + plain(1, 5) + values())
    log = read_fix_log(folder)
    assert list(log.fixes) == [
        Fix(START_NS, 41.65, -4.72, 0.0, Quality.UNKNOWN),
        Fix(START_NS + 10**9, 41.65, -4.72, 0.0, Quality.RTK_FLOAT),
    ]
    assert log.notes == (
        "TLG00001.bin: no UTC in the records; the terminal's clock is taken for UTC.",
        "TLG00001.bin: no heights; taken as 0 m.",
        "TLG00001.bin: no position status: the quality is unknown.",
    )


def test_constants_of_the_header_hold_for_all_records(folder: Path) -> None:
    header = '<TIM A=""><PTN A="" B="" C="12500" D="2"/></TIM>'
    write(folder, header, struct.pack("<IHii", NOON_MS, DAY, 416500000, -47200000) + values())
    assert list(read_fix_log(folder).fixes) == [
        Fix(START_NS, 41.65, -4.72, 12.5, Quality.DIFFERENTIAL)
    ]


def test_values_that_are_not_available_are_none(folder: Path) -> None:
    absent = full(utc=0xFFFFFFFF, hdop=0xFFFF)
    nowhere = full(lat=0x7FFFFFFF)
    before = plain(days=1)
    write(folder, FULL.format(""), absent + values() + nowhere + values())
    log = read_fix_log(folder)
    (fix,) = log.fixes
    assert (fix.hdop, fix.time_ns) == (None, START_NS + 7200 * 10**9)
    assert log.notes == ("TLG00001.bin: 1 record without a position skipped.",)
    write(folder, PLAIN.format(""), before + values())
    assert read_fix_log(folder).notes[-1] == "TLG00001.bin: 1 record without a time skipped."


def test_a_proprietary_speed_is_known_by_its_unit(folder: Path) -> None:
    header = PLAIN.format('<DLV A="EA60" B=""/><DLV A="EA7E" B=""/>')
    write(folder, header, plain() + values((1, 36)))
    (folder / "TaskData.xml").write_text(
        '<T><DPD A="1" B="EA60" F="1"/><DPD A="2" B="ea7e" F="13"/>'
        '<DVP A="1" B="0" C="1" E="km"/><DVP A="13" B="0" C="0.1" E="km/h"/></T>'
    )
    assert read_fix_log(folder).fixes[0].speed_mps == pytest.approx(1.0)


def test_a_record_that_is_cut_off_is_said(folder: Path) -> None:
    data = plain() + values() + plain(1) + b"\x02\x00"
    write(folder, PLAIN.format(SPEED), data)
    log = read_fix_log(folder)
    assert len(log.fixes) == 1
    assert log.notes[-1] == "TLG00001.bin: the last 17 bytes are no whole record, and skipped."


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("<TIM", "is not XML"),
        ("", "is not XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><TIM A="&b;"/>', "declares a document type"),
        ('<TIM A=""/>', "declares no position"),
        ('<TIM A=""><PTN A="" D=""/></TIM>', "declares no position"),
        ('<PTN A="" B=""/>', "declares no position"),
        ('<TIM A="2024-06-01T12:00:00"><PTN A="" B=""/></TIM>', "TIM has a fixed time"),
        ('<TIM A=""><PTN A="" B="" C="high"/></TIM>', "PTN C is 'high', not a number"),
        ('<TIM A=""><PTN A="" B=""/><DLV A="1"/></TIM>', "DLV has the DDI '1'"),
    ],
)
def test_a_header_that_is_none(header: str, message: str, folder: Path) -> None:
    write(folder, header, plain() + values())
    with pytest.raises(RecordingError, match=rf"TLG00001\.XML.*{message}"):
        read_fix_log(folder)


def test_a_value_that_is_not_declared_is_damage(folder: Path) -> None:
    write(folder, PLAIN.format(SPEED), plain() + values() + plain() + values((2, 5)))
    with pytest.raises(RecordingError, match=r"byte 16: value 2 of a record is not among the 2"):
        read_fix_log(folder)


def test_half_a_log_is_named(folder: Path) -> None:
    (folder / "TLG00001.XML").unlink()
    with pytest.raises(RecordingError, match=r"TLG00001\.xml is not beside it; copy both"):
        read_fix_log(folder)


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_records_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    folder = tmp_path_factory.getbasetemp()
    write(folder, FULL.format(SPEED), full() + values() + data)
    try:
        log = read_fix_log(folder / "TLG00001.bin")
    except RecordingError:
        return
    assert log.fixes[0].lat_deg == 41.65


def test_the_harvester_is_read_as_others_read_it(shared_data: SharedData) -> None:
    folder = shared_data("gnss/isoxml_harvester")
    for name in ("TLG00005", "TLG00020"):
        raw = read_fix_log(folder / "raw" / "ValidTimeLogs" / f"{name}.bin").fixes
        table = read_fix_log(folder / "csv" / f"ValidTimeLogs_{name}.csv").fixes
        assert [fix[:5] for fix in raw] == [fix[:5] for fix in table]
        assert [fix.speed_mps for fix in raw] == pytest.approx([fix.speed_mps for fix in table])
