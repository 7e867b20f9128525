"""A forage harvester at about 1 Hz, positions only: the gear beside its work state.

With its header at work it drives forward (but for a few that stay down in reverse). It leaves a
row, stops, backs up, stops and drives into the next one: of that the log knows the work state
and, independently of our own code, the two cusps of the track, where consecutive displacements
turn back. Which of the pieces between two cusps were backed up is told from what comes before
and after, never from our gear:

- all work off from the first cusp to the second, within 2 to 60 s and 2 to 60 m;
- from the second cusp on it drives on without another cusp until work begins, within 60 s;
- and it had come out of work without a cusp within 60 s before the first (`both`).

A machine that comes out of a row forward and enters the next one forward, with two cusps
between, was in reverse between them. Where more cusps follow each other, nobody knows without a
judgement; those are counted as `loose` when only the way into the row is clear: the last of
several pieces. Both are printed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.heading_scores import DATA, make_fixes, numbers, percent, table
from fieldgrid.core import Quality
from fieldgrid.geometry import Datum, wrap_deg
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.recordings.tables.logs import read_fix_log

FOLDER = DATA / "gnss" / "isoxml_harvester"

MOVING_MPS = 0.3
CUSP_DEG, CUSP_REACH_M = 110.0, 0.5
LONGEST_S, LONGEST_M, SHORTEST_M = 60.0, 60.0, 2.0
ROW_S = 60.0
ROW_HALF_M, ROW_OFF_M, FEWEST_ON_ROW = 15.0, 0.1, 12

SINCE_1980_S = 315_532_800

_Float64 = npt.NDArray[np.float64]
_Int64 = npt.NDArray[np.int64]
_Bool = npt.NDArray[np.bool_]


class Log(NamedTuple):
    """n rows; `speed_mps` is the machine's own, unsigned; `work` its work state."""

    name: str
    time_ns: _Int64
    lat_deg: _Float64
    lon_deg: _Float64
    speed_mps: _Float64
    work: _Bool

    def points(self) -> _Float64:
        datum = Datum(float(self.lat_deg[0]), float(self.lon_deg[0]), 0.0)
        east, north, _ = datum.to_enu(self.lat_deg, self.lon_deg, np.zeros(len(self.lat_deg)))
        return np.stack([east, north], axis=1)


class Piece(NamedTuple):
    """Rows `first` to `last`, at which the track turns back, and how it came there: `both`
    when out of work and into work, else only into work."""

    first: int
    last: int
    both: bool


def logs() -> list[Log]:
    """Those with a work state."""
    found = [read_log(path) for path in sorted((FOLDER / "csv").glob("*.csv"))]
    return [log for log in found if log.work.any()]


def read_log(path: Path) -> Log:
    names = ("t_days1980_s", "lat", "lon", "drive_speed_0p1kmh", "work_state_ddi141")
    text = table(path, names)
    seconds = numbers(text[names[0]])
    return Log(
        path.stem.removeprefix("ValidTimeLogs_"),
        np.round((seconds + SINCE_1980_S) * 1e3).astype(np.int64) * 1_000_000,
        numbers(text["lat"]),
        numbers(text["lon"]),
        numbers(text[names[3]]) / 36.0,
        numbers(text[names[4]]) == 1.0,
    )


def cusps(points: _Float64) -> _Int64:
    """Rows where the displacement turns back from one to the next; displacements are taken
    between rows at least `CUSP_REACH_M` apart, so that a stop is one cusp."""
    kept = [0]
    for k in range(1, len(points)):
        if np.hypot(*(points[k] - points[kept[-1]])) >= CUSP_REACH_M:
            kept.append(k)
    steps = np.diff(points[kept], axis=0)
    course = np.degrees(np.arctan2(*steps.T))
    turned = np.abs(wrap_deg(np.diff(course))) > CUSP_DEG
    return np.array(kept, dtype=np.int64)[1:-1][turned]


