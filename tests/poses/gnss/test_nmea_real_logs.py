"""The logs of many real receivers, read whole and compared with an independent reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from fieldgrid.geometry import Fix
from fieldgrid.poses import NmeaStream
from tests.conftest import SHARED_DATA
from tests.poses.gnss.sentences import parse_nmea

SharedData = Callable[[str], Path]

FOLDERS = ("gnss/gpsd_corpus", "gnss/nmea_misc")
LOGS = [
    f"{folder}/{path.name}"
    for folder in FOLDERS
    for path in sorted((SHARED_DATA / folder).glob("*.*"))
] or [f"{folder}/*" for folder in FOLDERS]


def fixes_of(data: bytes, step: int) -> list[Fix]:
    stream = NmeaStream()
    pieces = (data[k : k + step] for k in range(0, len(data), step))
    return [fix for piece in pieces for fix in stream.feed(piece)] + stream.finish()


def independent_gga(data: bytes) -> Iterator[tuple[str, float, float, int]]:
    """Time, latitude, longitude and quality of every GGA line with a fix, the plain way."""
    for line in data.decode("latin-1").splitlines():
        start, star = line.rfind("$"), line.rfind("*")
        if start < 0 or star != len(line) - 3 or line[start + 3 : start + 7] != "GGA,":
            continue
        total = 0
        for character in line[start + 1 : star]:
            total ^= ord(character)
        f = line[start:star].split(",")
        if f"{total:02X}" != line[star + 1 :].upper() or f[6] in ("", "0") or not f[2]:
            continue
        with suppress(ValueError):
            lat, lon = (int(v[: -len(m)]) + float(m) / 60 for v, m in _split(f[2], f[4]))
            yield f[1], -lat if f[3] == "S" else lat, -lon if f[5] == "W" else lon, int(f[6])


def _split(*angles: str) -> list[tuple[str, str]]:
    """Each angle, and the part of it that is minutes."""
    return [(angle, angle[angle.index(".") - 2 :]) for angle in angles]


@pytest.mark.parametrize("name", LOGS)
def test_a_real_log_gives_no_wild_fix_and_no_crash(name: str, shared_data: SharedData) -> None:
    data = shared_data(name).read_bytes()
    fixes = fixes_of(data, 1 << 16)
    for fix in fixes:
        assert all(math.isfinite(value) for value in fix if value is not None)
        assert -90.0 <= fix.lat_deg <= 90.0
        assert -180.0 <= fix.lon_deg <= 180.0
        assert -1000.0 < fix.height_m < 10_000.0
    assert fixes_of(data, 997) == fixes
    # No fix is where no GGA is, unless the log has none.
    places = {(round(lat, 9), round(lon, 9)) for _, lat, lon, _ in independent_gga(data)}
    for fix in fixes if places else ():
        assert (round(fix.lat_deg, 9), round(fix.lon_deg, 9)) in places


# How many different times pynmea2 1.19 finds in the GGA sentences with a position, checksums
# verified; in the last two, which have none, in RMC.
COUNTS = {
    "gnss/gpsd_corpus/ais-nmea.log": 164,
    "gnss/gpsd_corpus/bundg_zeus_9.log": 138,
    "gnss/gpsd_corpus/cat-ms352.log": 40,
    "gnss/gpsd_corpus/gpsdf.log": 51,
    "gnss/gpsd_corpus/haicom-305N.log": 68,
    "gnss/gpsd_corpus/nmea-rtk.log": 122,
    "gnss/gpsd_corpus/quectel-l76k-dual.log": 130,
    "gnss/gpsd_corpus/sirfstarv-nmea.log": 59,
    "gnss/gpsd_corpus/skytraq-dgps.log": 96,
    "gnss/gpsd_corpus/telit-pls83-w.log": 10,
    "gnss/gpsd_corpus/ublox-zed-f9r.log": 30,
    "gnss/nmea_misc/AMOD_AGL3080_20121104_134730.txt": 622,
    "gnss/nmea_misc/dotMorten_TrimbleR2SampleData.txt": 34,
    "gnss/nmea_misc/lawn_PX1172RH_gps_data_logger_202312301505.txt": 901,
    "gnss/gpsd_corpus/magellan-ec10.log": 21,
    "gnss/gpsd_corpus/meinberg-gps164.log": 70,
}


@pytest.mark.parametrize(("name", "count"), COUNTS.items())
def test_as_many_fixes_are_found_as_another_parser_finds(
    name: str, count: int, shared_data: SharedData
) -> None:
    data = shared_data(name).read_bytes()
    fixes = parse_nmea([data]).fixes
    assert len(fixes) == count
    first_of_time: dict[str, tuple[float, float, int]] = {}
    for time, *place in independent_gga(data):
        first_of_time.setdefault(time, tuple(place))
    for fix, expected in zip(fixes, first_of_time.values(), strict=bool(first_of_time)):
        assert (fix.lat_deg, fix.lon_deg, fix.quality) == pytest.approx(expected, abs=1e-9)


def test_a_real_two_antenna_receiver_gives_its_heading(shared_data: SharedData) -> None:
    data = shared_data("gnss/gpsd_corpus/skytraq-PX1172RH_DS.log").read_bytes()
    fixes = parse_nmea([data]).fixes
    assert fixes[0].heading_deg == pytest.approx(-115.72)
    assert all(fix.heading_deg is not None for fix in fixes)


def test_a_real_log_of_rmc_alone_gives_fixes(shared_data: SharedData) -> None:
    log = parse_nmea([shared_data("gnss/gpsd_corpus/meinberg-gps164.log").read_bytes()])
    assert (len(log.fixes), log.no_height) == (70, 70)
