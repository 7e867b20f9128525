"""Where a vehicle is to be slow: a mask for Nav2's speed filter, in percent of its highest speed.

The filter takes base + multiplier * value for the limit, and 0 for none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.core import (
    Bool,
    Flag,
    setting,
)
from fieldgrid.export.options import CurveOptions
from fieldgrid.export.route_file import read_poses
from fieldgrid.maps import OCCUPIED, UNKNOWN_OCCUPANCY, MapView

FILTER_INFO, FILTER_MASK = "/speed_filter_info", "/speed_filter_mask"

SPEED_FILTER = 1, 100.0, -1.0
"""Type, base and multiplier of a filter whose limits are percent of the highest speed."""


class SpeedOptions(CurveOptions):
    """Where the speed is limited."""

    slow_percent: int | None = setting(
        None,
        "speed in slow zones in percent of the maximum; writes a mask for the speed filter",
        usual="no mask",
        flag=Flag("--slow-percent", "1..99"),
        ge=1,
        le=99,
    )
    slow_within_m: float = setting(
        1.0,
        "slow within this distance of obstacles, keep-outs, turns and unseen ground",
        flag=Flag("--slow-within", "M"),
        ge=0.0,
        le=50.0,
    )
    slow_seen_by: int = setting(
        0,
        "slow where fewer frames than this saw a cell",
        flag=Flag("--slow-seen-by", "FRAMES"),
        ge=0,
        le=10**6,
    )
    slow_turns: Path | None = setting(
        None,
        "slow in the turns of this route",
        usual="none",
        flag=Flag("--slow-turns", "ROUTE.csv"),
    )
    slow_radius_m: float = setting(
        10.0,
        "largest radius that counts as a turn of a route",
        flag=Flag("--slow-radius", "M"),
        gt=0.0,
        le=1000.0,
    )


def speed_mask(
    view: MapView,
    occupancy: npt.NDArray[np.int8],
    keepout: npt.NDArray[np.int8],
    options: SpeedOptions,
) -> npt.NDArray[np.int8]:
    """Values of the mask, int8 [rows north, columns east]: 0 without a limit. The view has the
    layer `count` where the options ask for cells that few frames saw."""
    import cv2

    assert options.slow_percent is not None
    barred = np.isin(occupancy, (OCCUPIED, UNKNOWN_OCCUPANCY)) | (keepout > 0)
    if options.slow_turns is not None:
        barred |= _turns(options.slow_turns, options.slow_radius_m, view)
    # Beyond the map nothing was seen, either.
    free = np.pad((~barred).astype(np.uint8), 1)
    away = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    # From middle to middle; some point of either cell may be half a diagonal nearer.
    slow = (away - np.sqrt(2.0)) * view.lattice.cell_m < options.slow_within_m
    if options.slow_seen_by:
        slow |= view.layer("count") < options.slow_seen_by
    return np.where(slow, np.int8(100 - options.slow_percent), np.int8(0))


def filter_parameters(mask: str) -> dict[str, Any]:
    """Parameters of the two servers of Nav2 that the filter listens to."""
    type_, base, multiplier = SPEED_FILTER
    return {
        "speed_filter_mask_server": {
            "ros__parameters": {
                "frame_id": "map", "topic_name": FILTER_MASK, "yaml_filename": mask,
            }
        },
        "speed_costmap_filter_info_server": {
            "ros__parameters": {
                "type": type_, "filter_info_topic": FILTER_INFO,
                "mask_topic": FILTER_MASK, "base": base, "multiplier": multiplier,
            }
        },
    }  # fmt: skip


def _turns(path: Path, radius_m: float, view: MapView) -> Bool:
    """The cells of the poses in which a route turns."""
    east_m, north_m, curvature = read_poses(path, "east_m", "north_m", "curvature_1pm").T
    in_turn, window = np.abs(curvature) > 1.0 / radius_m, view.window
    i, j = view.lattice.index(east_m[in_turn], north_m[in_turn])
    i, j = i - window.i0, j - window.j0
    found = np.zeros(window.shape, dtype=np.bool_)
    inside = (i >= 0) & (j >= 0) & (i < window.width) & (j < window.height)
    found[j[inside], i[inside]] = True
    return found
