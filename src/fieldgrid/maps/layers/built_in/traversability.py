"""How well a vehicle can drive over the ground: a goodness of 0 to 1, as in Morphin and GESTALT.

Each cell has the goodness of the worst of its hazards (slope, roughness, steps; 0 where anything
stands on it), and the vehicle that of the worst cell under it. See Simmons et al., Experience with
rover navigation for lunar-like terrains (1995), and Goldberg, Maimone and Matthies, Stereo vision
and rover navigation software for planetary exploration (2002).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, palette
from fieldgrid.geometry import OBSTACLE_ABOVE
from fieldgrid.maps.layers.built_in.ground import SLOPE
from fieldgrid.maps.layers.built_in.relief import ROUGHNESS, STEP
from fieldgrid.maps.layers.declaration import Cells, Colours, Layer, Surroundings

SEEN_SHARE = 0.5
"""A place is judged where at least this share of the ground under the vehicle is known."""


class Mobility(NamedTuple):
    """What a vehicle can drive over; the defaults are those of a tractor for vineyards.

    `half_width_m` is the radius of the disc that stands for its footprint, whichever way it heads.
    Goodness falls evenly from 1 on even, level ground to 0 at `slope_deg`, at a `roughness_m`, and
    at steps of `step_m`.
    """

    half_width_m: float = 0.75
    slope_deg: float = 20.0
    roughness_m: float = 0.1
    step_m: float = 0.2


def traversability(mobility: Mobility, name: str = "traversability") -> Layer:
    """The layer of a vehicle; give it a name of its own and `register_layer` it."""

    def goodness(cells: Cells) -> AnyArray:
        hazards = (
            SLOPE.values(cells) / mobility.slope_deg,
            ROUGHNESS.values(cells) / mobility.roughness_m,
            STEP.values(cells) / mobility.step_m,
        )
        worst = np.maximum.reduce(hazards)  # not a number where one of them is not
        return np.where(cells["peak"] > OBSTACLE_ABOVE, 0.0, 1.0 - np.minimum(worst, 1.0))

    return Layer(
        name,
        "float32",
        "1",
        f"how well a vehicle {2.0 * mobility.half_width_m:g} m wide can stand here, by the worst "
        f"under it: 1 level and even, 0 a slope of {mobility.slope_deg:g}°, a roughness of "
        f"{mobility.roughness_m:g} m, a step of {mobility.step_m:g} m or an obstacle",
        ("density", "terrain", "surface"),
        goodness,
        float("nan"),
        Colours(palette.GOODNESS, 0.0, 1.0),
        around=Surroundings(mobility.half_width_m, worst_under),
    )


def worst_under(goodness: AnyArray, reach_cells: float) -> AnyArray:
    """The lowest of the known values in the disc about each cell [rows, columns].

    NaN where its own is not known, and where too little of the disc is, unless that is 0 already.
    """
    import cv2  # reading a map takes no time for it

    known = np.isfinite(goodness)
    side = np.arange(-math.floor(reach_cells), math.floor(reach_cells) + 1)
    disc = (np.hypot(side, side[:, None]) <= reach_cells).astype(np.uint8)
    worst = cv2.erode(
        np.where(known, goodness, 1.0).astype(np.float32),
        disc,
        borderType=cv2.BORDER_CONSTANT,
        borderValue=1.0,
    )
    seen = cv2.filter2D(
        known.astype(np.float32), -1, disc.astype(np.float32), borderType=cv2.BORDER_CONSTANT
    )
    enough = (np.rint(seen) >= SEEN_SHARE * disc.sum()) | (worst <= 0.0)
    return np.where(known & enough, worst, np.float32(np.nan))


TRAVERSABILITY = traversability(Mobility())
