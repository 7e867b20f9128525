"""Row segments: straight pieces of rows in patches of a field, and the chains that they form.

In a patch of some rows' width a row is a straight line. The direction of a patch is the one along
which its obstacle cells, projected onto a line across, gather in the fewest places (the projection
profile of page de-skewing, or a Radon transform that is read at its sharpest angle). Neighbouring
patches share their profiles, so that a patch with a trailer or with few cells follows the others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import correlate1d, gaussian_filter1d
from scipy.spatial import cKDTree

from fieldgrid.core import Float64, Int64, kernel
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.measuring.neighbours import linked_parts
from fieldgrid.maps import OBSTACLE, Evidence

_ANGLES = 120
"""Directions that are tried over half a turn: 1.5° moves the end of a patch by a fifth of a row."""

_MIN_POINTS = 12
_BAND_CELLS = 4_000_000
_NEIGHBOUR_WEIGHT = 0.5
_MAX_TURN_RAD = np.radians(9.0)


_BINS = 12
"""Of the profile across a patch, in the least distance of rows; it is smoothed by a fifth of that,
as by `gaussian_filter1d`, whose weights take as long as the rest."""

_SMOOTH = np.exp(-0.5 * (np.arange(-10, 11) / (_BINS / 5.0)) ** 2)
_SMOOTH /= _SMOOTH.sum()


class Segments(NamedTuple):
    """Straight pieces: middles [n, 2], unit directions [n, 2], half lengths, thinned cells in each,
    and the share of the length in which there are any."""

    middle_m: Float64
    along: Float64
    half_m: Float64
    support: Int64
    filled: Float64


def thinned(evidence: Evidence, cell_m: float) -> Float64:
    """One point [n, 2] (metres east and north), the mean of the middles of its obstacle cells, for
    each square of `cell_m` that has any."""
    east_m, north_m = evidence.lattice.centres(evidence.window)
    across, up = (np.floor(one / cell_m).astype(np.int64) for one in (east_m, north_m))
    width = int(across[-1] - across[0]) + 1
    rows = max(1, _BAND_CELLS // len(east_m))
    # Bands begin where squares do.
    edges = np.searchsorted(up, np.unique(up[::rows]))
    found = []
    for first, last in zip(edges, [*edges[1:], len(up)], strict=True):
        j, i = np.nonzero(evidence.cells[first:last] == OBSTACLE)
        flat = (up[first:last][j] - up[0]) * width + (across[i] - across[0])
        # Counted square by square, for which nothing is sorted.
        start = int(up[first] - up[0]) * width
        every = np.bincount(flat - start)
        squares = np.flatnonzero(every)
        sums = (
            np.bincount(flat - start, at)[squares] for at in (east_m[i], north_m[first:last][j])
        )
        places = squares + start
        found.append(np.column_stack([places % width, places // width, *sums, every[squares]]))
    parts = np.concatenate(found)
    parts = parts[np.lexsort((parts[:, 1], parts[:, 0]))]
    return np.asarray(parts[:, 2:4] / parts[:, 4:])


def find_segments(points_m: Float64, crop: Crop) -> Segments:
    """The segments of rows among obstacle cells [n, 2] (metres), which are thinned already."""
    side = crop.patch_m
    middles_m, patches = _patches(points_m, side, side)
    profiles = np.stack([_sharpness(points_m[members], crop) for members in patches])
    directions = _pooled(middles_m, profiles, side)
    tree = cKDTree(middles_m)
    found = []
    for middle, members in zip(*_patches(points_m, side, side / 2.0), strict=True):
        if len(members) < _MIN_POINTS:
            continue
        _, near = tree.query(middle, k=min(2, len(middles_m)))
        # Where two blocks meet, either direction may be that of a row.
        angles = {float(directions[k]) for k in np.atleast_1d(near) if np.isfinite(directions[k])}
        for angle in angles:
            found += _segments_of(points_m[members], middle, angle, crop)
    if not found:
        return Segments(
            np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0, int), np.zeros(0)
        )
    return Segments(*(np.array(column) for column in zip(*found, strict=True)))


def _patches(points_m: Float64, side_m: float, step_m: float) -> tuple[Float64, list[Int64]]:
    """Squares of `side_m` about every lattice point of `step_m` that has a point near it: their
    middles [n, 2], and the numbers of the points in each."""
    tree = cKDTree(points_m)
    places = np.floor(points_m / step_m).astype(np.int64)
    low, high = places.min(axis=0), places.max(axis=0)
    size = high - low + 1
    # Sorted as numbers: pairs take twenty times as long.
    numbers = np.unique((places[:, 0] - low[0]) * size[1] + (places[:, 1] - low[1]))
    keys = np.column_stack([numbers // size[1], numbers % size[1]]) + low
    middle = np.asarray((keys + 0.5) * step_m, dtype=np.float64)
    members = tree.query_ball_point(middle, side_m / 2.0, p=np.inf, return_sorted=False)
    return middle, [np.asarray(m, dtype=np.int64) for m in members]


def _sharpness(points_m: Float64, crop: Crop) -> Float64:
    """For each direction, how many pairs of points share a bin of the profile across it."""
    if len(points_m) < _MIN_POINTS:
        return np.zeros(_ANGLES)
    angles = np.arange(_ANGLES) * np.pi / _ANGLES
    across = np.stack([-np.sin(angles), np.cos(angles)])
    middle = points_m.mean(axis=0)
    v = np.floor(((points_m - middle) @ across) / (crop.min_spacing_m / 5.0)).astype(np.int64)
    v -= v.min()
    width = int(v.max()) + 1
    counts = np.bincount((v + np.arange(_ANGLES) * width).ravel(), minlength=_ANGLES * width)
    squares: Float64 = np.square(counts.reshape(_ANGLES, width).astype(np.float64)).sum(axis=1)
    return squares / len(points_m)


def _pooled(middle_m: Float64, profiles: Float64, side_m: float) -> Float64:
    """The direction of each patch, radians counter-clockwise from east; NaN without any points."""
    pairs = cKDTree(middle_m).query_pairs(1.5 * side_m, output_type="ndarray")
    # What an angle has above the mean of all tells of rows; a blob is the same from everywhere.
    contrast = profiles - np.median(profiles, axis=1, keepdims=True)
    pooled = contrast.copy()
    for a, b in (pairs.T, pairs.T[::-1]):
        np.add.at(pooled, a, _NEIGHBOUR_WEIGHT * contrast[b])
    pooled = gaussian_filter1d(pooled, 0.7, axis=1, mode="wrap")
    best = pooled.argmax(axis=1)
    left, peak, right = (
        np.take_along_axis(pooled, ((best + d) % _ANGLES)[:, None], 1)[:, 0] for d in (-1, 0, 1)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.nan_to_num(0.5 * (left - right) / (left - 2.0 * peak + right))
    return np.where(peak > 0.0, (best + np.clip(shift, -0.5, 0.5)) * np.pi / _ANGLES, np.nan)


def _segments_of(
    points_m: Float64, middle_m: Float64, angle: float, crop: Crop
) -> list[tuple[Float64, Float64, float, int, float]]:
    """The rows of one patch as straight lines of the given direction, each turned as it fits."""
    from scipy.signal import find_peaks  # late: it imports all of scipy.stats

    side = crop.patch_m
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    local = points_m - middle_m
    s, v = local @ along, local @ across
    bin_m = crop.min_spacing_m / _BINS
    first = float(v.min()) - 1.0
    counts = np.bincount(((v - first) / bin_m).astype(np.int64))
    profile = correlate1d(np.pad(counts.astype(np.float64), 12), _SMOOTH, mode="constant")
    peaks, _ = find_peaks(
        profile, distance=0.75 * crop.min_spacing_m / bin_m, prominence=0.25 * profile.max()
    )
    # From one end to the other.
    order = s.argsort()
    s, v, inside = s[order], v[order], np.empty(len(s))
    step = max(crop.plant_spacing_m, 0.5)
    pieces = []
    for peak in peaks:
        guess = first + (peak - 12 + 0.5) * bin_m
        at, slope, count, occupied = fit_line(
            s, v, guess, 0.33 * crop.min_spacing_m, side, step, inside
        )
        if count < _MIN_POINTS // 2:
            continue
        trim = 1 + count // 40  # specks beyond its ends are no part of a row
        low, high = float(inside[trim]), float(inside[count - 1 - trim])
        length, centre = high - low, 0.5 * (low + high)
        filled = min(1.0, occupied * step / max(length, step))
        if length < 0.3 * side or filled < 0.5:
            continue
        pieces.append((centre, at + slope * centre, slope, 0.5 * length, count, filled))
    if not pieces:
        return []
    place = np.array([piece[:3] for piece in pieces])
    middles = middle_m + place[:, :1] * along + place[:, 1:2] * across
    turned = along + place[:, 2:] * across
    turned /= np.hypot(turned[:, 0], turned[:, 1])[:, None]
    return [
        (middle, out, *piece[3:])
        for middle, out, piece in zip(middles, turned, pieces, strict=True)
    ]


@kernel
def fit_line(s, v, at, gate, side, step, inside):  # type: ignore[no-untyped-def]
    """The line v = at + slope·s near a peak, how many points are on it, whose s are written, and in
    how many stretches of `step` there are any; s ascends. Of too few points their number counts."""
    slope, count, occupied = 0.0, 0, 0
    for _ in range(3):
        count, mean_s, mean_v = 0, 0.0, 0.0
        for k in range(len(s)):
            if abs(v[k] - at - slope * s[k]) < gate:
                inside[count] = s[k]
                count += 1
                mean_s += s[k]
                mean_v += v[k]
        if count < _MIN_POINTS // 2:
            break
        mean_s, mean_v = mean_s / count, mean_v / count
        variance, both, occupied, last = 0.0, 0.0, 0, -np.inf
        for k in range(len(s)):
            if abs(v[k] - at - slope * s[k]) < gate:
                variance += (s[k] - mean_s) ** 2
                both += (s[k] - mean_s) * v[k]
                place = math.floor(s[k] / step)
                occupied += place != last
                last = place
        # Too short a piece has no direction of its own.
        is_long = variance > count * (0.12 * side) ** 2
        slope = min(max(both / max(variance, 1e-9), -0.15), 0.15) if is_long else 0.0
        at = mean_v - slope * mean_s
    return at, slope, count, occupied


def link(segments: Segments, crop: Crop) -> Int64:
    """Which chain each segment belongs to: segments that lie on each other's lines are one row.

    Both must see the other within a fifth of a row's spacing at the place where they meet.
    """
    a, b = cKDTree(segments.middle_m).query_pairs(1.1 * crop.patch_m, output_type="ndarray").T
    step = segments.middle_m[b] - segments.middle_m[a]
    turn = segments.along[a, 0] * segments.along[b, 1] - segments.along[a, 1] * segments.along[b, 0]
    apart = np.abs((step * segments.along[a]).sum(axis=1))
    off = [
        np.abs(step[:, 0] * segments.along[k, 1] - step[:, 1] * segments.along[k, 0])
        for k in (a, b)
    ]
    touching = apart <= segments.half_m[a] + segments.half_m[b] + 0.25 * crop.patch_m
    near = np.maximum(*off) <= 0.22 * crop.min_spacing_m + 0.03 * apart
    linked = touching & near & (np.abs(turn) < np.sin(_MAX_TURN_RAD))
    return linked_parts(np.column_stack([a[linked], b[linked]]), len(segments.half_m))
