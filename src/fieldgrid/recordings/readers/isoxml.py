"""ISO 11783-10 time logs: the binary `TLG*.bin` by its header `TLG*.xml`.

The header is an XML element whose empty attributes stand, for each record, in the binary; one
with a value holds for all records. The records have no marks to find back by, so that damage
in the middle costs the rest.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from fieldgrid.core import MIN_TIME_NS, RecordingError, counted, quoted
from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.recordings.files import check_regular, read_bytes
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.qualities import from_position_status

_MAX_HEADER_BYTES = 1 << 20
_MAX_TASKDATA_BYTES = 64 << 20
_MAX_BIN_BYTES = 512 << 20
_TASKDATA = "TASKDATA.XML"
_LOG_NAME = re.compile(r"TLG\d{5}\.(?:bin|xml)", re.IGNORECASE)

_DAY_NS = 86_400_000_000_000
_YEAR_1980_NS = 315_532_800_000_000_000
_MS_NS = 1_000_000
_NOWHERE = 0x7FFFFFFF  # also 2147483647e-7 degrees, which is no latitude
_ACTUAL_SPEED = 0x018D  # in mm/s
_USED = frozenset({"TIM", "PTN", "DLV", "DPD", "DVP"})
_SPEED_UNITS = {"km/h": 1 / 3.6, "m/s": 1.0, "mm/s": 1e-3}

# The attributes of PTN in the order of the binary: name, layout, value of one unit.
_POSITION = (
    ("A", "i", 1e7),  # latitude, degrees
    ("B", "i", 1e7),  # longitude, degrees
    ("C", "i", 1e3),  # up, metres
    ("D", "B", 1.0),  # status
    ("E", "H", 10.0),  # PDOP
    ("F", "H", 10.0),  # HDOP
    ("G", "B", 1.0),  # satellites
    ("H", "I", 1.0),  # UTC, ms of the day
    ("I", "H", 1.0),  # UTC, days since 1980
)
_ABSENT = {"C": -0x80000000, "E": 0xFFFF, "F": 0xFFFF, "G": 0xFF, "H": 0xFFFFFFFF, "I": 0xFFFF}


class _TimeLogHeader(NamedTuple):
    """What a time log's header declares: the layout of a record, constants, DDIs by index."""

    layout: struct.Struct
    names: tuple[str, ...]
    fixed: dict[str, float]
    ddis: tuple[int, ...]


class _Speed(NamedTuple):
    """The logged value that is a speed: metres a second are (value + offset) * scale."""

    place: int
    offset: float
    scale: float


def is_time_log(path: Path) -> bool:
    """Whether a path is a time log by its name, or a folder that holds such."""
    if path.is_dir():
        return bool(_logs(path))
    return _LOG_NAME.fullmatch(path.name) is not None or path.name.upper() == _TASKDATA


def read_time_log(path: Path) -> FixLog:
    """The fixes of a time log, given as its `.bin`, its `.xml`, or the folder of a single one."""
    binary = _the_log(path)
    header = _read_header(_beside(binary, binary.stem + ".xml"))
    data = read_bytes(binary, _MAX_BIN_BYTES)
    speed = _find_speed(header, _sibling(binary, _TASKDATA))
    return _Records(binary, header, speed).read(data)


def _logs(folder: Path) -> list[Path]:
    found = (p for p in folder.iterdir() if _LOG_NAME.fullmatch(p.name))
    return sorted(p for p in found if p.suffix.lower() == ".bin")


def _the_log(path: Path) -> Path:
    if path.name.upper() == _TASKDATA:
        path = path.parent
    if path.is_dir():
        logs = _logs(path)
        if not logs:
            raise RecordingError(
                f"{path} has no time log TLG*.bin; copy all of TASKDATA from the terminal."
            )
        if len(logs) != 1:
            names = ", ".join(log.name for log in logs)[:200]
            raise RecordingError(f"{path} has {len(logs)} time logs: {names}; give one of them.")
        return logs[0]
    if path.suffix.lower() == ".xml":
        return _beside(path, path.stem + ".bin")
    return path


