"""A row as it is seen: where its cells lie across it, from which sides, and where its faces are.

A camera in a lane sees the near face of a canopy and some of what is behind it. So the middle of
the cells that were seen lies 6 to 11 cm on the viewer's side of the middle of the row. The face
does not: it is the same whether the row was seen from one side or from both. A row that was seen
from both sides tells the width of the canopy, and with it the middle of one that was not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from fieldgrid.core import Bool, Float64
from fieldgrid.geometry import lengths, normals
from fieldgrid.maps import OBSTACLE, UNSEEN, Evidence

STATION_M = 0.5
"""Length of a row of which one position across it is taken."""

_SMOOTHED_M = 8.0
_SEEN_SHARE = 0.4
_CELLS = 3


class Profile(NamedTuple):
    """Stations of a row: distances along its reference line, the mean offset of their obstacle
    cells to the left of it, and how many these are.

    `share` [stations, columns] is the share of obstacle cells at distances `across_m` to the left,
    `left_share` and `right_share` that of the ground beside a station that was seen.
    """

    line: Float64
    along_m: Float64
    offset_m: Float64
    weight: Float64
    across_m: Float64
    share: Float64
    left_share: Float64
    right_share: Float64


class Faces(NamedTuple):
    """From which sides a row was seen at its stations, and its faces there.

    Each pair is the left and the right face beside the offsets, metres to the left, NaN without
    enough stations: of those of which the left side alone, the right side alone, and both were
    seen. `both_share` is the share of the last among all of which a side was.
    """

    left_seen: Bool
    right_seen: Bool
    left_m: float
    right_m: float
    full_m: tuple[float, float]
    both_share: float

    @property
    def full_width_m(self) -> float:
        """The distance of the two faces where both sides were seen; NaN without such stations."""
        return self.full_m[0] - self.full_m[1]


def take_profile(evidence: Evidence, line: Float64, gate_m: float) -> Profile:
    """The profile of a row near a reference line [n, 2], cells up to `gate_m` beside it."""
    strip = evidence.strip(line, gate_m, gate_m, STATION_M / 5.0)
    per = 5
    count = max(1, len(strip.along_m) // per)
    cells = strip.cells[: count * per].reshape(count, -1, len(strip.across_m))
    stations = strip.along_m[: count * per].reshape(count, -1).mean(axis=1)
    band = np.abs(strip.across_m) > 0.65 * gate_m
    left, right = (
        (cells[:, :, band & (np.sign(strip.across_m) == side)] != UNSEEN).mean(axis=(1, 2))
        for side in (1, -1)
    )
    obstacle = (cells == OBSTACLE).sum(axis=1)
    offset = np.zeros(len(stations))
    # The gate follows the row: first all that is nearer to it than to the next, then the canopy.
    for reach in (gate_m, 0.75 * gate_m, 0.6 * gate_m):
        inside = obstacle * (np.abs(strip.across_m[None, :] - offset[:, None]) < reach)
        weight = inside.sum(axis=1).astype(np.float64)
        total = inside @ strip.across_m
        pooled = uniform_filter1d(weight, 9), uniform_filter1d(total, 9)
        offset = np.divide(pooled[1], pooled[0], out=offset.copy(), where=pooled[0] > 0.0)
    mean = np.divide(total, weight, out=offset.copy(), where=weight > 0.0)
    weight[weight < _CELLS] = 0.0
    share = obstacle / cells.shape[1]
    return Profile(line, stations, mean, weight, strip.across_m, share, left, right)


def find_faces(profile: Profile) -> Faces:
    """The faces of a row, whose weights are zero beyond its ends.

    A face is where the share of obstacle cells, over all stations of which its side was seen, has
    fallen to half of its plateau: it does not depend on how deep one sees into the canopy.
    """
    used = np.flatnonzero(profile.weight > 0.0)
    # Of the row alone: the headland before and behind it is seen on both sides.
    own = slice(int(used[0]), int(used[-1]) + 1)
    left, right = (_seen(share, own) for share in (profile.left_share, profile.right_share))
    across_m = profile.across_m
    step = float(across_m[1] - across_m[0])
    left_only, right_only, both = (
        _half_height(profile.share[select], across_m, profile.offset_m[select], step)
        for select in (left & ~right, right & ~left, left & right)
    )
    both_share = float((left & right).sum() / max(int((left | right).sum()), 1))
    return Faces(left, right, left_only[0], right_only[1], both, both_share)


def _seen(share: Float64, own: slice) -> Bool:
    """Whether the ground beside each station of a row was seen, on the whole of some metres."""
    window = max(1, round(_SMOOTHED_M / STATION_M))
    seen = np.zeros(len(share), dtype=np.bool_)
    seen[own] = uniform_filter1d(share[own], window, mode="nearest") > _SEEN_SHARE
    return seen


def _half_height(
    share: Float64, across_m: Float64, offset_m: Float64, step: float
) -> tuple[float, float]:
    """The left and the right half height of the profile, metres beside the offsets."""
    if len(share) < 8:
        return np.nan, np.nan
    # Every station is moved onto the offsets by whole cells.
    shift = np.rint(offset_m / step).astype(np.int64)
    columns = np.arange(len(across_m))[None, :] + shift[:, None]
    inside = (columns >= 0) & (columns < len(across_m))
    moved = np.take_along_axis(share, columns.clip(0, len(across_m) - 1), axis=1) * inside
    profile = uniform_filter1d(moved.mean(axis=0), 3, mode="constant")
    residual = float((offset_m - shift * step).mean())
    floor = float(np.median(profile[np.abs(across_m) > 0.8 * np.abs(across_m).max()]))
    profile = np.maximum(profile - floor, 0.0)
    plateau = float(np.sort(profile)[-5:].mean())
    if plateau <= 0.0:
        return np.nan, np.nan
    above = np.flatnonzero(profile > 0.5 * plateau)
    first, last = int(above[0]), int(above[-1])

    def crossing(inner: int, outer: int) -> float:
        if not 0 <= outer < len(profile):
            return float(across_m[inner])
        a, b = profile[inner], profile[outer]
        part = (a - 0.5 * plateau) / max(a - b, 1e-12)
        return float(across_m[inner] + part * (across_m[outer] - across_m[inner]))

    return crossing(last, last + 1) - residual, crossing(first, first - 1) - residual


def moved(profile: Profile, offset_m: Float64) -> Float64:
    """The reference line moved to the left by the offsets, at the stations [n, 2]."""
    s = lengths(profile.line)
    middle = np.column_stack([np.interp(profile.along_m, s, profile.line[:, k]) for k in (0, 1)])
    left = normals(profile.line)
    left = np.column_stack([np.interp(profile.along_m, s, left[:, k]) for k in (0, 1)])
    return np.asarray(middle + offset_m[:, None] * left)
