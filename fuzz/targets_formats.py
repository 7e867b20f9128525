"""UBX, tables of fixes, ISO 11783-10 time logs: no crash, no wild fix."""

from __future__ import annotations

import math
import re
import struct

from fieldgrid.core import FieldgridError
from fieldgrid.geometry import Fix
from fieldgrid.poses import UbxParser
from fieldgrid.recordings.tables.logs import read_fix_log
from fuzz.target import Target, real_starts, written

_UBX_KINDS = ((1, 4, 18), (1, 7, 92), (1, 0x14, 36), (1, 0x3C, 64), (1, 0x61, 4))
_PVT = struct.pack(
    "<IHBBBBBBIiBBBBiiiiIIiiiiiIIHHIiHH", 561_618_000, 2024, 6, 1, 12, 0, 0, 7, 20, 0, 3, 131, 0,
    17, -47200000, 416500000, 787_400, 735_000, 14, 9, 0, 0, 0, 1500, 27000000, 50, 200000, 130, 0,
    0, 0, 0, 0,
)  # fmt: skip
_HEADER = (
    b'<TIM A="" D="4"><PTN A="" B="" C="" D="" E="" F="" G="" H="" I=""/>'
    b'<DLV A="008D" B="" C="DET-1"/><DLV A="018D" B="" C="DET-1"/></TIM>'
)
_RECORD = struct.pack(
    "<IHiiiBHHBIHBBi", 43_200_000, 16_223, 416500000, -47200000, 787400, 4, 13, 7, 17, 43_200_000,
    16_223, 1, 1, 1500,
)  # fmt: skip
_TABLES = (
    b"time_ns,lat_deg,lon_deg,height_m,quality\n1717243200000000000,41.65,-4.72,787.4,4\n",
    b"time;lat;lng;status;head;head_valid\n2024-06-01T12:00:00.5+02:00;41,5;-4,7;RTK;9;True\n",
    b"gps_week,tow,lat,lon,num_sats\n2316,561618.25,41,-4,\"['9', '8']\"\n",
    b"#date\ttime\tLatitude\tLongitude\n2024/06/01\t12:00:00\t41\t-4\n",
)


def fuzz_ubx(data: bytes) -> None:
    parser = UbxParser()
    whole = parser.feed(data) + parser.close()
    counts = parser.counts
    for fix in whole:
        _check_fix(fix)
    parser = UbxParser()
    pieces = [fix for byte in data for fix in parser.feed(bytes([byte]))] + parser.close()
    assert (pieces, parser.counts) == (whole, counts), "fixes differ when bytes arrive one by one"


def fuzz_table(data: bytes) -> None:
    _open(data, "log.csv")


def fuzz_iso_header(data: bytes) -> None:
    _open(2 * _RECORD, "TLG00001.bin", data)


def fuzz_iso_records(data: bytes) -> None:
    _open(data, "TLG00001.bin", _HEADER)


def fuzz_log(data: bytes) -> None:
    _open(data, "log.dat")


def _open(data: bytes, name: str, header: bytes = b"") -> None:
    path = written(data, name)
    if header:
        written(header, path.with_suffix(".xml").name)
    try:
        log = read_fix_log(path)
    except FieldgridError:
        return
    for fix in log.fixes:
        _check_fix(fix, on_earth=name == "log.ubx")


def _check_fix(fix: Fix, on_earth: bool = True) -> None:
    """Coordinates that are not on Earth come out of tables, for conditioning to reject."""
    assert all(math.isfinite(value) for value in fix if value is not None), fix
    assert 0 < fix.time_ns < 1 << 63, fix
    assert not on_earth or (abs(fix.lat_deg) <= 90.0 and abs(fix.lon_deg) <= 180.0), fix
    assert fix.heading_deg is None or -180.0 < fix.heading_deg <= 180.0, fix
    assert fix.speed_mps is None or fix.speed_mps >= 0.0, fix


def mend_ubx(data: bytes) -> bytes:
    """The data with the right checksum wherever a message fits."""
    mended = bytearray(data)
    for match in re.finditer(rb"\xb5\x62", data):
        length = int.from_bytes(data[match.end() + 2 : match.end() + 4], "little")
        stop = match.end() + 4 + length
        if stop + 2 <= len(data):
            mended[stop : stop + 2] = _checksum(bytes(mended[match.end() : stop]))
    return bytes(mended)


def _checksum(body: bytes) -> bytes:
    first = second = 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return bytes((first, second))


def ubx_seeds() -> list[bytes]:
    messages = []
    for kind, number, length in _UBX_KINDS:
        payload = _PVT if number == 7 else _PVT[:4] * (length // 4) + bytes(length % 4)
        body = bytes((kind, number)) + length.to_bytes(2, "little") + payload
        messages.append(b"\xb5\x62" + body + _checksum(body))
    return [b"".join(messages), *messages, *real_starts("gnss/gpsd_corpus/ublox*.log")]


def table_seeds() -> list[bytes]:
    return [*_TABLES, *real_starts("gnss/*/*.csv", "gnss/tractor2025/compact/*.csv")]


def record_seeds() -> list[bytes]:
    return [2 * _RECORD, *real_starts("gnss/isoxml_harvester/raw/*/*.bin")]


_SOLUTIONS = (
    b"%  GPST  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
    b"2316 561618.250  41.651234567  -4.721234567  800.1234  1  12  0.0080  0.0060  0.0190\n",
    b"%  UTC  latitude(d'\")  longitude(d'\")  height(m)  Q  ns  sdn(m)  sde(m)  sdu(m)  age(s)\n"
    b"2024/06/01 12:00:18.250  41 39 04.4444  -4 43 16.4444  800.1  2  9  0.3  0.2  0.5  1.20\n",
)


def fuzz_solution(data: bytes) -> None:
    _open(data, "drive.pos")


TARGETS = [
    Target("ubx", fuzz_ubx, ubx_seeds, mend_ubx),
    Target("table", fuzz_table, table_seeds),
    Target("iso-header", fuzz_iso_header, lambda: [_HEADER]),
    Target("iso-records", fuzz_iso_records, record_seeds),
    Target("solution", fuzz_solution, lambda: list(_SOLUTIONS)),
    Target("log", fuzz_log, lambda: [*ubx_seeds(), *table_seeds()]),
]
