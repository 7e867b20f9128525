"""A drive as a table that scripts and a GIS read, `track.csv`, and in a few numbers."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import (
    ConfigError,
    DatumError,
    Float64,
    MapExistsError,
    grouped_reasons,
    replacing,
)
from fieldgrid.geometry import MAX_DISTANCE_M, MAX_GAP_NS, Datum, Status, wrap_deg
from fieldgrid.poses.gates.verdict import REPEATS
from fieldgrid.poses.report import Estimate, PoseReport
from fieldgrid.poses.track.formats import (
    GEOJSON_START,
    GPX_START,
    TUM_START,
    geojson_lines,
    gpx_lines,
    tum_lines,
)

COLUMNS = (
    *("time_ns", "lat_deg", "lon_deg", "height_m", "east_m", "north_m"),
    *("heading_deg", "heading_sigma_deg", "speed_mps", "gear", "status", "reason", "time"),
    *("position_sigma_m", "gear_doubt"),
)
"""The columns of `track.csv`; others read them by these names and in this order."""

NO_HEADING_DEG = 90.0
"""A heading as unsure as this is none."""

_HEADER = ",".join(COLUMNS[:12])
"""How a table begins, those of earlier versions included, which end with `reason`."""

_OTHERS = {
    ".gpx": (GPX_START, gpx_lines),
    ".geojson": (GEOJSON_START, geojson_lines),
    ".tum": (TUM_START, tum_lines),
}
"""Beside the table: how a file begins, and its lines."""

SUFFIXES = (".csv", *_OTHERS)
"""What the name of a track may end in."""


def write_track(estimate: Estimate, path: str | Path) -> None:
    """Write the track in the format of the file's ending: csv, gpx, geojson or tum.

    `track.csv` has a row an input fix, in order of time, rejected ones included.
    Degrees, metres and metres a second (negative in reverse) of the estimated pose; height is
    ellipsoidal; gear is 1, -1, or 0 at rest. A field is empty where nothing is known: all of a
    pose at a rejected fix before the first accepted one or after the last. The file appears
    when it is complete and replaces an earlier track, but nothing else.

    Raises ConfigError for another ending, DatumError for poses out of reach of their datum,
    MapExistsError for a file that is no track, MapWriteError where it cannot be written.
    """
    path = Path(path)
    ok = estimate.trajectory.accepted
    east_m, north_m = estimate.trajectory.east_m[ok], estimate.trajectory.north_m[ok]
    far_m = float(np.max([np.abs(east_m), np.abs(north_m)], initial=0.0))
    if far_m > MAX_DISTANCE_M:
        raise DatumError(
            f"The drive reaches {far_m / 1000:.0f} km from its datum, over "
            f"{MAX_DISTANCE_M / 1000:.0f} km; give a --datum near the field."
        )
    check_target(path)
    with replacing(path) as draft, draft.open("w", encoding="utf-8", newline="") as file:
        if path.suffix.lower() == ".csv":
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(track_rows(estimate))
        else:
            _, lines = _OTHERS[path.suffix.lower()]
            file.writelines(f"{line}\n" for line in lines(estimate))


def check_target(path: Path) -> None:
    """Raise ConfigError for a name that is none of a track, MapExistsError for an existing file
    that is no such track: it may be the log itself."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigError(
            f"{path} ends in none of {', '.join(SUFFIXES)}; give the track a name that does."
        )
    if not path.is_file():
        return
    first = _HEADER if suffix == ".csv" else _OTHERS[suffix][0]
    with path.open("rb") as file:
        start = file.readline(len(first) + 2).decode("latin-1").rstrip("\r\n")
    if start and not start.startswith(first):
        raise MapExistsError(
            f"{path} exists already and is no track; give another name, or remove it first."
        )


def track_rows(estimate: Estimate) -> Iterator[tuple[str, ...]]:
    """The rows of `track.csv` as text, in the order of :data:`COLUMNS`."""
    at, track = estimate.fix_row, estimate.trajectory
    heading, sigma = track.heading_deg[at], track.heading_sigma_deg[at]
    # Without any heading there is no pose: a rejected fix that no estimate reaches.
    known = np.isfinite(heading)
    # NaN fails the comparison.
    directed = known & (sigma < NO_HEADING_DEG)
    east, north, up = (
        np.where(known, values[at], np.nan) for values in (track.east_m, track.north_m, track.up_m)
    )
    lat, lon, height = track.datum.to_geodetic(east, north, up)
    yield from zip(
        map(str, track.time_ns[at].tolist()),
        _decimals(lat, 9),
        _decimals(lon, 9),
        _decimals(height, 4),
        _decimals(east, 4),
        _decimals(north, 4),
        _decimals(np.where(directed, wrap_deg(np.round(heading, 3)), np.nan), 3),
        _decimals(np.where(directed, sigma, np.nan), 3),
        _decimals(np.where(known, track.speed_mps[at], np.nan), 3),
        (str(g) if k else "" for g, k in zip(track.gear[at].tolist(), known.tolist(), strict=True)),
        (track.status[k].value for k in at.tolist()),
        (track.reason[k] for k in at.tolist()),
        (f"{t}Z" for t in np.datetime_as_string(track.time_ns[at].astype("datetime64[ns]"))),
        _decimals(np.where(known, track.position_sigma_m[at], np.nan), 4),
        _decimals(np.where(known, estimate.gear_doubt[at], np.nan), 4),
        strict=True,
    )


