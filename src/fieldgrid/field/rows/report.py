"""The rows as a check of quality: spacing, parallelism, straightness; against a survey too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import ConfigError, Float64
from fieldgrid.field.rows.result import Block, Planting, Row
from fieldgrid.geometry import lengths, project

_NEAR_M = 1.0
"""The largest distance of a surveyed point from the row that it belongs to."""


class RowQuality(NamedTuple):
    """Of one row: how far it bends off its chord (RMS), and by how much its heading
    differs from that of its block."""

    row: str
    bend_m: float
    turn_deg: float


class BlockQuality(NamedTuple):
    """Of one block: mean and standard deviation of the distances between neighbouring rows, the
    RMS turn of the rows from the block's heading, weighted by their lengths as that heading is, and
    their RMS bend."""

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
        for row, turn in zip(rows, _turns_deg(rows, block).tolist(), strict=True):
            rms_m = float(np.sqrt((_bend(row) ** 2).mean()))
            found.append(RowQuality(row.id, rms_m, turn))
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
        spread_deg = np.sqrt(
            np.average(_turns_deg(rows, block) ** 2, weights=[row.line.length for row in rows])
        )
        bends = np.concatenate([_bend(row) for row in rows])
        several = len(rows) > 1
        found.append(
            BlockQuality(
                block.id,
                float(np.mean(apart)) if apart else float("nan"),
                float(np.std(apart)) if len(apart) > 1 else float("nan"),
                float(spread_deg) if several else float("nan"),
                float(np.sqrt((bends**2).mean())),
            )
        )
    return found


def _turns_deg(rows: Sequence[Row], block: Block) -> Float64:
    """By how much rows are turned clockwise from their block's heading, [n]."""
    steps = np.array([np.subtract(row.line.coords[-1], row.line.coords[0]) for row in rows])
    heading = np.radians(block.heading_deg)
    ahead = steps @ [np.sin(heading), np.cos(heading)]
    return np.asarray(np.degrees(np.arctan2(steps @ [np.cos(heading), -np.sin(heading)], ahead)))


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
    if not len(tree.geometries):
        raise ConfigError("No row was found, so there is nothing to compare with the survey.")
    for point, k in zip(survey_m, tree.nearest(shapely.points(survey_m)).tolist(), strict=True):
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
