"""Solutions of RTKLIB and Emlid: `.pos` and `.llh`, whose columns are parted by blanks or a mark.

RTKLIB 2.4.2 manual, appendix B.1: remarks begin with ``%``, and one of them names the columns, the
first by the scale of time.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import (
    Float64,
    Int64,
    Quality,
    RecordingError,
    bounded_lines,
    check_rows,
    quoted,
)
from fieldgrid.geometry import FixColumns, ecef_to_geodetic
from fieldgrid.recordings.files import open_log_bytes
from fieldgrid.recordings.tables.columns import Columns, how_to_say
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.times import (
    NO_TIME,
    TimeScale,
    UnreadableTimeError,
    gps_week_ns,
    to_utc_ns,
    zone_scale,
)

SUFFIXES = frozenset({".pos", ".llh"})
"""File name endings of solutions, in lower case."""

_QUALITIES = (
    Quality.NONE,
    Quality.RTK_FIXED,
    Quality.RTK_FLOAT,
    Quality.SBAS,
    Quality.DIFFERENTIAL,
    Quality.GPS,
    Quality.DIFFERENTIAL,  # PPP, which has no code in GGA
    Quality.ESTIMATED,
)
"""By RTKLIB's Q."""

_SCALES = {"GPST": "GPST", "UTC": "UTC", "JST": "+09:00"}
_Place = tuple[str, str, str]
_LLH = ("latitude(deg)", "longitude(deg)", "height(m)")
_DMS = ("latitude(d'\")", "longitude(d'\")", "height(m)")
_XYZ = ("x-ecef(m)", "y-ecef(m)", "z-ecef(m)")
_ENU = ("e-baseline(m)", "n-baseline(m)", "u-baseline(m)")
_WIDTHS = {_LLH: 3, _DMS: 7, _XYZ: 3, _ENU: 3}
"""Of a place, the count of its words."""

_SIGMAS = {
    _LLH: ("sdn(m)", "sde(m)"),
    _DMS: ("sdn(m)", "sde(m)"),
    _XYZ: ("sdx(m)", "sdy(m)", "sdz(m)"),
}
_REST = ("q", "ns", "sdn(m)", "sde(m)", "sdu(m)", "sdne(m)", "sdeu(m)", "sdun(m)", "age(s)")
_MARKS = ",;\t"

_TIME = re.compile(r"\d{4}/\d\d/\d\d \d\d:\d\d:\d\d(?:\.\d*)?|\d{3,4} \d{1,6}(?:\.\d*)?")
# Without a header, as Emlid's receivers write: degrees, a height, Q, a number of satellites, and
# eight numbers more, without which it may be any log, whose quality is not RTKLIB's Q.
_BARE = re.compile(
    rf"(?:{_TIME.pattern})(?: -?\d+\.\d{{6,}}){{2}} -?\d+\.\d+ [0-7] \d+(?: -?\d+\.\d+){{8}}(?: |$)"
)
_MOST_REMARKS = 200
_MOST_SATELLITES = 10_000
_BLOCK_ROWS = 1 << 13


class _Columns(NamedTuple):
    """What the remarks say: the word for the scale of time, the columns of the place, the names of
    those after them in lower case, what parts them ('' for blanks), datum and kind of heights."""

    scale: str = ""
    place: _Place = _LLH
    rest: tuple[str, ...] = _REST
    mark: str = ""
    datum: str = ""
    heights: str = ""


def is_solution(head: bytes) -> bool:
    """Whether a file that begins so is a solution, with its header or without."""
    lines = head.decode("latin-1").splitlines()
    if any(_names_columns(line) for line in lines[:_MOST_REMARKS]):
        return True
    first = next((line for line in lines if line.strip() and not line.startswith("%")), "")
    return _BARE.match(" ".join(next(_words([first], _mark(first)), []))) is not None


