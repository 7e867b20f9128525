"""Vineyards: the rendered drive beside its exact truth, and a real robot beside surveyed rows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import EXAMPLE
from benchmarks.heading_scores import (
    DATA,
    SCORES_HEAD,
    Poses,
    Scores,
    make_fixes,
    numbers,
    percent,
    poses_at,
    scores_line,
    table,
)
from fieldgrid.geometry import Datum, FixColumns, Motion, Rig, heading_deg, wrap_deg
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.recordings import open_recording

_Float64 = npt.NDArray[np.float64]
_Int64 = npt.NDArray[np.int64]

# --- the rendered drive

MOVING_MPS = 0.2
EVERY = 5
"""Of the truth's 50 rows a second so many are one epoch: 10 Hz."""
EVENT_MARGIN_S = 1.0
TRUTH = DATA / "vineyard_two_lanes" / "truth"
GEARS = {"forward": 1, "reverse": -1}


class Truth(NamedTuple):
    """n epochs of the grid origin."""

    time_ns: _Int64
    east_m: _Float64
    north_m: _Float64
    heading_deg: _Float64
    speed_mps: _Float64
    gear: _Int64
    segment: npt.NDArray[np.str_]


def read_truth() -> Truth:
    path = TRUTH / "poses_50hz.csv"
    names = ("timestamp_utc_s", "cam_mid_E", "cam_mid_N", "heading_deg", "speed_signed_mps")
    text = table(path, (*names, "direction", "segment"))
    text = {name: column[::EVERY] for name, column in text.items()}
    seconds, *others = (numbers(text[name]) for name in names)
    return Truth(
        np.round(seconds * 1e3).astype(np.int64) * 1_000_000,
        *others,
        np.array([GEARS.get(direction, 0) for direction in text["direction"]], dtype=np.int64),
        np.array(text["segment"]),
    )


class Variant(NamedTuple):
    """What of the recording the estimate is given."""

    name: str
    log: str
    gyro: bool
    mounted: bool


VARIANTS = (
    Variant("SF1, gyro", "gnss_sf1.nmea", True, True),
    Variant("SF1, positions only", "gnss_sf1.nmea", False, True),
    Variant("SF1, positions only, no rig", "gnss_sf1.nmea", False, False),
    Variant("RTK, gyro", "gnss_rtk.nmea", True, True),
    Variant("RTK, positions only", "gnss_rtk.nmea", False, True),
    Variant("RTK, positions only, no rig", "gnss_rtk.nmea", False, False),
)


def estimate(variant: Variant) -> tuple[Estimate, Rig]:
    with open_recording(EXAMPLE, variant.log) as drive:
        fixes, motion, rig, datum = drive.fixes(), drive.motion(), drive.rig, drive.datum_hint
    if not variant.gyro:
        motion = Motion()
        unsaid = np.full(len(fixes), np.nan)
        fixes = fixes.replace(speed_mps=unsaid, heading_deg=unsaid, course_deg=unsaid)
    found = estimate_poses(fixes, rig if variant.mounted else None, datum, motion=motion)
    return found, rig


def report_rendered() -> Iterator[str]:
    truth = read_truth()
    rows = np.char.startswith(truth.segment, "lane")
    yield SCORES_HEAD
    yield f"{'asked of SF1, gyro: rows; headland':<34}{'':>24}{'<= 1, 2°':>8}{'':>8}{'>= 99.5':>8}"
    moved = []
    for variant in VARIANTS:
        found, _ = estimate(variant)
        poses = poses_at(found.trajectory, truth.time_ns)
        for name, mask in (("rows", rows), ("headland", ~rows)):
            drives = mask & (np.abs(truth.speed_mps) > MOVING_MPS)
            yield scores_line(f"{variant.name}: {name}", _scores(poses, truth).of(drives))
        if variant.mounted and "sf1" in variant.log:
            moved += [f"{variant.name}:", *_events(poses, truth)]
    yield "jumps of SF1: how far the pose lies off the truth and its slow bias, asked <= 0.3 m"
    yield from moved


def _scores(poses: Poses, truth: Truth) -> Scores:
    error = np.asarray(wrap_deg(poses.heading_deg - truth.heading_deg))
    return Scores(error, poses.sigma_deg, poses.accepted, poses.gear, truth.gear)


def _events(poses: Poses, truth: Truth) -> Iterator[str]:
    """Each jump and the hole: the largest distance of an accepted pose during it and a second
    around it, beside the median in the ten seconds before. A refused pose is in no map."""
    off = np.stack([poses.east_m - truth.east_m, poses.north_m - truth.north_m], axis=1)
    off -= slow_bias(truth.time_ns)
    away = np.hypot(*off.T)
    seconds = truth.time_ns / 1e9
    events = json.loads((TRUTH / "gnss_sf1_events.json").read_text())
    for event in events:
        if event["type"] == "corrupt_sentence":
            continue
        start, stop = event["t_start"], event["t_start"] + 0.2 * event["n_epochs"]
        inside = (seconds > start - EVENT_MARGIN_S) & (seconds < stop + EVENT_MARGIN_S)
        before = (seconds > start - 10.0) & (seconds < start - EVENT_MARGIN_S)
        flagged = "flagged" if event.get("flagged_by_receiver", True) else "unflagged"
        what = f"{event['type']} {event.get('magnitude_m', 0.0):.1f} m, {flagged}"
        used = inside & poses.accepted
        most = f"{away[used].max():.2f} m" if used.any() else "-"
        usual = np.median(away[before & poses.accepted]) if before.any() else np.nan
        yield (
            f"  {what:<36}{event['n_epochs']:>3} epochs: {most} (median before: {usual:.2f} m), "
            f"{percent(used.sum() / inside.sum(), 0)} of the poses used"
        )


