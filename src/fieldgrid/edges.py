"""Edges in the ground of one frame: its steps, which of them fall away, and what lies behind those.

The ground is given as heights on square patches of half a metre, row 0 nearest to the vehicle,
which stands before the middle of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Bool, Float64
from fieldgrid.kernel import kernel

WIDEST_GAP, GAP_RISE_M = 8, 0.1
"""A step is looked for between patches that are at most so many apart, as a drop of 1 m hides 4 m
of ground. It is at least as steep as the line of sight past its edge, which is 1:5 at 10 m."""

LEAST_DROP_M = 0.1
"""Ground that falls by this from one patch to the next is a drop: one of 15 cm reads as 11 to 13."""

GAP_FALL_M = 0.5 * math.tan(math.radians(15.0))
"""A drop that hides ground falls by more than this per patch: what is less steep may be the far side
of a hill."""

RIM_PATCHES = 2
"""An edge is taken to go on for so many patches where it was not found."""


class Edges(NamedTuple):
    """Of patches [ny, nx]: `steps`, the highest step that each is a side of, metres, NaN where that
    is not known; `drops`, the deepest one that falls away from the vehicle, 0 where there is none;
    `beyond`, whether it lies behind a drop, and lower than half of it."""

    steps: Float64
    drops: Float64
    beyond: Bool


def find_edges(height: Float64) -> Edges:
    """The edges between heights [ny, nx], metres, NaN where the ground is not known.

    The step between two neighbours in a row or a column, of heights b and c, is what the slopes on
    either side do not explain: |(c - b) - (s + t) / 2|, where s and t are the rises from patch to
    patch before b and behind c, over two patches if they are known; but no more than |c - b|, for
    there may be a step before b. So neither a slope nor its foot (15°: 7 cm) is a step. A drop that
    hides the ground behind it is one as far as the gap reaches.

    A step is a drop where it falls away from the vehicle, from the lower of two patches before it:
    so the crest of a hill is none.
    """
    steps, drops, rims = [], [], []
    for rows, first_outward in ((height, height.shape[1] / 2.0), (height.T, 0.0)):
        rows = np.ascontiguousarray(rows)  # one memory order: compiled once
        step, drop, rim = (np.full(rows.shape, np.nan) for _ in range(3))
        raise_to_steps(rows, first_outward, step, drop, rim)
        steps.append(step)
        drops.append(drop)
        rims.append(rim)
    drop = np.nan_to_num(np.fmax(drops[0], drops[1].T))
    rim = np.fmax(rims[0], rims[1].T)
    beyond = np.zeros(height.shape, dtype=np.bool_)
    if not np.isnan(rim).all():
        around = np.pad(rim, RIM_PATCHES, constant_values=np.nan)
        side = 2 * RIM_PATCHES + 1
        wide = np.lib.stride_tricks.sliding_window_view(around, (side, side))
        rim = np.where(np.isnan(wide), -np.inf, wide).max(axis=(2, 3))
        lie_beyond(height, rim, beyond)
    return Edges(np.fmax(steps[0], steps[1].T), drop, beyond)


@kernel
def raise_to_steps(height, first_outward, steps, drops, rims):  # type: ignore[no-untyped-def]
    """Raise `steps` to those between neighbours in the rows of `height`, both [n, m], NaN where
    unknown; the slopes on both sides are needed, or one of them on either side of a gap.

    From `first_outward` on the columns lead away from the vehicle, before it towards it. `drops` are
    raised to what falls away, and `rims`, before it, to the level half way down.
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
                    if 0 <= near - way < m and height[j, near - way] < level:
                        level = height[j, near - way]
                    drop = min(step, level - height[j, far])
                    if drop >= LEAST_DROP_M and (apart == 1 or drop > GAP_FALL_M * apart):
                        for k in range(first, stop):
                            if not drops[j, k] >= drop:
                                drops[j, k] = drop
                        half = level - 0.5 * drop
                        if not rims[j, near] >= half:
                            rims[j, near] = half
            last = i


@kernel
def lie_beyond(height, rims, beyond):  # type: ignore[no-untyped-def]
    """Set `beyond` where the line from the vehicle to a patch of `height`, all [ny, nx], has passed
    one of the `rims`, and ground was lower than that since; where there is no rim they are -inf."""
    ny, nx = height.shape
    passed = np.full((ny, nx), -np.inf)
    for j in range(ny):
        for k in range(nx):
            # Middle, then alternately one further left and right: what is before a patch comes first.
            i = nx // 2 + ((k + 1) // 2) * (1 - 2 * (k % 2))
            if i < 0 or i >= nx:
                i = nx - 1 - i
            right, ahead = i + 0.5 - 0.5 * nx, j + 0.5
            far = max(abs(right), ahead)
            jj = j - int(np.floor(ahead / far + 0.5))
            ii = i - int(np.floor(right / far + 0.5))
            if jj < 0 or (jj == j and ii == i):
                continue
            level = passed[jj, ii]
            if level == -np.inf:
                level = rims[jj, ii]
            if height[j, i] >= level:  # back on it; never, where it is NaN
                level = -np.inf
            passed[j, i] = level
            beyond[j, i] = level > -np.inf
