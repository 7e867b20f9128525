"""Edges in the ground of one frame: its steps, which of them fall away, and what lies behind those.

The ground is given as heights on square patches of half a metre, row 0 nearest to the vehicle,
which stands before the middle of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Bool, Float64, kernel

WIDEST_GAP, GAP_RISE_M = 8, 0.1
"""Largest number of patches between the two sides of a step, and its least rise: a drop of 1 m
hides 4 m of ground. It is at least as steep as the line of sight past its edge, which is 1:5 at 10
m."""

LEAST_DROP_M = 0.1
"""Ground that falls by more than this from one patch to the next is a drop: 15 cm read as 11 to
13."""

STEEPEST = math.tan(math.radians(15.0))
"""What is less steep is no drop. Past an edge ground shows where the line of sight meets it, so if
that is less steep, what it hides may be the far side of a hill."""

GAP_FALL_M = 0.5 * STEEPEST
"""There, ground that is hidden falls by more than this per patch at a drop."""

EVEN_M = 0.04
"""The ground before a drop is that of the patch at its edge, unless the one before it is lower by
more than this."""

RIM_PATCHES, RIMS, DROPS = 2, 2, 4
"""An edge is continued by this number of patches where it was not found. Within as many of each
other lie two patches before an edge and four at it, or it is noise."""


class Edges(NamedTuple):
    """Of patches [ny, nx]: `steps`, the highest step that each is a side of, metres, NaN where that
    is not known; `drops`, the deepest one that falls away from the vehicle, 0 where there is none;
    `beyond`, whether it lies behind a drop, and lower than half of it."""

    steps: Float64
    drops: Float64
    beyond: Bool


def find_edges(height: Float64, within: Bool, steep: Bool) -> Edges:
    """The edges between heights [ny, nx], metres, NaN where the ground is not known; drops only
    `within` a part of it, where heights are sure enough; `steep` is where the line of sight is
    steeper than 15°.

    The step between two neighbours in a row or a column, of heights b and c, is what the slopes on
    either side do not explain: |(c - b) - (s + t) / 2|, where s and t are the rises from patch to
    patch before b and behind c, over two patches if they are known; but no more than |c - b|, for
    there may be a step before b. So neither a slope nor its foot (15°: 7 cm) is a step. A drop that
    hides the ground behind it is one as far as the gap reaches.

    A step is a drop where it falls away from the vehicle: in a column from the near to the far, in
    a row from the middle to the side. Where the patch at the edge is higher than the one before it,
    the fall is from that: so the crest of a hill is no drop, nor is a patch that is too high.
    """
    steps, drops, rims = [], [], []
    ways = (height, steep, height.shape[1] / 2.0), (height.T, steep.T, 0.0)
    for rows, steep_rows, first_outward in ways:
        step, drop, rim = (np.full(rows.shape, np.nan) for _ in range(3))
        # One memory order: compiled once.
        rows, steep_rows = np.ascontiguousarray(rows), np.ascontiguousarray(steep_rows)
        raise_to_steps(rows, steep_rows, first_outward, step, drop, rim)
        steps.append(step)
        drops.append(drop)
        rims.append(rim)
    drop, rim = np.fmax(drops[0], drops[1].T), np.fmax(rims[0], rims[1].T)
    told = np.isfinite(drop) & within
    drop = np.where(told & (_about(told).sum(axis=(2, 3)) >= DROPS), drop, 0.0)
    beyond = np.zeros(height.shape, dtype=np.bool_)
    rim = np.where(np.isfinite(rim) & within, rim, -np.inf)
    if drop.any():
        around = _about(rim)
        found = np.isfinite(around).sum(axis=(2, 3)) >= RIMS
        rim = np.where(found, around.max(axis=(2, 3)), -np.inf)
        lie_beyond(np.ascontiguousarray(height), rim, beyond)
    return Edges(np.fmax(steps[0], steps[1].T), drop, beyond)


def _about(values: AnyArray) -> AnyArray:
    """The values at the patches about each patch [ny, nx, 5, 5]; outside there are none."""
    side, nothing = 2 * RIM_PATCHES + 1, False if values.dtype == np.bool_ else -np.inf
    padded = np.pad(values, RIM_PATCHES, constant_values=nothing)
    return np.lib.stride_tricks.sliding_window_view(padded, (side, side))


@kernel
def raise_to_steps(height, steep, first_outward, steps, drops, rims):  # type: ignore[no-untyped-def]
    """Raise `steps` to those between neighbours in the rows of `height`, both [n, m], NaN where
    unknown; the slopes on both sides are needed, or one of them on either side of a gap.

    From `first_outward` on the columns lead away from the vehicle, before it towards it. `drops`
    are raised to what falls away, and `rims`, before it, to the level half way down.
    """
    n, m = height.shape
    for j in range(n):
        last = -1
        for i in range(m):
            if np.isnan(height[j, i]):
                continue
            apart, sides, slopes = i - last, 0, 0.0
            if last >= 0 and apart <= WIDEST_GAP:
                for start, way in ((last, -1), (i, 1)):
                    end = start
                    for _ in range(2):
                        if 0 <= end + way < m and not np.isnan(height[j, end + way]):
                            end += way
                    if end != start:
                        slopes += (height[j, end] - height[j, start]) / (end - start)
                        sides += 1
                if sides == 2 or (sides == 1 and apart > 1):
                    rise = height[j, i] - height[j, last]
                    step = min(abs(rise - apart * slopes / sides), abs(rise))
                    # Of a drop that hides ground the edge is the higher side.
                    first, stop = last, i + 1
                    if apart > 1:
                        first, stop = (last, i) if rise < 0.0 else (last + 1, i + 1)
                    for k in range(first, stop):
                        if (apart == 1 or step > GAP_RISE_M * apart) and not steps[j, k] >= step:
                            steps[j, k] = step
                    near, far, way = last, i, 1
                    if last + i + 1 < 2.0 * first_outward:
                        near, far, way = i, last, -1
                    level = height[j, near]
                    if 0 <= near - way < m and height[j, near - way] < level - EVEN_M:
                        level = height[j, near - way]
                    drop = min(step, level - height[j, far])
                    least = GAP_FALL_M * apart
                    if steep[j, near]:  # half of it is what a bend of 15° leaves of a step
                        least = 0.5 * least + EVEN_M
                    if drop >= LEAST_DROP_M and (apart == 1 or drop > least):
                        for k in range(first, stop):
                            if not drops[j, k] >= drop:
                                drops[j, k] = drop
                        half = level - 0.5 * drop
                        if not rims[j, near] >= half:
                            rims[j, near] = half
            last = i


@kernel
def lie_beyond(height, rims, beyond):  # type: ignore[no-untyped-def]
    """Set `beyond` where the way from the vehicle to a patch of `height`, all [ny, nx], has passed
    one of the `rims`, and ground was lower than that since; elsewhere than there they are -inf.

    Ways are the line of sight, the row and the column: near the vehicle, where an edge along its
    way meets the lines of sight, nothing is seen.
    """
    ny, nx = height.shape
    passed = np.full((ny, nx), -np.inf)
    for j in range(ny):
        for k in range(nx):
            # Middle, then alternately one further left and right: what lies before comes first.
            i = nx // 2 + ((k + 1) // 2) * (1 - 2 * (k % 2))
            if i < 0 or i >= nx:
                i = nx - 1 - i
            right, ahead = i + 0.5 - 0.5 * nx, j + 0.5
            far = max(abs(right), ahead)
            inward = i - int(np.sign(right)) if abs(right) > 0.5 else i
            level = -np.inf
            for jj, ii in (
                (j - int(np.floor(ahead / far + 0.5)), i - int(np.floor(right / far + 0.5))),
                (j, inward),
                (j - 1, i),
            ):
                if jj >= 0 and not (jj == j and ii == i):
                    before = passed[jj, ii] if passed[jj, ii] > -np.inf else rims[jj, ii]
                    level = max(level, before)
            if height[j, i] >= level:  # back on it; never, where it is NaN
                level = -np.inf
            passed[j, i] = level
            beyond[j, i] = level > -np.inf