def backed_up(log: Log) -> list[Piece]:
    """The pieces between two cusps that back up to a row, by the definition above."""
    points, seconds = log.points(), log.time_ns / 1e9
    at = cusps(points)
    steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    working = np.flatnonzero(sustained(log.work))
    pieces = []
    for i in range(len(at) - 1):
        first, last = int(at[i]), int(at[i + 1])
        length_m, span_s = steps[last] - steps[first], seconds[last] - seconds[first]
        if not (SHORTEST_M <= length_m <= LONGEST_M and span_s <= LONGEST_S):
            continue
        if log.work[first : last + 1].any():
            continue
        after = working[working > last]
        before = working[working < first]
        into = _near(after[:1], last, seconds) and (i + 2 == len(at) or at[i + 2] > after[0])
        out = _near(before[-1:], first, seconds) and (i == 0 or at[i - 1] < before[-1])
        if into:
            pieces.append(Piece(first, last, out))
    return pieces


def sustained(work: _Bool) -> _Bool:
    """Work of at least three rows: a header also flickers on in the middle of backing up."""
    core = np.convolve(work, np.ones(3), "same") == 3.0
    return np.convolve(core, np.ones(3), "same") > 0.0


def _near(row: _Int64, to: int, seconds: _Float64) -> bool:
    return bool(row.size) and abs(seconds[row[0]] - seconds[to]) <= ROW_S


def estimate(log: Log, speeds: bool) -> Estimate:
    fixes = make_fixes(log.time_ns, log.lat_deg, log.lon_deg, Quality.UNKNOWN)
    if speeds:
        fixes = fixes.replace(speed_mps=log.speed_mps)
    return estimate_poses(fixes)


def moving(log: Log) -> _Bool:
    """Rows at which the track itself moves on, forward or back."""
    away = np.hypot(*np.diff(log.points(), axis=0).T) / (np.diff(log.time_ns) / 1e9)
    return np.minimum(np.append(away, 0.0), np.concatenate([[0.0], away])) > MOVING_MPS


class Count(NamedTuple):
    """Epochs of a kind and how many of them are right, and those of accepted poses alone."""

    epochs: int
    right: int
    accepted: int
    accepted_right: int

    def __add__(self, other: tuple[int, ...]) -> Count:
        return Count(*(a + b for a, b in zip(self, other, strict=True)))

    def __str__(self) -> str:
        share = self.right / self.epochs if self.epochs else np.nan
        sure = self.accepted_right / self.accepted if self.accepted else np.nan
        return (
            f"{self.right:>6}/{self.epochs:<6}{percent(share, 1):>8}   "
            f"{percent(sure, 1):>8} of {self.accepted:<6}"
        )


NONE = Count(0, 0, 0, 0)


def count(found: Estimate, rows: _Int64, gear: int) -> Count:
    """How many of these rows have a gear; poses at rest are in none."""
    at = found.fix_row[rows]
    gears, accepted = found.trajectory.gear[at], found.trajectory.accepted[at]
    driven = gears != 0
    right = driven & (gears == gear)
    return Count(
        int(driven.sum()),
        int(right.sum()),
        int((driven & accepted).sum()),
        int((right & accepted).sum()),
    )


class MeasuredValue(NamedTuple):
    working: Count
    both: Count
    loose: Count
    pieces: tuple[int, int, int, int]
    """Pieces of `both` and how many are mostly right; the same of `loose`."""


def measure(log: Log, found: Estimate) -> MeasuredValue:
    drives = moving(log)
    working = count(found, np.flatnonzero(drives & log.work), +1)
    counts, pieces = {True: NONE, False: NONE}, [0, 0, 0, 0]
    for piece in backed_up(log):
        # The rows of the cusps themselves belong to either side.
        rows = np.arange(piece.first + 1, piece.last)
        one = count(found, rows[drives[rows]], -1)
        counts[piece.both] += one
        kind = 0 if piece.both else 2
        pieces[kind] += 1
        pieces[kind + 1] += one.right * 2 > one.epochs
    return MeasuredValue(working, counts[True], counts[False], tuple(pieces))


