"""Headings beside a truth: errors, verdicts and gears, and the figures that sum them up."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import EXAMPLE
from fieldgrid.geometry import FixColumns, Status, Trajectory, wrap_deg

DATA = EXAMPLE.parents[2] / "shared" / "data"
"""Real logs, beside the repository; a section is skipped where its own are absent."""

_Float64 = npt.NDArray[np.float64]
_Int64 = npt.NDArray[np.int64]
_Bool = npt.NDArray[np.bool_]


class Poses(NamedTuple):
    """What a trajectory says at n instants, as an image taken then would be told."""

    east_m: _Float64
    north_m: _Float64
    heading_deg: _Float64
    sigma_deg: _Float64
    accepted: _Bool
    gear: _Int64


class Scores(NamedTuple):
    """n epochs with a truth: the heading's signed error and sigma, degrees, whether it was
    accepted; gears as +1 and -1, 0 where the truth does not tell or the vehicle rests."""

    error_deg: _Float64
    sigma_deg: _Float64
    accepted: _Bool
    gear: _Int64
    true_gear: _Int64

    def of(self, mask: _Bool) -> Scores:
        return Scores(*(column[mask] for column in self))


def pooled(scores: Iterable[Scores]) -> Scores:
    return Scores(*(np.concatenate(columns) for columns in zip(*scores, strict=True)))


def poses_at(trajectory: Trajectory, time_ns: _Int64) -> Poses:
    """Poses at instants, gears from the nearest accepted row."""
    if not trajectory.accepted.any():
        unknown = np.full(len(time_ns), np.nan)
        none = np.zeros(len(time_ns), dtype=np.int64)
        return Poses(unknown, unknown, unknown, unknown, none.astype(np.bool_), none)
    poses = [trajectory.at(at) for at in time_ns.tolist()]
    rows = np.flatnonzero(trajectory.accepted)
    times = trajectory.time_ns[rows]
    after = np.clip(np.searchsorted(times, time_ns), 1, len(times) - 1)
    nearest = np.where(time_ns - times[after - 1] < times[after] - time_ns, after - 1, after)
    return Poses(
        np.array([pose.east_m for pose in poses]),
        np.array([pose.north_m for pose in poses]),
        np.array([pose.heading_deg for pose in poses]),
        np.array([pose.heading_sigma_deg for pose in poses]),
        np.array([pose.status is not Status.REJECTED for pose in poses], dtype=np.bool_),
        trajectory.gear[rows[nearest]],
    )


def table(path: Path, columns: Sequence[str]) -> dict[str, list[str]]:
    """Columns of a CSV file, as text."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in columns}


def numbers(texts: Iterable[str]) -> _Float64:
    return np.array([float(text) if text else np.nan for text in texts])


def make_fixes(
    time_ns: _Int64,
    lat_deg: _Float64,
    lon_deg: _Float64,
    quality: npt.ArrayLike,
    height_m: float = 0.0,
) -> FixColumns:
    """Fixes that say nothing but where, when and of which quality."""
    return FixColumns.of(
        time_ns, lat_deg=lat_deg, lon_deg=lon_deg, height_m=height_m, quality=quality
    )


def circular_median_deg(angles_deg: _Float64) -> float:
    """The angle that half of the angles lie on either side of, near their mean."""
    rad = np.radians(angles_deg)
    mean = np.degrees(np.arctan2(np.sin(rad).mean(), np.cos(rad).mean()))
    return float(wrap_deg(mean + np.median(wrap_deg(angles_deg - mean))))


SCORES_HEAD = (
    f"{'':<34}{'epochs':>8}{'used':>8}{'median':>8}{'95 %':>8}{'> 90°':>8}{'gear':>8}"
    f"{'3 sigma':>9}{'sigma/err':>10}"
)


def scores_line(name: str, scores: Scores) -> str:
    """A line of the table under :data:`SCORES_HEAD`, of accepted epochs."""
    used = scores.of(scores.accepted)
    error = np.abs(used.error_deg)
    if not len(error):
        return f"{name:<34}{len(scores.accepted):>8}{'0 %':>8}"
    known = (used.true_gear != 0) & (used.gear != 0)
    gear = np.mean(used.gear[known] == used.true_gear[known]) if known.any() else np.nan
    return (
        f"{name:<34}{len(scores.accepted):>8}{percent(np.mean(scores.accepted), 1):>8}"
        f"{np.median(error):>7.2f}°{np.percentile(error, 95):>7.2f}°"
        f"{percent(np.mean(error > 90.0)):>8}{percent(gear, 1):>8}"
        f"{percent(np.mean(error <= 3.0 * used.sigma_deg), 1):>9}"
        f"{np.median(used.sigma_deg) / np.median(error):>10.2f}"
    )


def percent(share: float | np.floating, decimals: int = 2) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.{decimals}f} %"
