"""What a frame keeps beside its local grid: the ground's heights and edges, and what stands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Bool, Float32, Float64, Index, Int16, UInt8
from fieldgrid.geometry import (
    BEYOND_DROP,
    DROP_CHANNEL,
    FOOT_CHANNEL,
    GROUND_CHANNEL,
    NO_DROP_TOLD,
    NO_GROUND_CM,
    NO_STEP_KNOWN,
    STEP_CHANNEL,
    TOP_CHANNEL,
    GridSpec,
)
from fieldgrid.perception.edges import Edges
from fieldgrid.perception.ground import PATCH_M, GroundPlane

MOST_ABOVE_M = 100.0
"""No ground is seen that lies farther above or below the vehicle than this."""

TERRAIN_M = 0.2
"""Heights of the ground, which is followed in patches of half a metre, are kept for blocks of this
size: a fifth of the bytes, and 1 cm on a slope of 10°. So are those of what stands on it."""


class FrameGround(NamedTuple):
    """What was found of the ground in one frame: for tables, for doubt, and for the terrain.

    `heights_cm` [n_y, n_x] is the channel `GROUND_CHANNEL`, None where the vehicle's tilt is not
    known; `steps_cm`, `drops_cm`, `tops_dm` and `feet_dm` are `STEP_CHANNEL`, `DROP_CHANNEL`,
    `TOP_CHANNEL` and `FOOT_CHANNEL`, None where no ground was found.
    """

    camera_height_m: float
    pitch_deg: float
    roll_deg: float
    refined: bool
    heights_cm: Int16 | None = None
    steps_cm: UInt8 | None = None
    drops_cm: UInt8 | None = None
    tops_dm: UInt8 | None = None
    feet_dm: UInt8 | None = None

    def channels(self) -> dict[str, AnyArray]:
        """What a frame keeps of it beside its grid."""
        kept = {
            GROUND_CHANNEL: self.heights_cm,
            STEP_CHANNEL: self.steps_cm,
            DROP_CHANNEL: self.drops_cm,
            TOP_CHANNEL: self.tops_dm,
            FOOT_CHANNEL: self.feet_dm,
        }
        return {name: array for name, array in kept.items() if array is not None}


class HeightBlocks:
    """The squares of cells of a grid for which heights are kept; those at its ends may be less."""

    def __init__(self, spec: GridSpec) -> None:
        side = max(round(TERRAIN_M / spec.cell_m), 1)
        self.side_m = side * spec.cell_m
        self.rows, self.columns = (np.arange(n) // side for n in spec.shape)
        self.shape = int(self.rows[-1]) + 1, int(self.columns[-1]) + 1
        self._side = side
        self.middles: tuple[Index, Index] = (
            np.minimum(np.arange(self.shape[0]) * side + side // 2, spec.n_y - 1),
            np.minimum(np.arange(self.shape[1]) * side + side // 2, spec.n_x - 1),
        )

    def middle(self, cells: AnyArray) -> AnyArray:
        """Of values of cells [n_y, n_x], those in the middle of blocks."""
        return cells[self.middles[0]][:, self.middles[1]]

    def any(self, cells: Bool) -> Bool:
        """The blocks in which any of the cells [n_y, n_x] is."""
        rows = _any_of_each(cells, self._side)
        return _any_of_each(rows.T, self._side).T

    def at_cells(self, values: AnyArray) -> AnyArray:
        """The values of blocks at their cells, [n_y, n_x]."""
        return values[self.rows][:, self.columns]


def _any_of_each(rows: Bool, side: int) -> Bool:
    """Of rows [n, m], those of each `side` that follow one another; the last may be fewer."""
    found = rows[::side].copy()
    for k in range(1, side):
        more = rows[k::side]
        found[: len(more)] |= more
    return found


def ground_heights_cm(
    plane: GroundPlane, mounted_m: float, spec: GridSpec, ground_m: Float32, seen: Bool
) -> Int16:
    """Heights of the ground, above the place below the sensor that is its mounted height lower,
    in blocks in which it was seen, int16 [n_y, n_x]."""
    blocks = HeightBlocks(spec)
    x, y = (at[middle] for at, middle in zip(spec.centres_m(), blocks.middles[::-1], strict=True))
    above_m = blocks.middle(ground_m) + (mounted_m - plane.height_m)
    above_m = above_m + plane.rise[0] * x + plane.rise[1] * y[:, None]
    within = blocks.any(seen) & (np.abs(above_m) < MOST_ABOVE_M)  # not where it is NaN
    heights_cm = np.full(blocks.shape, NO_GROUND_CM, dtype=np.int16)
    heights_cm[within] = np.rint(100.0 * above_m[within])
    return blocks.at_cells(heights_cm)


def steps_cm(steps_m: Float64, spec: GridSpec, told: Bool) -> UInt8:
    """The steps at the cells that are `told` of [n_y, n_x], from those at patches [ny, nx],
    metres."""
    highest = np.minimum(np.rint(100.0 * steps_m), NO_STEP_KNOWN - 1)
    found = np.where(np.isnan(steps_m), NO_STEP_KNOWN, highest)
    cm = _patches_at_cells(found.astype(np.uint8), spec)
    return np.where(told, cm, np.uint8(NO_STEP_KNOWN))


def drops_cm(edges: Edges, spec: GridSpec, range_m: float) -> UInt8:
    """The drops at cells [n_y, n_x], and what lies beyond them, from edges at patches [ny, nx],
    told up to `range_m`."""
    j, i = np.indices(edges.drops.shape) + 0.5
    away_m = np.hypot(PATCH_M * i - spec.width_m / 2.0, PATCH_M * j)
    cm = np.minimum(np.rint(100.0 * edges.drops), BEYOND_DROP - 1).astype(np.uint8)
    cm[away_m > range_m] = NO_DROP_TOLD
    cm[edges.beyond & ((cm == 0) | (cm == NO_DROP_TOLD))] = BEYOND_DROP
    return _patches_at_cells(cm, spec)


def _patches_at_cells(patches: UInt8, spec: GridSpec) -> UInt8:
    """The values of patches [ny, nx] at the cells in them, [n_y, n_x]."""
    j, i = (((np.arange(n) + 0.5) * spec.cell_m / PATCH_M).astype(int) for n in spec.shape)
    cells: UInt8 = patches[j][:, i]
    return cells