def _decimals(values: Float64, digits: int) -> list[str]:
    """Numbers with a fixed count of decimals, never -0; '' for what is not finite."""
    rounded = np.round(np.where(np.isfinite(values), values, np.nan), digits) + 0.0
    # A long drive has millions of them: an f-string would read its format for each.
    text = f"%.{digits}f"
    return ["" if value != value else text % value for value in rounded.tolist()]


class Spread(NamedTuple):
    """The middle of some values, and what 95 % of them do not exceed."""

    median: float
    p95: float


class GearTimes(NamedTuple):
    """How long a drive went forward, in reverse, and stood; how often it changed direction."""

    forward_s: float
    reverse_s: float
    standing_s: float
    reversals: int


@dataclass(frozen=True, slots=True)
class TrackSummary:
    """A track in numbers. Counts are of input fixes, sigmas of the accepted among them.

    `repeated` are fixes that were written again, and no loss. `reasons` are those of rejected
    fixes, the commonest first: how many, and one of the sentences that differ in numbers only.
    """

    datum: Datum
    heading_source: str
    ok: int
    held: int
    repeated: int
    rejected: int
    reasons: tuple[tuple[int, str], ...]
    duration_s: float
    distance_m: float
    gears: GearTimes
    heading_sigma_deg: Spread | None
    position_sigma_m: Spread | None
    report: PoseReport

    @property
    def fixes(self) -> int:
        """How many fixes went in."""
        return self.ok + self.held + self.repeated + self.rejected

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is unknown is null."""
        datum, heading, position = self.datum, self.heading_sigma_deg, self.position_sigma_m
        return {
            "datum": {
                "lat_deg": datum.lat_deg,
                "lon_deg": datum.lon_deg,
                "height_m": datum.height_m,
            },
            "heading_source": self.heading_source,
            "fixes": self.fixes,
            "ok": self.ok,
            "held": self.held,
            "repeated": self.repeated,
            "rejected": self.rejected,
            "reasons": [{"fixes": count, "example": example} for count, example in self.reasons],
            "duration_s": self.duration_s,
            "distance_m": self.distance_m,
            **self.gears._asdict(),
            "heading_sigma_deg": None if heading is None else heading._asdict(),
            "position_sigma_m": None if position is None else position._asdict(),
            **self.report.as_dict(),
        }


def summarise_track(estimate: Estimate) -> TrackSummary:
    """Count verdicts, gears and reasons of a track, and measure its way."""
    track, at = estimate.trajectory, estimate.fix_row
    statuses = Counter(track.status[k] for k in at.tolist())
    refused = Counter(track.reason[k] for k in at.tolist() if track.status[k] is Status.REJECTED)
    repeated = sum(refused.pop(why) for why in list(refused) if why.startswith(REPEATS))
    used = at[track.accepted[at]]
    first_ns, last_ns = track.time_ns[at].min(), track.time_ns[at].max()
    # Times in each gear, over the poses that follow each other closely; an estimate that is too
    # unsure for a map, or stands for a rejected fix, still tells the gear.
    known = np.isfinite(track.heading_deg)
    time_ns, gear = track.time_ns[known], track.gear[known]
    step_ns = np.diff(time_ns)
    step_s = np.where(step_ns <= MAX_GAP_NS, step_ns / 1e9, 0.0)
    forward_s, reverse_s, standing_s = (
        float(step_s[gear[:-1] == wanted].sum()) for wanted in (1, -1, 0)
    )
    moving = gear[gear != 0]
    return TrackSummary(
        datum=track.datum,
        heading_source=track.heading_source,
        ok=statuses[Status.OK],
        held=statuses[Status.HELD],
        repeated=repeated,
        rejected=refused.total(),
        reasons=tuple(grouped_reasons(refused)),
        duration_s=float(last_ns - first_ns) / 1e9,
        distance_m=track.length_m(),
        gears=GearTimes(forward_s, reverse_s, standing_s, int(np.count_nonzero(np.diff(moving)))),
        heading_sigma_deg=_spread(track.heading_sigma_deg[used]),
        position_sigma_m=_spread(track.position_sigma_m[used]),
        report=estimate.report,
    )


def _spread(values: Float64) -> Spread | None:
    known = values[np.isfinite(values)]
    if known.size == 0:
        return None
    return Spread(float(np.median(known)), float(np.percentile(known, 95.0)))
