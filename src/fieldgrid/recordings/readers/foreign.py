"""Files and folders of other programs that are not read: what each is, and what to do with it."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import RecordingError

_RTCM, _RTCM_RESERVED = 0xD3, 0xFC
_NAMES_AT_MOST = 2000
"""Names of a folder that are looked at: what it is its first files tell."""

_TABLE = "write frames.csv with frame_id, timestamp_utc_s, left, right"
_GIVEN_ALONE = frozenset({".nmea", ".ubx", ".pos", ".llh"})


class _Kind(NamedTuple):
    """A kind of file: what an error calls it, what to do, how it begins or is called, and whether
    a receiver writes it into one file with NMEA."""

    what: str
    remedy: str
    is_it: Callable[[bytes, str], bool]
    with_nmea: bool = False


def _begins(*starts: bytes) -> Callable[[bytes, str], bool]:
    return lambda head, _: head.startswith(starts)


def _holds(*words: bytes) -> Callable[[bytes, str], bool]:
    return lambda head, _: any(word in head[:4096] for word in words)


def _named(*suffixes: str) -> Callable[[bytes, str], bool]:
    return lambda _, suffix: suffix in suffixes


def _is_rtcm(head: bytes, _: str) -> bool:
    return len(head) > 1 and head[0] == _RTCM and not head[1] & _RTCM_RESERVED


_GIVE_LOG = "give the log of the receiver, as NMEA, UBX, .pos or a table"
_SOLVE = "compute positions of it, as by RTKLIB's rnx2rtkp, and give its .pos file"
_KINDS = (
    _Kind(
        "a recording of a ZED camera",
        "export it: left and right images into left/ and right/, and the time of each "
        "(TIME_REFERENCE.IMAGE, nanoseconds) as the name of its files",
        _named(".svo", ".svo2"),
    ),
    _Kind(
        "a GPX track",
        "convert it: gpsbabel -i gpx -f IN.gpx -x transform,wpt=trk -o unicsv,utc=0 -F OUT.csv",
        _holds(b"<gpx"),
    ),
    _Kind("KML", _GIVE_LOG, _holds(b"<kml")),
    _Kind(
        "GeoJSON",
        "give the log of the receiver, or write it as a table: ogr2ogr -lco GEOMETRY=AS_XY "
        "OUT.csv IN.geojson",
        lambda head, _: head.lstrip()[:1] == b"{" and b"Feature" in head,
    ),
    _Kind("JSON", _GIVE_LOG, lambda head, _: head.lstrip()[:2] in (b'{"', b"{\n", b"{\r", b"[{")),
    _Kind(
        "a file of a field of AgOpenGPS, which keeps no times",
        "let AgIO log the NMEA of the drive, and give that",
        _holds(b"$FieldDir", b"$Boundary", b"$Contour", b"$CurveLines", b"$TrackLines"),
    ),
    _Kind(
        "RINEX (measurements, no positions)",
        _SOLVE,
        _holds(b"RINEX VERSION / TYPE", b"CRINEX VERS   / TYPE"),
    ),
    _Kind("RTCM 3 (corrections or measurements, no positions)", _SOLVE, _is_rtcm, with_nmea=True),
    _Kind(
        "Septentrio's SBF",
        "let the receiver write NMEA (GGA and RMC), or convert the file by Septentrio's SBF "
        "Converter",
        _begins(b"$@"),
        with_nmea=True,
    ),
    _Kind(
        "a binary log of NovAtel",
        "let the receiver write NMEA (GGA and RMC), or convert the file by NovAtel Convert",
        _begins(b"\xaa\x44\x12", b"\xaa\x44\x13"),
        with_nmea=True,
    ),
    _Kind(
        "a raw log of Trimble",
        "let the receiver write NMEA (GGA and RMC), or convert the file to RINEX and " + _SOLVE,
        _named(".t00", ".t01", ".t02", ".t04"),
    ),
    _Kind(
        "a ULog of PX4",
        "convert it by ulog2csv, and give its vehicle_gps_position table",
        _begins(b"ULog\x01\x12\x35"),
    ),
    _Kind(
        "a DataFlash log of ArduPilot",
        "write its GPS messages as a table: mavlogdump.py --types GPS --format csv LOG.bin",
        _begins(b"\xa3\x95\x80\x80"),
    ),
    _Kind("a ZIP archive", "unpack it; save a spreadsheet as CSV", _begins(b"PK\x03\x04")),
    _Kind("XML", _GIVE_LOG, _begins(b"<?xml", b"\xef\xbb\xbf<?xml")),
    _Kind("an SQLite database, no bag", "give the recording itself", _begins(b"SQLite format 3")),
)


def refuse_foreign(path: Path, head: bytes = b"") -> None:
    """RecordingError with what to do, where a file that is called and begins so is of a known kind
    that is not read; without a head only what its name tells."""
    for kind in _KINDS:
        if kind.is_it(head, path.suffix.lower()):
            raise RecordingError(f"{path} is {kind.what}, and not read; {kind.remedy}.")


def may_hold_nmea(path: Path, head: bytes) -> bool:
    """Whether a file that is called and begins so is of a kind that is not read, but into which
    receivers also write sentences of NMEA, maybe long after its start."""
    return any(kind.with_nmea and kind.is_it(head, path.suffix.lower()) for kind in _KINDS)


_ZED = [re.compile(rf"{side}\D*\d+\.(png|jpe?g)") for side in ("left", "right")]


def about_folder(path: Path) -> str:
    """What a folder that is no recording holds, and what would make it one, as a further sentence;
    '' where that is not known."""
    names = sorted(entry.name for entry in islice(path.iterdir(), _NAMES_AT_MOST))
    left, right = (next((n for n in names if picture.fullmatch(n)), None) for picture in _ZED)
    if left and right:
        return (
            f" It has {left} beside {right}, as ZED's export writes: move them into left/ and "
            f"right/ (mkdir left right; mv left?*.* left; mv right?*.* right), and {_TABLE}."
        )
    infrared = next((n for n in names if "_Infrared" in n and re.search(r"_[\d.]+\.png$", n)), None)
    if infrared:
        return (
            f" It has {infrared}, as RealSense's rs-convert writes: put Infrared 1 into left/, "
            f"Infrared 2 into right/, and {_TABLE}."
        )
    logs = [name for name in names if Path(name).suffix.lower() in _GIVEN_ALONE]
    return f" It holds {', '.join(logs)[:200]}: give such a file itself." if logs else ""