def read_solution(path: Path, columns: Columns | None = None) -> FixLog:
    """The fixes of a solution. `columns` may say by `time_zone` whether times are GPST or UTC,
    which nothing else says where there is no header.

    `sigma_m` is the root of the mean square of the stated errors of the axes. RecordingError for
    coordinates that count from a base, for another datum than WGS 84, for unknown times, and for
    a second header that differs from the first.
    """
    with _open_lines(path) as lines:
        found, first = _read_header(lines)
        said = "" if columns is None else columns.time_zone
        if not said and found.scale not in _SCALES:
            header = f"calls its time {quoted(found.scale)}" if found.scale else "has no header"
            raise RecordingError(
                f"{path} is a solution like RTKLIB's, and {header}: its times may be those of GPS "
                "or UTC, 18 s apart; say which they are: "
                f"{how_to_say(time_zone='GPST')}, or UTC in its place."
            )
        scale = zone_scale(said or _SCALES[found.scale])
        if found.place == _ENU:
            raise RecordingError(
                f"{path} counts metres from a base station; let RTKLIB write latitude, longitude "
                "and height: out-solformat = llh."
            )
        if found.datum.lower() in ("tokyo", "pulkovo"):
            raise RecordingError(
                f"{path} has positions in the datum {found.datum}; let RTKLIB write them in WGS84."
            )
        if "q" not in found.rest or "ns" not in found.rest:
            raise RecordingError(f"{path} lacks the columns Q and ns; let RTKLIB write it again.")
        words = _words(_of_one_header(path, chain([first], lines), found), found.mark)
        width = 0
        parts: list[FixColumns] = []
        read = 0
        while block := list(islice(words, _BLOCK_ROWS)):
            read += len(block)
            check_rows(read, path)
            width = width or _count_words(found, block)
            times, numbers = _whole_rows(block, width)
            if not scale.gps and any("/" not in day for day, _ in times):
                raise RecordingError(
                    f"{path} has weeks of UTC; let RTKLIB write times as GPST, or as date and time."
                )
            parts.append(_fixes(times, numbers, found, scale))
    fixes = FixColumns.joined(parts)
    return FixLog(fixes, _notes(path.name, found, scale, read - len(fixes)))


def _notes(name: str, found: _Columns, scale: TimeScale, damaged: int) -> tuple[str, ...]:
    clock = "GPST" if scale.gps else f"UTC{scale.zone_s / 3600:+g} h" if scale.zone_s else "UTC"
    codes = "" if found.scale else ", and without a header: its quality is taken for RTKLIB's Q"
    notes = [f"{name}: a solution of RTKLIB, times in {clock}{codes}."]
    if found.heights == "geodetic":
        notes.append(f"{name}: its heights are above mean sea level.")
    if damaged:
        notes.append(f"{name}: {damaged} damaged lines skipped.")
    return tuple(notes)


@contextmanager
def _open_lines(path: Path) -> Iterator[Iterator[str]]:
    with open_log_bytes(path) as stream:
        text = io.TextIOWrapper(stream, encoding="latin-1")
        try:
            yield bounded_lines(text, path, without="\0")
        finally:
            text.detach()


def _names_columns(line: str) -> bool:
    return line.startswith("%") and any(place[0] in line for place in _WIDTHS)


def _read_header(lines: Iterator[str]) -> tuple[_Columns, str]:
    """What the remarks say, and the first line after them."""
    found = _Columns()
    for line in lines:
        if line.strip() and not line.startswith("%"):
            return (found if found.scale else found._replace(mark=_mark(line))), line
        found = _with_remark(found, line)
    return found, ""


def _with_remark(found: _Columns, line: str) -> _Columns:
    """The columns `found`, completed by what a further line of remarks says."""
    frame = re.search(r"lat/lon/height=(\w+)/(\w+)", line)
    if frame is not None:
        found = found._replace(datum=frame[1], heights=frame[2])
    if not _names_columns(line):
        return found
    mark = _mark(line)
    scale, *names = line.lstrip("% ").replace(mark or " ", " ").split()
    place = next(place for place in _WIDTHS if place[0] in line)
    rest = tuple(name.lower() for name in names[3:])
    return found._replace(scale=scale, place=place, rest=rest, mark=mark)


def _of_one_header(path: Path, lines: Iterable[str], found: _Columns) -> Iterator[str]:
    """The lines as they are; files that were joined may have a header each, which must agree."""
    for line in lines:
        if line.startswith("%") and _with_remark(found, line) != found:
            raise RecordingError(
                f"{path} has another header among its rows, {quoted(line.strip())}, which differs "
                "from what came before; give what follows it as a file of its own."
            )
        yield line


