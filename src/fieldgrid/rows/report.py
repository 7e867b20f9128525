"""The rows as a check of quality: spacing, parallelism, straightness; against a survey too."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.array_types import Float64
from fieldgrid.errors import ConfigError
from fieldgrid.geodesy import Datum
from fieldgrid.polyline import lengths, project
from fieldgrid.rows.result import Planting, Row

MAX_SURVEY_BYTES = 50_000_000
_NEAR_M = 1.0
"""A surveyed point belongs to a row that is at most so far beside it."""


class RowQuality(NamedTuple):
    """Of one row: how far it bends off its chord (RMS and most), and by how much its heading
    differs from that of its block (mean of its rows)."""

    row: str
    bend_m: float
    max_bend_m: float
    turn_deg: float


class BlockQuality(NamedTuple):
    """Of one block: mean and standard deviation of the distances between neighbouring rows, the
    spread of their headings, and their RMS bend."""

    block: str
    spacing_m: float
    spacing_sd_m: float
    parallel_deg: float
    bend_m: float


class SurveyQuality(NamedTuple):
    """Rows against surveyed points: of how many rows, the number of points, the mean offset of the
    points to the left of the rows, their RMS, the share within 3 sigma."""

    rows: int
    points: int
    offset_m: float
    rms_m: float
    within_3_sigma: float


def row_quality(planting: Planting) -> list[RowQuality]:
    """Straightness and heading of every row."""
    found = []
    for block in planting.blocks:
        rows = [row for row in planting.rows if row.block == block.id]
        headings = np.array([_heading_deg(row) for row in rows])
        turns = headings - headings.mean()
        for row, turn in zip(rows, turns, strict=True):
            bend = _bend(row)
            rms = float(np.sqrt((bend**2).mean()))
            found.append(RowQuality(row.id, rms, float(np.abs(bend).max()), float(turn)))
    return found


def block_quality(planting: Planting) -> list[BlockQuality]:
    """Spacing, parallelism and straightness of every block; NaN where one row tells nothing."""
    lines = {row.id: np.asarray(row.line.coords) for row in planting.rows}
    found = []
    for block in planting.blocks:
        rows = [row for row in planting.rows if row.block == block.id]
        apart = []
        for lane in planting.lanes:
            if lane.block == block.id:
                middle = np.asarray(lane.line.coords)
                left, right = (project(middle, lines[name])[1] for name in lane.rows)
                apart.append(float(np.median(np.abs(left) + np.abs(right))))
        headings = [_heading_deg(row) for row in rows]
        bends = np.concatenate([_bend(row) for row in rows])
        several = len(rows) > 1
        found.append(
            BlockQuality(
                block.id,
                float(np.mean(apart)) if apart else float("nan"),
                float(np.std(apart)) if len(apart) > 1 else float("nan"),
                float(np.std(headings)) if several else float("nan"),
                float(np.sqrt((bends**2).mean())),
            )
        )
    return found


def _heading_deg(row: Row) -> float:
    line = np.asarray(row.line.coords)
    # Rows of a block run the same way, and headings about south do not jump.
    step = line[-1] - line[0]
    return float(np.degrees(np.arctan2(step[0], step[1])))


def _bend(row: Row) -> Float64:
    line = np.asarray(row.line.coords)
    return project(line, line[[0, -1]])[1]


def against_survey(planting: Planting, survey_m: Float64) -> SurveyQuality:
    """How far surveyed points [n, 2] (metres east and north) lie off the rows they belong to.

    A point beyond the end of a row, or farther than 1 m from every row, is left out.
    """
    offsets, sigmas, seen = [], [], set()
    lines = [(row, np.asarray(row.line.coords)) for row in planting.rows]
    tree = shapely.STRtree([row.line for row in planting.rows])
    for point, k in zip(survey_m, _nearest(tree, survey_m), strict=True):
        row, line = lines[k]
        s, v = project(point[None], line)
        if abs(v[0]) <= _NEAR_M and 0.0 <= s[0] <= lengths(line)[-1]:
            offsets.append(float(v[0]))
            sigmas.append(row.sigma_m)
            seen.add(row.id)
    if not offsets:
        raise ConfigError(
            f"None of the {len(survey_m)} surveyed points lies within {_NEAR_M:g} m of a row; "
            "check the survey's coordinates (longitude, latitude) and the map's datum."
        )
    off, sigma = np.array(offsets), np.array(sigmas)
    return SurveyQuality(
        len(seen),
        len(off),
        float(off.mean()),
        float(np.sqrt((off**2).mean())),
        float((np.abs(off) <= 3.0 * sigma).mean()),
    )


def _nearest(tree: shapely.STRtree, points_m: Float64) -> list[int]:
    if not len(tree.geometries):
        raise ConfigError("No row was found, so there is nothing to compare with the survey.")
    return [int(k) for k in tree.nearest(shapely.points(points_m))]


def read_survey(path: Path, datum: Datum) -> Float64:
    """Surveyed points [n, 2] in the datum's plane, from a CSV with columns of latitude and
    longitude (or east_m and north_m) or from a GeoJSON of points or lines in degrees.

    Raises ConfigError for a file that is neither.
    """
    try:
        if path.stat().st_size > MAX_SURVEY_BYTES:
            raise ConfigError(f"{path} is over {MAX_SURVEY_BYTES // 10**6} MB; no survey is.")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} cannot be read as a survey ({error}); check the file."
        ) from error
    if path.suffix.lower() in (".geojson", ".json"):
        return _survey_geojson(path, text, datum)
    return _survey_csv(path, text, datum)


def _survey_geojson(path: Path, text: str, datum: Datum) -> Float64:
    try:
        features = json.loads(text)["features"]
        shapes = [shapely.from_geojson(json.dumps(f["geometry"])) for f in features]
        degrees = shapely.get_coordinates(shapes)
    except (ValueError, KeyError, TypeError, RecursionError, shapely.GEOSException) as error:
        raise ConfigError(
            f"{path} is no GeoJSON of points or lines ({error}); give a FeatureCollection."
        ) from error
    return _plane(path, degrees[:, 1], degrees[:, 0], datum)


def _survey_csv(path: Path, text: str, datum: Datum) -> Float64:
    lines = csv.reader(text.splitlines())
    try:
        rows = [(lines.line_num, row) for row in lines if any(map(str.strip, row))]
    except csv.Error as error:
        raise ConfigError(
            f"{path}, line {lines.line_num}, is no line of a CSV ({error}); check the file."
        ) from error
    if not rows:
        raise ConfigError(f"{path} is empty; give a header and one point a row.")
    names, points = rows[0][1], rows[1:]
    header = [re.sub(r"[^a-z]", "", name.lower()) for name in names]

    def column(*names: str) -> int | None:
        return next((header.index(name) for name in names if name in header), None)

    lat, lon = column("latitude", "lat", "latdeg"), column("longitude", "long", "lon", "londeg")
    east, north = column("eastm"), column("northm")
    chosen = (lat, lon) if lat is not None and lon is not None else (east, north)
    first, second = chosen
    if first is None or second is None:
        raise ConfigError(
            f"{path} has the columns {', '.join(names)[:200]}; a survey needs latitude and "
            "longitude, or east_m and north_m."
        )
    values = np.array(
        [
            [_number(path, line, row[k] if k < len(row) else "", names[k]) for k in (first, second)]
            for line, row in points
        ]
    ).reshape(-1, 2)
    if chosen == (east, north):
        if not len(values):
            raise ConfigError(f"{path} has no points; give one a row.")
        return values
    return _plane(path, values[:, 0], values[:, 1], datum)


def _number(path: Path, line: int, text: str, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        given = f"{text[:40]!r}, which is no number" if text.strip() else "nothing"
        raise ConfigError(
            f"{path}, line {line}: {column} is {given}; give a number, with a point for decimals, "
            "or take the line out."
        )
    return value


def _plane(path: Path, lat_deg: Float64, lon_deg: Float64, datum: Datum) -> Float64:
    if not len(lat_deg):
        raise ConfigError(f"{path} has no points; give one a row.")
    off = np.flatnonzero(~((np.abs(lat_deg) <= 90.0) & (np.abs(lon_deg) <= 180.0)))
    if len(off):
        at = f"latitude {lat_deg[off[0]]:g}, longitude {lon_deg[off[0]]:g}"
        raise ConfigError(f"{path} has a point that is not on Earth ({at}); give degrees (WGS84).")
    east, north, _ = datum.to_enu(lat_deg, lon_deg, datum.height_m)
    return np.column_stack([east, north])
