"""Which rows stand beside each other: lanes lie between them, blocks are made of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fieldgrid.core import Float64, Int64
from fieldgrid.field.rows.crops import Crop
from fieldgrid.geometry import lengths, normals, project, resampled

_STEP_M = 1.0
_MAX_ANGLE = np.cos(np.radians(12.0))
_BLOCK_SPACINGS = 3.3
"""Rows of one block are at most this number of spacings apart: two unseen ones may lie between."""

_LANE_SPACINGS = 1.55
"""A lane is not wider than this: beyond, a row was not seen."""

_MIN_SHARED_M = 3.0


class Pair(NamedTuple):
    """Rows `left` and `right` of each other, by their numbers: distance between them (median,
    metres), the middles between them [n, 2] in the direction of the left row, and whether they are
    near enough for one lane."""

    left: int
    right: int
    distance_m: float
    middle: Float64
    is_lane: bool


def oriented(lines: list[Float64]) -> list[Float64]:
    """The lines turned so that all of a neighbourhood run the same way, north-east rather than
    south-west; neighbours of a row that runs east-west do not differ by noise."""
    middles = np.array([line[len(line) // 2] for line in lines])
    along = np.array([line[-1] - line[0] for line in lines])
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    flip = np.zeros(len(lines), dtype=np.bool_)
    done = np.zeros(len(lines), dtype=np.bool_)
    tree = cKDTree(middles)
    for seed in range(len(lines)):
        if done[seed]:
            continue
        near = [k for k in tree.query_ball_point(middles[seed], 100.0) if not done[k]]
        similar = [k for k in near if abs(along[k] @ along[seed]) > 0.9]
        signs = np.sign(along[similar] @ along[seed])
        mean = (signs[:, None] * along[similar]).sum(axis=0)
        # North-east of the line from north-west to south-east is forward.
        forward = mean[0] + mean[1] > 0.0 if abs(mean[0] + mean[1]) > 1e-9 else mean[0] > 0.0
        for k, sign in zip(similar, signs, strict=True):
            flip[k] = (sign > 0) != forward
            done[k] = True
    return [line[::-1] if f else line for line, f in zip(lines, flip, strict=True)]


def neighbour_pairs(lines: list[Float64], crop: Crop) -> tuple[list[Pair], float]:
    """The pairs of rows with no third between them, and the usual spacing (NaN without a pair)."""
    if len(lines) < 2:
        return [], np.nan
    samples = [resampled(line, _STEP_M) for line in lines]
    near = _near(samples, _BLOCK_SPACINGS * crop.max_spacing_m)
    facing = []
    for k, sample in enumerate(samples):
        left = normals(sample)
        others = near[k]
        distances = np.full((len(others) + 1, len(sample)), np.inf)
        for n, other in enumerate(others):
            s, v = project(sample, lines[other])
            length = lengths(lines[other])[-1]
            beside = (s >= 0.0) & (s <= length)
            # To the left of this row is where the other one has it on its right.
            side = ((_at(lines[other], s) - sample) * left).sum(axis=1)
            distances[n] = np.where(beside & (side > 0.0), np.abs(v), np.inf)
        nearest = distances.argmin(axis=0)
        found = distances.min(axis=0)
        for n, other in enumerate(others):
            mine = (nearest == n) & np.isfinite(found)
            u, v = lines[k][-1] - lines[k][0], lines[other][-1] - lines[other][0]
            is_parallel = abs(u @ v) / (np.hypot(*u) * np.hypot(*v)) > _MAX_ANGLE
            if mine.sum() * _STEP_M >= _MIN_SHARED_M and is_parallel:
                facing.append((k, other, found[mine], sample[mine]))
    usual = float(np.median([np.median(d) for _, _, d, _ in facing])) if facing else np.nan
    pairs = []
    for right, left_row, distance, sample in facing:
        apart = float(np.median(distance))
        if apart > _BLOCK_SPACINGS * usual:
            continue
        s, _ = project(sample, lines[left_row])
        middle = 0.5 * (sample + _at(lines[left_row], s))
        pairs.append(Pair(left_row, right, apart, middle, apart <= _LANE_SPACINGS * usual))
    return pairs, usual


def _near(samples: list[Float64], reach_m: float) -> list[list[int]]:
    """For each line by its points the others of which one is within reach."""
    every = [shapely.multipoints(points) for points in samples]
    some = [shapely.multipoints(points[::4]) for points in samples]
    hits = shapely.STRtree(every).query(some, "dwithin", reach_m)
    found: list[list[int]] = [[] for _ in samples]
    for k, other in sorted(zip(*hits.tolist(), strict=True)):
        if k != other:
            found[k].append(other)
    return found


def linked_parts(links: Int64, count: int) -> Int64:
    """The number of the part that each of `count` things belongs to; links [n, 2] join things."""
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1].astype(np.int64))


def outer_lines(lines: list[Float64], crop: Crop) -> tuple[list[Float64], float]:
    """Lines beside those of rows on which there is no row yet, as far from them as rows usually
    are, and that distance (NaN without neighbours)."""
    pairs, apart_m = neighbour_pairs(lines, crop)
    if not pairs:
        return [], np.nan
    samples = [resampled(line, _STEP_M) for line in lines]
    rows = cKDTree(np.concatenate(samples))
    found: list[Float64] = []
    for sample in samples:
        for side in (1.0, -1.0):
            line = sample + side * apart_m * normals(sample)
            if is_apart(line, rows, apart_m) and (
                not found or is_apart(line, cKDTree(np.concatenate(found)), apart_m)
            ):
                found.append(line)
    return found, apart_m


def is_apart(line: Float64, points: cKDTree, apart_m: float) -> bool:
    """Whether most of a line is on no other one, of which there are points a metre apart; rows are
    `apart_m` from each other."""
    distance, _ = points.query(line)
    return bool((distance > 0.6 * apart_m).mean() > 0.5)


def _at(line: Float64, s: Float64) -> Float64:
    along = lengths(line)
    return np.column_stack([np.interp(s, along, line[:, 0]), np.interp(s, along, line[:, 1])])