def slow_bias(time_ns: _Int64) -> _Float64:
    """East and north of the receiver's slow error: its median over 5 s without the events."""
    path = TRUTH / "gnss_sf1_errors.csv"
    text = table(path, ("timestamp_utc_s", "err_E", "err_N"))
    seconds, east, north = (numbers(column) for column in text.values())
    keep = np.isfinite(east)
    for event in json.loads((TRUTH / "gnss_sf1_events.json").read_text()):
        if event["type"] == "multipath_jump":
            start, stop = event["t_start"] - 0.1, event["t_start"] + 0.2 * event["n_epochs"] - 0.1
            keep &= (seconds < start) | (seconds > stop)
    at = time_ns / 1e9
    axes = []
    for error in (east, north):
        quiet = [
            np.median(error[keep & (np.abs(seconds - now) <= 2.5)])
            for now in seconds[keep].tolist()
        ]
        axes.append(np.interp(at, seconds[keep], quiet))
    return np.stack(axes, axis=1)


# --- the real robot

FOLDER = DATA / "vineyard_gnss_rows"
BESIDE_M, END_M = 1.6, 5.0
"""A pass lies within this of the row's line, and begins and ends this far inside it."""

ROW_HEIGHT_M = 145.0


def report_rows() -> Iterator[str]:
    yield f"{'':<34}{'epochs':>8}{'used':>8}{'1.48 MAD':>10}{'std':>8}{'median':>9}{'sigma':>8}"
    yield f"{'asked':<34}{'':>8}{'':>8}{'<= 0.5°':>10}{'<= 0.5°':>8}"
    for quality, name in ((4, "taken for RTK"), (1, "quality unknown")):
        yield from _rows_lines(quality, name)


def _rows_lines(quality: int, name: str) -> Iterator[str]:
    fixes, lat, lon = robot(quality)
    found = estimate_poses(fixes)
    row, azimuth = row_of(lat, lon)
    at = found.fix_row
    heading = found.trajectory.heading_deg[at]
    sigma, accepted = found.trajectory.heading_sigma_deg[at], found.trajectory.accepted[at]
    drives = found.trajectory.gear[at] != 0
    off = np.asarray(wrap_deg(heading - azimuth))
    off = np.asarray(wrap_deg(2.0 * off)) / 2.0  # a row is driven both ways
    passes = np.cumsum(np.diff(row, prepend=-1) != 0)
    for k in np.unique(passes[row >= 0]):
        mask = (passes == k) & drives
        if mask.sum() > 50:
            yield _rows_line(f"  pass {k}, row {row[mask][0]}", off, sigma, accepted, mask)
    yield _rows_line(f"all passes, {name}", off, sigma, accepted, (row >= 0) & drives)


def _rows_line(
    name: str,
    off: _Float64,
    sigma: _Float64,
    accepted: npt.NDArray[np.bool_],
    mask: npt.NDArray[np.bool_],
) -> str:
    used = mask & accepted
    start = f"{name:<34}{mask.sum():>8}{percent(np.mean(accepted[mask]), 1):>8}"
    if not used.any():
        used, start = mask, start.rstrip() + "!"
    middle = np.median(off[used])
    mad = 1.48 * np.median(np.abs(off[used] - middle))
    return (
        f"{start:<50}{mad:>9.2f}°{np.std(off[used]):>7.2f}°{middle:>8.2f}°"
        f"{np.median(sigma[used]):>7.2f}°"
    )


def robot(quality: int) -> tuple[FixColumns, _Float64, _Float64]:
    text = table(FOLDER / "Image_GPS.csv", ("Computer_Time", "Latitude", "Longitude"))
    stamps = []
    for stamp in text["Computer_Time"]:
        *date, hour, minute, second, milli = stamp.split("-")
        stamps.append(f"{'-'.join(date)}T{hour}:{minute}:{second}.{milli:0>3}")
    time_ns = np.array(stamps, dtype="datetime64[ns]").astype(np.int64)
    lat, lon = numbers(text["Latitude"]), numbers(text["Longitude"])
    return make_fixes(time_ns, lat, lon, np.full(len(lat), quality)), lat, lon


def row_of(lat: _Float64, lon: _Float64) -> tuple[_Int64, _Float64]:
    """The surveyed row that each position lies beside, -1 for none, and its azimuth."""
    text = table(FOLDER / "Row_SE_GPS_OBlock.csv", ("Row", "ID", "Longitude", "Latitude"))
    ends_lat, ends_lon = numbers(text["Latitude"]), numbers(text["Longitude"])
    datum = Datum(float(ends_lat[0]), float(ends_lon[0]), ROW_HEIGHT_M)
    ends = np.stack(datum.to_enu(ends_lat, ends_lon, np.full(len(ends_lat), ROW_HEIGHT_M)))[:2].T
    points = np.stack(datum.to_enu(lat, lon, np.full(len(lat), ROW_HEIGHT_M)))[:2].T
    row, azimuth = np.full(len(lat), -1, dtype=np.int64), np.full(len(lat), np.nan)
    nearest = np.full(len(lat), BESIDE_M)
    for k in range(0, len(ends), 2):
        way = ends[k + 1] - ends[k]
        length = np.hypot(*way)
        along = (points - ends[k]) @ way / length
        aside = np.abs((points - ends[k]) @ np.array([way[1], -way[0]]) / length)
        here = (aside < nearest) & (along > END_M) & (along < length - END_M)
        row[here], azimuth[here] = int(text["Row"][k]), heading_deg(*way)
        nearest[here] = aside[here]
    return row, azimuth
