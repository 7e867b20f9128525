"""From 3D density to what planners count in: an occupancy, and a cost.

The curve is told by three numbers and is monotone: a higher density never costs less. What was
not observed has no density, so it is kept apart: -1 in an occupancy, 255 in a cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, Bool, ConfigError, Float32, UInt8
from fieldgrid.geometry import FREE_UP_TO, OBSTACLE_ABOVE

OCCUPIED, UNKNOWN_OCCUPANCY = 100, -1
"""Of nav_msgs/OccupancyGrid: an obstacle, and a cell of which nothing is known."""

DENSITIES = ("density", "lasting", "max")
"""The layers that hold densities, from which a cost can be made."""

LEAST_DROP_M = 0.1
"""The least drop of the ground that is an obstacle; a drop of 15 cm reads as 11 to 13."""

LEAST_SEEN = 0.5
"""The share of the map's own cells that must have been seen for a larger cell to be known."""

INSCRIBED, LETHAL, UNKNOWN_COST = 253, 254, 255
"""Of Nav2's costmaps: too near an obstacle, an obstacle, and a cell of which nothing is known."""


@dataclass(frozen=True, slots=True)
class CostCurve:
    """Density (0..255) to occupancy (0..100): free, in doubt, an obstacle.

    0 up to `free_up_to`, 100 above `obstacle_above`, and 1..99 between the two, rising as
    t**shape, where t goes from 0 at `free_up_to` to 1 at the first density of an obstacle. A
    shape of 1 is a straight line; above 1 doubt is cheap until it is nearly an obstacle, below 1
    it is dear at once.

    A cell that is larger than the map's own is decided by those in it, never by their mean: it is
    an obstacle where one of them is, and unknown, if it is no obstacle, where less than the share
    `least_seen` of them was observed. Where the ground falls away by `least_drop_m` it is an
    obstacle, too: `MapView.decision` is given that.
    """

    free_up_to: int = FREE_UP_TO
    obstacle_above: int = OBSTACLE_ABOVE
    shape: float = 1.0
    least_seen: float = LEAST_SEEN
    least_drop_m: float = LEAST_DROP_M

    def __post_init__(self) -> None:
        if not 0 <= self.free_up_to <= self.obstacle_above <= 254:
            raise ConfigError(
                f"Free up to a density of {self.free_up_to} and an obstacle above "
                f"{self.obstacle_above} is no curve; give 0 <= free <= obstacle <= 254, such as "
                f"{FREE_UP_TO} and {OBSTACLE_ABOVE}."
            )
        if not (math.isfinite(self.shape) and 0.1 <= self.shape <= 10.0):
            raise ConfigError(
                f"A cost curve's shape of {self.shape} is outside 0.1..10; 1 is a straight line."
            )
        if not 0.0 < self.least_seen <= 1.0:
            raise ConfigError(
                f"A least share seen of {self.least_seen} is not above 0 and up to 1; "
                f"{LEAST_SEEN:g} asks for half of the cells."
            )

        if not self.least_drop_m > 0.0:
            raise ConfigError(
                f"A least drop of {self.least_drop_m} m is not above 0; {LEAST_DROP_M:g} counts "
                "every drop as an obstacle, inf none."
            )

    def table(self) -> npt.NDArray[np.int8]:
        """The occupancy of each density, int8 [256]."""
        density = np.arange(256, dtype=np.float64)
        rise = (density - self.free_up_to) / (self.obstacle_above + 1 - self.free_up_to)
        doubt = np.clip(np.rint(OCCUPIED * np.clip(rise, 0.0, 1.0) ** self.shape), 1, 99)
        free, occupied = density <= self.free_up_to, density > self.obstacle_above
        return np.select([free, occupied], [0, OCCUPIED], doubt).astype(np.int8)

    def occupancy(
        self, density: UInt8, seen: Bool | Float32, keepout: Bool | None = None
    ) -> npt.NDArray[np.int8]:
        """0..100, -1 where unknown, int8 of the arrays' shape; 100 where `keepout`.

        `density` is the highest of the map's own cells in each cell, and `seen` the share of them
        that was observed (`MapView.peak` and `seen_share`); where cells are the map's own, their
        density and whether they were observed. All three are `MapView.decision`.
        """
        return self._looked_up(self.table(), density, seen, keepout, UNKNOWN_OCCUPANCY, OCCUPIED)

    def cost(self, density: UInt8, seen: Bool | Float32, keepout: Bool | None = None) -> UInt8:
        """What Nav2's static layer makes of the occupancy, uint8 of the arrays' shape.

        0 free, up to 251 in doubt, 254 an obstacle, 255 unknown: that layer with
        `trinary_costmap: false`, `lethal_cost_threshold: 100` and `track_unknown_space: true`.
        """
        costs = (self.table().astype(np.int64) * LETHAL // OCCUPIED).astype(np.uint8)
        return self._looked_up(costs, density, seen, keepout, UNKNOWN_COST, LETHAL)

    def _looked_up(
        self,
        table: AnyArray,
        density: UInt8,
        seen: Bool | Float32,
        keepout: Bool | None,
        unknown: int,
        lethal: int,
    ) -> AnyArray:
        values = table[density]
        enough = np.where(density > self.obstacle_above, seen > 0.0, seen >= self.least_seen)
        values[~enough] = unknown
        if keepout is not None:
            values[keepout] = lethal
        return values