def beside_rows(log: Log, found: Estimate) -> tuple[_Float64, _Float64]:
    """Of accepted poses on straight rows: how far the heading is off the row, degrees, and its
    sigma. A row is the line through all fixes of the work within `ROW_HALF_M` to both sides, which
    lie beside it by `ROW_OFF_M` at most."""
    points, drives = log.points(), moving(log)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    first, last = np.searchsorted(way, way - ROW_HALF_M), np.searchsorted(way, way + ROW_HALF_M)
    track, off, sigma = found.trajectory, [], []
    for k in np.flatnonzero(drives & log.work & track.accepted[found.fix_row]).tolist():
        inside = slice(first[k], last[k])
        if last[k] == len(way) or last[k] - first[k] < FEWEST_ON_ROW or not log.work[inside].all():
            continue
        away = points[inside] - points[inside].mean(axis=0)
        along, across = np.linalg.svd(away, full_matrices=False)[2]
        if np.abs(away @ across).max() > ROW_OFF_M:
            continue
        row = found.fix_row[k]
        error = wrap_deg(track.heading_deg[row] - np.degrees(np.arctan2(along[0], along[1])))
        off.append(min(abs(error), abs(wrap_deg(error + 180.0))))
        sigma.append(track.heading_sigma_deg[row])
    return np.array(off), np.array(sigma)


HEAD = (
    f"{'':<34}{'work on: forward':>23}{'accepted':>21}{'backs up: reverse':>23}{'accepted':>21}"
    f"{'pieces':>10}"
)


def _line(name: str, one: MeasuredValue, loose: bool) -> str:
    back, pieces = (one.loose, one.pieces[2:]) if loose else (one.both, one.pieces[:2])
    return f"{name:<34}{one.working!s:>44}{back!s:>44}{f'{pieces[1]}/{pieces[0]}':>10}"


def report() -> Iterator[str]:
    """Each log and all together, with the machine's speed and without."""
    yield HEAD
    yield f"{'asked':<34}{'>= 99.5 %':>23}{'':>21}{'>= 95 %':>23}"
    for speeds in (False, True):
        label = "with speed" if speeds else "positions"
        drives = [(log, estimate(log, speeds)) for log in logs()]
        yield _accepted_line(label, drives)
        yield _rows_line(label, drives)
        found = [(log, measure(log, drive)) for log, drive in drives]
        for log, one in found:
            yield _line(f"{log.name}, {label}", one, loose=False)
        yield _line(f"pooled, {label}", pool([one for _, one in found]), loose=False)
        yield _line("  only the way into the row clear", pool([m for _, m in found]), loose=True)
    for log in logs():
        raw = FOLDER / "raw" / "ValidTimeLogs" / f"{log.name}.bin"
        if raw.exists():
            found_raw = estimate_poses(read_fix_log(raw).fixes)
            yield _line(f"{log.name}, as the terminal wrote it", measure(log, found_raw), False)


def _accepted_line(label: str, drives: list[tuple[Log, Estimate]]) -> str:
    """What is accepted of all fixes, and of those that the machine moves at."""
    accepted = [found.trajectory.accepted[found.fix_row] for _, found in drives]
    moves = [moving(log) for log, _ in drives]
    shares = ", ".join(percent(np.mean(one), 0) for one in accepted)
    while_moving = np.concatenate([one[of] for one, of in zip(accepted, moves, strict=True)])
    return (
        f"accepted, {label} (asked >= 85 %): {percent(np.mean(np.concatenate(accepted)), 1)} "
        f"({shares}); {percent(np.mean(while_moving), 1)} while moving"
    )


def _rows_line(label: str, drives: list[tuple[Log, Estimate]]) -> str:
    """Headings beside the direction of their straight rows."""
    pairs = zip(*(beside_rows(log, found) for log, found in drives), strict=True)
    off, sigma = (np.concatenate(columns) for columns in pairs)
    return (
        f"beside straight rows, {label} (asked >= 98 % within 3 sigma): "
        f"{percent(np.mean(off <= 3.0 * sigma), 1)} of {len(off)}, median {np.median(off):.2f}°, "
        f"95 % {np.quantile(off, 0.95):.2f}°"
    )


def pool(many: list[MeasuredValue]) -> MeasuredValue:
    total = MeasuredValue(NONE, NONE, NONE, (0, 0, 0, 0))
    for one in many:
        total = MeasuredValue(
            total.working + one.working,
            total.both + one.both,
            total.loose + one.loose,
            tuple(a + b for a, b in zip(total.pieces, one.pieces, strict=True)),
        )
    return total