def _mark(line: str) -> str:
    return next((mark for mark in _MARKS if mark in line), "")


def _words(lines: Iterable[str], mark: str) -> Iterator[list[str]]:
    """The words of each line of data."""
    for line in lines:
        if line.strip() and not line.startswith("%"):
            yield (line.replace(mark, " ") if mark else line).split()


def _count_words(found: _Columns, block: Sequence[list[str]]) -> int:
    """Of a whole row, by the header; else by most rows, which have Q and ns at least."""
    place = 2 + _WIDTHS[found.place]
    if found.scale:
        return place + len(found.rest)
    ((most, _),) = Counter(map(len, block)).most_common(1)
    return max(most, place + 2)


def _whole_rows(block: Sequence[list[str]], width: int) -> tuple[list[list[str]], Float64]:
    """The two words of time of the rows that are whole (`width` words, a time and numbers), and the
    numbers after them [row, column]."""
    times: list[list[str]] = []
    numbers: list[list[float]] = []
    for words in block:
        if len(words) < width or _TIME.fullmatch(f"{words[0]} {words[1]}") is None:
            continue
        try:
            numbers.append([float(word) for word in words[2:width]])
        except ValueError:
            continue
        times.append(words[:2])
    return times, np.array(numbers, dtype=np.float64).reshape(len(times), width - 2)


def _fixes(
    times: list[list[str]], numbers: Float64, found: _Columns, scale: TimeScale
) -> FixColumns:
    """The fixes of rows; those that can be none are left out."""
    width = _WIDTHS[found.place]
    place, rest = numbers[:, :width], numbers[:, width:]
    of = {name: rest[:, k] for k, name in enumerate(found.rest[: rest.shape[1]])}
    lat, lon, height = _positions(place, found.place)
    unsaid = np.full(len(place), np.nan)
    sigmas = [of[name] for name in _SIGMAS[found.place] if name in of]
    with np.errstate(over="ignore"):  # of a damaged word like 1e300; then it is not said
        sigma = np.sqrt(np.mean(np.square(sigmas), axis=0)) if sigmas else unsaid
    times_ns = _times_ns(times, scale)
    keep = (np.abs(lat) <= 90.0) & (np.abs(lon) <= 360.0) & np.isfinite(height) & (times_ns > 0)
    keep &= (of["ns"] >= 0.0) & (of["ns"] < _MOST_SATELLITES)
    return FixColumns.of(
        times_ns[keep],
        lat_deg=lat[keep],
        lon_deg=lon[keep],
        height_m=height[keep],
        quality=[
            _QUALITIES[int(code)] if 0 <= code < len(_QUALITIES) else Quality.UNKNOWN
            for code in of["q"][keep].tolist()
        ],
        satellites=of["ns"][keep].astype(np.int64),
        sigma_m=np.where((sigma > 0.0) & np.isfinite(sigma), sigma, np.nan)[keep],
        # What is computed afterwards also takes corrections that came later.
        age_s=np.abs(of.get("age(s)", unsaid))[keep],
    )


def _positions(place: Float64, names: _Place) -> tuple[Float64, Float64, Float64]:
    if names == _XYZ:
        return ecef_to_geodetic(*place.T)
    if names == _LLH:
        return place[:, 0], place[:, 1], place[:, 2]
    return _degrees(place[:, :3]), _degrees(place[:, 3:6]), place[:, 6]


def _degrees(parts: Float64) -> Float64:
    """Of degrees, minutes and seconds [n, 3]; the sign stands before the degrees, also before 0."""
    size = np.abs(parts[:, 0]) + parts[:, 1] / 60.0 + parts[:, 2] / 3600.0
    return np.copysign(size, parts[:, 0])


def _times_ns(times: list[list[str]], scale: TimeScale) -> Int64:
    """UTC nanoseconds, :data:`NO_TIME` of what is no time."""
    try:
        if not times or "/" in times[0][0]:
            return to_utc_ns([" ".join(words) for words in times], scale, decimal_comma=False)
        return gps_week_ns([week for week, _ in times], [of_week for _, of_week in times], 9)
    except UnreadableTimeError:
        if len(times) == 1:
            return np.array([NO_TIME], dtype=np.int64)
        return np.concatenate([_times_ns([words], scale) for words in times])
