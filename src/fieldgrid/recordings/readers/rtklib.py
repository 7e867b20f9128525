"""Solutions of RTKLIB and Emlid: `.pos` and `.llh`, whose columns are parted by blanks or a mark.

RTKLIB 2.4.2 manual, appendix B.1: remarks begin with ``%``, and one of them names the columns, the
first by the scale of time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Quality, RecordingError, check_rows, quoted
from fieldgrid.geometry import NOT_SAID, FixColumns, ecef_to_geodetic
from fieldgrid.recordings.tables.columns import Columns, how_to_say
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.tables import open_lines
from fieldgrid.recordings.tables.times import (
    UNITS,
    TimeScale,
    gps_week_ns,
    second_ns,
    to_utc_ns,
    zone_scale,
)

SUFFIXES = frozenset({".pos", ".llh"})
"""File name endings of solutions, in lower case."""

_QUALITIES = np.full(100, Quality.UNKNOWN)
_QUALITIES[:8] = (
    *(Quality.NONE, Quality.RTK_FIXED, Quality.RTK_FLOAT, Quality.SBAS, Quality.DIFFERENTIAL),
    *(Quality.GPS, Quality.DIFFERENTIAL, Quality.ESTIMATED),  # that before the last is PPP
)
"""By RTKLIB's Q."""
_ZONES = {"GPST": "GPST", "UTC": "UTC", "JST": "+09:00"}
"""Of the words for the scale of time."""
_PLACES = ("latitude(deg)", "latitude(d'\")", "x-ecef(m)", "e-baseline(m)")
_, _IN_PARTS, _GEOCENTRIC, _BASELINE = _PLACES
_SIGMAS = ("sdn(m)", "sde(m)", "sdx(m)", "sdy(m)", "sdz(m)")
_MOST_SATELLITES = 10_000
_BLOCK_ROWS = 1 << 13

_TIME = re.compile(r"\d{4}/\d\d/\d\d \d\d:\d\d:\d\d(?:\.\d*)?|\d{3,4} \d{1,6}(?:\.\d*)?")
# Without a header, as Emlid's receivers write: degrees, a height, Q, a number of satellites, and
# eight numbers more, without which it may be any log, whose quality is not RTKLIB's Q.
_BARE = re.compile(
    rf"(?:{_TIME.pattern})(?: -?\d+\.\d{{6,}}){{2}} -?\d+\.\d+ [0-7] \d+(?: -?\d+\.\d+){{8}}(?: |$)"
)
_FRAME = re.compile(r"lat/lon/height=(\w+)/(\w+)")
_MOST_REMARKS = 200


class _Header(NamedTuple):
    """What the remarks say: the word for the scale of time, the names of the columns after it in
    lower case (a name a word), datum and kind of heights."""

    scale: str = ""
    names: tuple[str, ...] = (
        *(_PLACES[0], "longitude(deg)", "height(m)", "q", "ns", "sdn(m)", "sde(m)", "sdu(m)"),
        *("sdne(m)", "sdeu(m)", "sdun(m)", "age(s)"),
    )
    datum: str = ""
    heights: str = ""

    def with_remark(self, line: str) -> _Header:
        """The header, completed by what a further line of remarks says."""
        header, frame = self, _FRAME.search(line)
        if frame is not None:
            header = header._replace(datum=frame[1], heights=frame[2])
        if _names_columns(line):
            scale, *names = _words(line.lstrip("% "))
            names = [name.lower() for name in names]
            if names[0] == _IN_PARTS:
                lat, lon, *rest = names
                names = [lat, "minute", "second", lon, "minute of lon", "second of lon", *rest]
            header = header._replace(scale=scale, names=tuple(names))
        return header


def is_solution(head: bytes) -> bool:
    """Whether a file that begins so is a solution, with its header or without."""
    lines = head.decode("latin-1").splitlines()
    if any(_names_columns(line) for line in lines[:_MOST_REMARKS]):
        return True
    first = next((line for line in lines if line.strip() and not line.startswith("%")), "")
    return _BARE.match(" ".join(_words(first))) is not None


def read_solution(path: Path, columns: Columns | None = None) -> FixLog:
    """The fixes of a solution. `columns` may say by `time_zone` whether times are GPST or UTC,
    which nothing else says where there is no header.

    `sigma_m` is the root of the mean square of the stated errors of the axes. RecordingError for
    coordinates that count from a base, for another datum than WGS 84, for unknown times, and for
    a second header that differs from the first.
    """
    with open_lines(path) as lines:
        header, first = _Header(), ""
        for first in lines:
            if first.strip() and not first.startswith("%"):
                break
            header = header.with_remark(first)
        zone = ("" if columns is None else columns.time_zone) or _ZONES.get(header.scale, "")
        is_gps = zone_scale(zone or "UTC").gps
        dated = not first.strip() or "/" in _words(first)[0]
        _refuse(path, header, zone, weeks_of_utc=not (is_gps or dated))
        scale = zone_scale(zone)
        parts, read = [FixColumns.of([])], 0
        words = _words_of_rows(path, chain([first], lines), header)
        while block := list(islice(words, _BLOCK_ROWS)):
            read += len(block)
            check_rows(read, path)
            parts.append(_fixes(block, header, scale, dated))
    fixes = FixColumns.joined(parts)
    ahead = f"{scale.zone_s / 3600:+g} h" if scale.zone_s else ""
    codes = "" if header.scale else ", and without a header: its quality is taken for RTKLIB's Q"
    damaged = read - len(fixes)
    told = (
        (True, f"a solution of RTKLIB, times in {'GPST' if is_gps else 'UTC'}{ahead}{codes}."),
        (header.heights == "geodetic", "its heights are above mean sea level."),
        (damaged, f"{damaged} damaged lines skipped."),
    )
    return FixLog(fixes, tuple(f"{path.name}: {what}" for holds, what in told if holds))


