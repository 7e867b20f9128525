"""The vehicle-fixed local grid: its geometry and its values.

Axes as in the paper: x to the right, symmetric about the vehicle; y forward from the camera;
the origin is the grid origin of `geometry.rig`. Arrays are indexed [row, column]: row 0
is nearest to the vehicle, column 0 is the leftmost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fieldgrid.core import Bool, ConfigError, Float64, UInt8, check_local_grid

if TYPE_CHECKING:
    from fieldgrid.core import GridSettings

OBSTACLE_ABOVE = 100
"""3D density above which the paper calls a cell a potential obstacle."""

FREE_UP_TO = 50
"""3D density up to which an observed cell is called free; between the two it is in doubt.

50/255 is the 0.196 that map servers use as their free threshold.
"""

HIDDEN_FROM = 0.8
"""A free look is hidden where an obstacle stands in its line of sight between this share of its
distance and the cell: the ray passes it at less than a fifth of the camera's height."""

GROUND_CHANNEL, NO_GROUND_CM = "ground_cm", -32768
"""The channel of a frame that says how high the ground of its cells lies, int16 [n_y, n_x],
centimetres above the ground on which its vehicle stands; and what stands where none was seen."""

STEP_CHANNEL, NO_STEP_KNOWN = "step_cm", 255
"""The channel of a frame that says how high the highest step in the ground at its cells is, uint8
[n_y, n_x], centimetres, up to 254; and what stands where that is not known."""

DROP_CHANNEL, BEYOND_DROP, NO_DROP_TOLD = "drop_cm", 254, 255
"""The channel of a frame that says how far the ground falls away from the vehicle at its cells,
uint8 [n_y, n_x], centimetres up to 253, 0 where it does not; what stands where the ground lies
behind such an edge and below it; and where the frame cannot tell either."""

TOP_CHANNEL, FOOT_CHANNEL, GROUND_BELOW = "top_dm", "foot_dm", 128
"""The channels of a frame that say how high what stands at its cells reaches and how low it begins,
uint8 [n_y, n_x], decimetres above the ground, 0 where nothing stands; and what is added to the
lower one where the ground below it shows."""


@dataclass(frozen=True, slots=True)
class GridSpec:
    """n_x x n_y square cells: `width_m` across, centred on the vehicle, `length_m` ahead."""

    width_m: float = 10.0
    length_m: float = 15.0
    cell_m: float = 0.05

    def __post_init__(self) -> None:
        check_local_grid(self.width_m, self.length_m, self.cell_m)

    @classmethod
    def of(cls, settings: GridSettings) -> GridSpec:
        """The grid of these settings."""
        return cls(settings.width_m, settings.length_m, settings.cell_m)

    @property
    def n_x(self) -> int:
        """Cells across (columns)."""
        return round(self.width_m / self.cell_m)

    @property
    def n_y(self) -> int:
        """Cells ahead (rows)."""
        return round(self.length_m / self.cell_m)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (n_y, n_x) of the grid's arrays."""
        return self.n_y, self.n_x

    @property
    def reach_m(self) -> float:
        """r_max: from the origin to the farthest corner (Eq. 1, corrected)."""
        return math.hypot(self.width_m / 2.0, self.length_m)

    def centres_m(self) -> tuple[Float64, Float64]:
        """x of each column's and y of each row's centre, metres in the vehicle frame."""
        x = (np.arange(self.n_x, dtype=np.float64) + 0.5) * self.cell_m - self.width_m / 2.0
        y = (np.arange(self.n_y, dtype=np.float64) + 0.5) * self.cell_m
        return x, y


@dataclass(frozen=True, slots=True)
class LocalGrid:
    """One frame's 3D density, uint8 [n_y, n_x], and the mask of the cells that were seen.

    0 with `observed` is free ground; without, nothing is known of the cell.
    """

    spec: GridSpec
    density: UInt8
    observed: Bool

    def guarded(self, drops_cm: UInt8 | None) -> LocalGrid:
        """The grid for who plans by it: with an obstacle where the ground falls away, and without
        what lies beyond, by the channel `DROP_CHANNEL` [n_y, n_x]."""
        if drops_cm is None:
            return self
        falls = (drops_cm > 0) & (drops_cm < BEYOND_DROP)
        density = np.where(falls & self.observed, np.uint8(255), self.density)
        return LocalGrid(self.spec, density, self.observed & (drops_cm != BEYOND_DROP))

    def __post_init__(self) -> None:
        for name, array in (("density", self.density), ("observed", self.observed)):
            if array.shape != self.spec.shape:
                raise ConfigError(
                    f"A local grid's {name} has shape {array.shape}, its geometry asks for "
                    f"{self.spec.shape} (n_y, n_x)."
                )
