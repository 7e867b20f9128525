"""Why headings of a real robot scatter about its rows: `python -m benchmarks.heading --only weave`.

Its antenna weaves. What of that is the receiver's error shows along the rows, where a vehicle does
not weave; what of the scatter is the estimate's error, and what such a robot's own, simulated
robots show that weave as far: one that steers so, and one whose antenna sways while it drives on
straight. They have the same positions, so no estimate from positions tells one from the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from benchmarks.heading_scores import make_fixes, percent
from benchmarks.heading_vineyard import ROW_HEIGHT_M, robot, row_of
from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import Datum, wrap_deg
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, START

FEWEST_OF_PASS, EVEN_M, BESIDE_TRACK_M = 50, 0.25, 1.1
WAVES_M = (20.0, 8.0, 4.0, 2.0, 1.0)
LINES_M = (2.0, 4.0, 8.0, 16.0, 32.0)
QUALITIES = {"taken for RTK": 4, "quality unknown": -1}


class Passes(NamedTuple):
    """The rows of each pass along a row of vines, in the order of time, and all positions along
    and to the right of the rows, metres; `time_s` are theirs."""

    rows: list[Int64]
    time_s: Float64
    along_m: Float64
    aside_m: Float64


def passes() -> Passes:
    """Those of the log."""
    fixes, lat, lon = robot(1)
    row, azimuth = row_of(lat, lon)
    east, north = Datum(lat[0], lon[0], ROW_HEIGHT_M).to_enu(lat, lon, fixes.height_m)[:2]
    way = np.radians(np.nanmedian(azimuth))
    numbers = np.cumsum(np.diff(row, prepend=-1) != 0)
    rows = [np.flatnonzero((row >= 0) & (numbers == k)) for k in np.unique(numbers[row >= 0])]
    return Passes(
        [at for at in rows if len(at) > FEWEST_OF_PASS],
        (fixes.time_ns - fixes.time_ns[0]) / 1e9,
        east * np.sin(way) + north * np.cos(way),
        east * np.cos(way) - north * np.sin(way),
    )


def report() -> Iterator[str]:
    """All of it."""
    log = passes()
    yield from _bands(log)
    yield from _alike(log)
    yield from _lines(log)
    yield from _simulated(log)


# --- the log


def _even(log: Passes, at: Int64) -> tuple[Float64, Float64, float]:
    """Of a pass how far it lies ahead of an even pace and beside a straight line, in even steps of
    time, and the way of a step."""
    period_s = float(np.median(np.diff(log.time_s[at])))
    time_s = np.arange(log.time_s[at[0]], log.time_s[at[-1]], period_s)
    along, aside = (np.interp(time_s, log.time_s[at], of[at]) for of in (log.along_m, log.aside_m))
    fits = (np.polyfit(of, what, 1) for of, what in ((time_s, along), (along, aside)))
    ahead, beside = along - np.polyval(next(fits), time_s), aside - np.polyval(next(fits), along)
    return ahead, beside, float(np.median(np.abs(np.diff(along))))


def _band(values: Float64, step_m: float, longest_m: float, shortest_m: float) -> Float64:
    per_m = np.fft.rfftfreq(len(values), step_m)
    inside = (per_m > 1.0 / longest_m) & (per_m <= 1.0 / shortest_m)
    return np.asarray(np.fft.irfft(np.where(inside, np.fft.rfft(values), 0.0), len(values)))


def _bands(log: Passes) -> Iterator[str]:
    """How far the antenna weaves by the length of the waves, along and across the rows."""
    for longest_m, shortest_m in pairwise(WAVES_M):
        sizes = np.array(
            [
                [100.0 * _band(of, step_m, longest_m, shortest_m).std() for of in (ahead, beside)]
                for ahead, beside, step_m in (_even(log, at) for at in log.rows)
            ]
        )
        (along, across), (least, most) = np.median(sizes, axis=0), (sizes.min(0), sizes.max(0))
        yield (
            f"waves of {shortest_m:g} to {longest_m:g} m: along the rows {along:.1f} cm in the "
            f"median pass ({least[0]:.1f} to {most[0]:.1f}), across {across:.1f} cm "
            f"({least[1]:.1f} to {most[1]:.1f})"
        )


def _alike(log: Passes) -> Iterator[str]:
    """Whether passes whose tracks lie within a metre weave alike, as on the same bumps."""
    tracks = [at[np.argsort(log.along_m[at])] for at in log.rows]
    start = max(log.along_m[at[0]] for at in tracks)
    stop = min(log.along_m[at[-1]] for at in tracks)
    even_m = np.arange(start, stop, EVEN_M)
    lines = np.array([np.interp(even_m, log.along_m[at], log.aside_m[at]) for at in tracks])
    middle_m = np.median(lines, axis=1)
    beside = np.triu(np.abs(middle_m[:, None] - middle_m) <= BESIDE_TRACK_M, 1)
    lines -= np.array([np.polyval(np.polyfit(even_m, line, 1), even_m) for line in lines])
    for longest_m, shortest_m in pairwise(WAVES_M):
        alike = np.corrcoef([_band(line, EVEN_M, longest_m, shortest_m) for line in lines])
        found = ", ".join(f"{one:+.2f}" for one in alike[beside])
        yield f"waves of {shortest_m:g} to {longest_m:g} m: tracks within a metre alike by {found}"


def _lines(log: Passes) -> Iterator[str]:
    """How much straight lines through so many metres of the track scatter about the rows."""
    for length_m in LINES_M:
        off_deg = []
        for at in log.rows:
            _, beside, step_m = _even(log, at)
            half = max(round(length_m / step_m / 2.0), 1)
            share = np.arange(-half, half + 1) * step_m
            slope = np.convolve(beside, -share / (share @ share), mode="valid")
            off_deg.append(np.degrees(np.arctan(slope)))
        yield f"lines of {length_m:g} m scatter by {_scatter(np.concatenate(off_deg)):.2f}°"


def _scatter(off_deg: Float64) -> float:
    return 1.48 * float(np.median(np.abs(off_deg - np.median(off_deg))))


# --- robots that weave as far

SPEED_MPS, PERIOD_S, ROW_M, TURN_M, STEP_M = 0.94, 0.522, 154.0, 1.5, 0.02
SEEDS = 6


class Robot(NamedTuple):
    """Positions of an antenna, the true heading of the robot, and which are on its rows."""

    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    on_row: Bool


def weaving(log: Passes, seed: int, *, steers: bool) -> Robot:
    """Six rows driven to and fro, and headlands; the antenna weaves across as far as that of the
    log does in each band of waves, and has the noise of the shortest."""
    random = np.random.default_rng([2719, seed])
    north, east, turned = [np.zeros(1)], [np.zeros(1)], [np.zeros(1)]
    for k in range(len(log.rows)):
        up, lane_m = k % 2 == 0, 2.0 * TURN_M * k
        way_m = np.arange(STEP_M, ROW_M, STEP_M)
        north.append(way_m if up else ROW_M - way_m)
        east.append(np.full(len(way_m), lane_m))
        turned.append(np.ones(len(way_m)))
        arc = np.arange(STEP_M, np.pi * TURN_M, STEP_M) / TURN_M
        north.append((ROW_M if up else 0.0) + (1.0 if up else -1.0) * TURN_M * np.sin(arc))
        east.append(lane_m + TURN_M * (1.0 - np.cos(arc)))
        turned.append(np.zeros(len(arc)))
    path = np.stack([np.concatenate(east), np.concatenate(north)])
    on_row = np.concatenate(turned) > 0.0
    weave = _weave(log, path.shape[1], random) * _faded(on_row)
    phi = np.unwrap(np.arctan2(*np.gradient(path, axis=1)))
    antenna = path + weave * np.array([np.cos(phi), -np.sin(phi)])
    if steers:
        phi = np.unwrap(np.arctan2(*np.gradient(antenna, axis=1)))
    at_m = np.arange(0.0, STEP_M * (path.shape[1] - 1), SPEED_MPS * PERIOD_S)
    every = np.round(at_m / STEP_M).astype(np.int64)
    noise = random.normal(0.0, _noise_m(log), (2, len(every)))
    found = antenna[:, every] + noise
    return Robot(found[0], found[1], np.degrees(phi[every]), _faded(on_row)[every] > 0.999)


def _faded(on_row: Bool) -> Float64:
    """1 on rows but near their ends, from where on it falls to 0 within 5 m."""
    count = round(5.0 / STEP_M)
    return np.asarray(np.convolve(on_row, np.ones(count) / count, mode="same"))


def _weave(log: Passes, count: int, random: np.random.Generator) -> Float64:
    """Waves of random phases, in each band as large as across the rows of the log; of the shortest
    band what is left is noise."""
    weave = np.zeros(count)
    for longest_m, shortest_m in pairwise(WAVES_M[:-1]):
        sizes_m = [_band(*_across(log, at), longest_m, shortest_m).std() for at in log.rows]
        white = _band(random.normal(size=count), STEP_M, longest_m, shortest_m)
        weave += np.median(sizes_m) * white / white.std()
    return weave


def _across(log: Passes, at: Int64) -> tuple[Float64, float]:
    _, beside, step_m = _even(log, at)
    return beside, step_m


def _noise_m(log: Passes) -> float:
    """White noise that is as large in the shortest band as the log."""
    longest_m, shortest_m = WAVES_M[-2:]
    shares = []
    for at in log.rows:
        beside, step_m = _across(log, at)
        band_share = 2.0 * step_m * (1.0 / shortest_m - 1.0 / longest_m)
        shares.append(_band(beside, step_m, longest_m, shortest_m).std() / np.sqrt(band_share))
    return float(np.median(shares))


def _simulated(log: Passes) -> Iterator[str]:
    yield f"{'':<56}{'about the rows':>16}{'true':>8}{'error':>8}{'in 3 sigma':>12}"
    for steers, what in ((True, "steers as it weaves"), (False, "sways, and drives straight")):
        for name, quality in QUALITIES.items():
            robots = [weaving(log, seed, steers=steers) for seed in range(SEEDS)]
            about, true, error, sigma = map(
                np.concatenate, zip(*(_measured(one, quality) for one in robots), strict=True)
            )
            yield (
                f"{f'robot that {what}, {name}':<56}{_scatter(about):>15.2f}°"
                f"{_scatter(true):>7.2f}°{_scatter(error):>7.2f}°"
                f"{percent(np.mean(np.abs(error) <= 3.0 * sigma), 1):>12}"
            )


def _measured(one: Robot, quality: int) -> tuple[Float64, Float64, Float64, Float64]:
    """Of accepted poses on rows: heading and true heading about the row, the error, its sigma."""
    lat, lon, _ = DATUM.to_geodetic(one.east_m, one.north_m, np.zeros(len(one.east_m)))
    time_ns = START + np.round(PERIOD_S * 1e9 * np.arange(len(lat))).astype(np.int64)
    found = estimate_poses(make_fixes(time_ns, lat, lon, np.full(len(lat), quality)))
    track, row = found.trajectory, found.fix_row
    use = track.accepted[row] & one.on_row
    heading, truth = track.heading_deg[row][use], one.heading_deg[use]
    about, true = (np.asarray(wrap_deg(2.0 * of)) / 2.0 for of in (heading, truth))
    sigma = track.heading_sigma_deg[row][use]
    return about, true, np.asarray(wrap_deg(heading - truth)), sigma