def _sibling(path: Path, name: str) -> Path | None:
    """The file of a name in the same folder, upper and lower case alike."""
    wanted = name.lower()
    return next((p for p in sorted(path.parent.iterdir()) if p.name.lower() == wanted), None)


def _beside(path: Path, name: str) -> Path:
    found = _sibling(path, name)
    if found is None:
        raise RecordingError(
            f"{path} is half of an ISO 11783 time log, and {name} is not beside it; copy both."
        )
    check_regular(found)
    return found


def _elements(path: Path, max_bytes: int) -> Iterator[tuple[str, dict[str, str]]]:
    """Names and attributes of the elements that are used, in the order of the file.

    A document type is refused: it is what entity bombs and reads of other files start with.
    """
    found: list[tuple[str, dict[str, str]]] = []
    parser = expat.ParserCreate()

    def keep(name: str, attributes: dict[str, str]) -> None:
        if name in _USED:
            found.append((name, attributes))

    def refuse(*_: object) -> None:
        raise RecordingError(f"{path} declares a document type, which ISO 11783 files never do.")

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = keep
    try:
        parser.Parse(read_bytes(path, max_bytes), True)
    except (expat.ExpatError, ValueError, LookupError) as problem:
        if isinstance(problem, RecordingError):
            raise
        raise RecordingError(f"{path} is not XML: {problem}; copy it again.") from problem
    return iter(found)


def _read_header(path: Path) -> _TimeLogHeader:
    layout, names, fixed, ddis = "<", [], {}, []
    kinds = set()
    for kind, attributes in _elements(path, _MAX_HEADER_BYTES):
        kinds.add(kind)
        if kind == "TIM":
            names, layout = ["start_ms", "start_day"], "<IH"
            if attributes.get("A"):
                raise RecordingError(f"{path}: TIM has a fixed time; it is no header of a log.")
        elif kind == "PTN":
            for name, code, _ in _POSITION:
                text = attributes.get(name)
                if text == "":
                    names.append(name)
                    layout += code
                elif text is not None:
                    fixed[name] = _number(text, f"{path}: PTN {name}")
                    fixed[name] *= 1e-3 if name == "C" else 1.0  # millimetres here as well
        elif kind == "DLV":
            ddi = attributes.get("A", "")
            if re.fullmatch(r"[0-9A-Fa-f]{4}", ddi) is None:
                raise RecordingError(
                    f"{path}: DLV has the DDI {quoted(ddi)}; it must be four hex digits."
                )
            ddis.append(int(ddi, 16))
    if not {"TIM", "PTN"} <= kinds or "A" not in {*names, *fixed} or "B" not in {*names, *fixed}:
        raise RecordingError(f"{path} declares no position (TIM with PTN A and B); log one.")
    return _TimeLogHeader(struct.Struct(layout), tuple(names), fixed, tuple(ddis))


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e12:
        raise RecordingError(f"{what} is {quoted(text)}, not a number; correct it.")
    return value


def _find_speed(header: _TimeLogHeader, taskdata: Path | None) -> _Speed | None:
    """The standard's speed, else the first value that the task file shows in a unit of speed."""
    if _ACTUAL_SPEED in header.ddis:
        return _Speed(header.ddis.index(_ACTUAL_SPEED), 0.0, 1e-3)
    if taskdata is None:
        return None
    shown: dict[str, tuple[float, float]] = {}
    used: dict[str, str] = {}  # presentation by DDI
    for kind, attributes in _elements(taskdata, _MAX_TASKDATA_BYTES):
        if kind == "DPD" and attributes.get("F"):
            used.setdefault(attributes.get("B", "").upper(), attributes["F"])
        elif kind == "DVP" and attributes.get("E", "").strip() in _SPEED_UNITS:
            scale = _number(attributes.get("C", ""), f"{taskdata}: DVP C")
            offset = _number(attributes.get("B", "0"), f"{taskdata}: DVP B")
            shown[attributes.get("A", "")] = offset, scale * _SPEED_UNITS[attributes["E"].strip()]
    for index, ddi in enumerate(header.ddis):
        if used.get(f"{ddi:04X}") in shown:
            return _Speed(index, *shown[used[f"{ddi:04X}"]])
    return None