def _refuse(path: Path, header: _Header, zone: str, *, weeks_of_utc: bool) -> None:
    named = f"calls its time {quoted(header.scale)}" if header.scale else "has no header"
    refused = (
        (
            not zone,
            f"is a solution like RTKLIB's, and {named}: its times may be those of GPS or UTC, 18 s "
            f"apart; say which they are: {how_to_say(time_zone='GPST')}, or UTC in its place",
        ),
        (
            header.names[0] == _BASELINE,
            "counts metres from a base station; let RTKLIB write latitude, longitude and height: "
            "out-solformat = llh",
        ),
        (
            header.datum.lower() in ("tokyo", "pulkovo"),
            f"has positions in the datum {header.datum}; let RTKLIB write them in WGS84",
        ),
        (
            not {"q", "ns"} <= set(header.names),
            "lacks the columns Q and ns; let RTKLIB write it again",
        ),
        (weeks_of_utc, "has weeks of UTC; let RTKLIB write times as GPST, or as date and time"),
    )
    for holds, why in refused:
        if holds:
            raise RecordingError(f"{path} {why}.")


def _names_columns(line: str) -> bool:
    return line.startswith("%") and any(place in line for place in _PLACES)


def _words(line: str) -> list[str]:
    mark = next((mark for mark in ",;\t" if mark in line), " ")
    return line.replace(mark, " ").split()


def _words_of_rows(path: Path, lines: Iterable[str], header: _Header) -> Iterator[list[str]]:
    """The words of each line of data. Files that were joined may have a header each, which must
    agree."""
    for line in lines:
        if not line.startswith("%"):
            if words := _words(line):
                yield words
        elif header.with_remark(line) != header:
            raise RecordingError(
                f"{path} has another header among its rows, {quoted(line.strip())}, which differs "
                "from what came before; give what follows it as a file of its own."
            )


def _numbers(words: list[str], width: int, dated: bool) -> list[float]:
    """The numbers of a row after its time; none of one that is not whole, or has a date where the
    first row has a week."""
    stamp = " ".join(words[:2])
    if len(words) < width or _TIME.fullmatch(stamp) is None or ("/" in stamp) != dated:
        return []
    if dated and second_ns(stamp[:19]) is None:
        return []
    try:
        return list(map(float, words[2:width]))
    except ValueError:
        return []


def _fixes(block: list[list[str]], header: _Header, scale: TimeScale, dated: bool) -> FixColumns:
    """The fixes of rows; those that can be none are left out."""
    width = 2 + len(header.names)
    found = [(words, n) for words in block if (n := _numbers(words, width, dated))]
    rows = [words for words, _ in found]
    numbers = np.array([n for _, n in found], dtype=np.float64).reshape(-1, width - 2)
    of = dict(zip(header.names, numbers.T, strict=True))
    lat, lon, height = numbers.T[:3]
    if header.names[0] == _GEOCENTRIC:
        lat, lon, height = ecef_to_geodetic(lat, lon, height)
    elif header.names[0] == _IN_PARTS:
        lat, lon, height = _degrees(numbers[:, :3]), _degrees(numbers[:, 3:6]), numbers[:, 6]
    if dated:
        times_ns = to_utc_ns([" ".join(row[:2]) for row in rows], scale, decimal_comma=False)
    else:
        times_ns = gps_week_ns([row[0] for row in rows], [row[1] for row in rows], UNITS["s"])
    keep: Bool = (np.abs(lat) <= 90.0) & (np.abs(lon) <= 360.0) & np.isfinite(height)
    keep &= (times_ns > 0) & (of["ns"] >= 0.0) & (of["ns"] < _MOST_SATELLITES)
    errors = [of[name] for name in _SIGMAS if name in of] or [np.zeros(len(rows))]
    with np.errstate(over="ignore"):  # of a damaged word like 1e300; then it is not said
        sigma = np.sqrt(np.mean(np.square(errors), axis=0))
    # What is computed afterwards also takes corrections that came later.
    age_s = np.abs(of.get("age(s)", np.full(len(rows), np.nan)))
    fixes = FixColumns.of(
        times_ns,
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        quality=_QUALITIES[np.clip(of["q"], 0, len(_QUALITIES) - 1).astype(np.int64)],
        satellites=np.where(keep, of["ns"], NOT_SAID),
        sigma_m=np.where((sigma > 0.0) & np.isfinite(sigma), sigma, np.nan),
        age_s=np.where(np.isfinite(age_s), age_s, np.nan),
    )
    return fixes[keep]


def _degrees(parts: Float64) -> Float64:
    """Of degrees, minutes and seconds [n, 3]; the sign stands before the degrees, also before 0."""
    size = np.abs(parts[:, 0]) + parts[:, 1] / 60.0 + parts[:, 2] / 3600.0
    return np.copysign(size, parts[:, 0])
