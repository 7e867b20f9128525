"""Things that moved within a drive: the obstacle cells that one left, also those not seen through.

A car that overtakes leaves cells that no frame sees again, beside others that were seen through
(`moved`, of `layers.built_in.moved`). So cells are taken together: obstacle cells that hang
together are a thing, and where a part of a thing has moved, all of it has. What stands among what
moved goes with it; what more than half of the drives saw standing stays.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Bool
from fieldgrid.geometry import OBSTACLE_ABOVE
from fieldgrid.maps.views.view import MapView

LAYERS = ("moved", "sessions", "persistence")
"""What tells of cells that moved."""

_SHARE = 0.02
"""The share of the cells of a thing that were seen through; of what stands it is below 0.001."""

_JOINED_M = 0.2
"""Cells of one thing are no farther from each other."""

MARGIN_M = 5.0
"""How far around the square that is worked on a thing is followed."""


def moved_cells(view: MapView, layer: str) -> Bool:
    """The cells of what moved in a view of the map's own cells with `LAYERS`."""
    moved = view.layer("moved") > 0
    if not moved.any():
        return moved
    import cv2  # reading a map takes no time for it

    obstacle = view.observed & (view.layer(layer) > OBSTACLE_ABOVE)
    side = 2 * round(0.5 * _JOINED_M / view.lattice.cell_m) + 1
    joined = cv2.dilate(obstacle.astype(np.uint8), np.ones((side, side), np.uint8))
    count, things = cv2.connectedComponents(joined, connectivity=8)
    cells, gone = (
        np.bincount(things[where], minlength=count) for where in (obstacle, obstacle & moved)
    )
    drives = view.layer("sessions").astype(np.float64)
    stood = np.nan_to_num(view.layer("persistence")) * drives
    # Whether a drive in which it moved has an obstacle in the mean is not kept: drives that stood
    # are then as many as they can be, so that in doubt an obstacle remains.
    stays = 2.0 * np.minimum(stood, drives - 1.0) > drives
    of_thing = (gone > _SHARE * cells)[things]
    return np.asarray((moved | obstacle & of_thing) & ~stays)