class _Records:
    """Reads the records of one log and counts what is odd about them."""

    def __init__(self, path: Path, header: _TimeLogHeader, speed: _Speed | None) -> None:
        self._path, self._header, self._speed = path, header, speed
        self._unplaced = self._untimed = 0
        self._unstated = False
        self._utc = {"H", "I"} <= {*header.names, *header.fixed}

    def read(self, data: bytes) -> FixLog:
        fixes, at = [], 0
        size, unpack = self._header.layout.size, self._header.layout.unpack_from
        speed_mps = None  # a record holds only what has changed
        while at + size < len(data):
            stop = at + size + 1 + 5 * data[at + size]
            if stop > len(data):
                break
            for value_at in range(at + size + 1, stop, 5):
                if data[value_at] >= len(self._header.ddis):
                    raise RecordingError(
                        f"{self._path}, byte {at}: value {data[value_at]} of a record is not "
                        f"among the {len(self._header.ddis)} of its header; the two do not belong "
                        "together, or the log is damaged: copy both again."
                    )
                if self._speed is not None and data[value_at] == self._speed.place:
                    raw = int.from_bytes(data[value_at + 1 : value_at + 5], "little", signed=True)
                    speed_mps = abs((raw + self._speed.offset) * self._speed.scale)
            raw_values = dict(zip(self._header.names, unpack(data, at), strict=True))
            fix = self._fix(raw_values, speed_mps)
            if fix is not None:
                fixes.append(fix)
            at = stop
        return FixLog(FixColumns.of_rows(fixes), tuple(self._notes(len(data) - at)))

    def _fix(self, raw: dict[str, int], speed_mps: float | None) -> Fix | None:
        value = {
            name: raw[name] / unit if name in raw else self._header.fixed[name]
            for name, _, unit in _POSITION
            if (name in raw and raw[name] != _ABSENT.get(name)) or name in self._header.fixed
        }
        if _NOWHERE in (raw.get("A"), raw.get("B")) or (value["A"], value["B"]) == (0.0, 0.0):
            self._unplaced += 1
            return None
        days, ms = raw["start_day"], raw["start_ms"]
        if "H" in value and "I" in value:
            days, ms = int(value["I"]), int(value["H"])
        time_ns = _YEAR_1980_NS + days * _DAY_NS + ms * _MS_NS
        if time_ns < MIN_TIME_NS or ms > 86_401_000:
            self._untimed += 1
            return None
        status, satellites = int(value.get("D", 15)), value.get("G")
        self._unstated |= status == 15
        return Fix(
            time_ns=time_ns,
            lat_deg=value["A"],
            lon_deg=value["B"],
            height_m=value.get("C", 0.0),
            quality=from_position_status(status),
            satellites=None if satellites is None else int(satellites),
            hdop=value.get("F"),
            speed_mps=speed_mps,
        )

    def _notes(self, left_bytes: int) -> Iterator[str]:
        name, header = self._path.name, self._header
        ddi = header.ddis[self._speed.place] if self._speed is not None else 0
        says = (
            (not self._utc, "no UTC in the records; the terminal's clock is taken for UTC"),
            ("C" not in {*header.names, *header.fixed}, "no heights; taken as 0 m"),
            (self._unstated, "no position status: the quality is unknown"),
            (self._speed is not None, f"speed from the logged value DDI {ddi:04X}"),
            (self._unplaced, f"{counted(self._unplaced, 'record')} without a position skipped"),
            (self._untimed, f"{counted(self._untimed, 'record')} without a time skipped"),
            (left_bytes, f"the last {left_bytes} bytes are no whole record, and skipped"),
        )
        return (f"{name}: {what}." for holds, what in says if holds)
