"""Windows of a session that is made up, as clients get them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fieldgrid.core import Quality
from fieldgrid.geometry import Datum, FixColumns, Lattice, Pose, Status, Window
from fieldgrid.live import LiveEvent, LivePose, LiveWindow, What, WindowDoubt
from fieldgrid.maps import Costmap, MapView

DATUM = Datum(41.65, -4.72, 787.4)
CELL_M = 0.1
FIRST_NS = 1_308_133_815_469_000_000
TIMEOUT_S = 60.0
OBSTACLE_M = 2.0
"""So far in front of the middle of a window, to the north, a wall crosses it; the west half was
not seen."""


def pose_of(
    east_m: float, north_m: float, heading_deg: float = 90.0, status: Status = Status.OK
) -> Pose:
    return Pose(FIRST_NS, east_m, north_m, 0.0, heading_deg, 0.02, 0.4, 1.25, status, "")


def window(
    pose: Pose | None,
    *,
    doubt: str = "",
    gear: int = 1,
    size: tuple[int, int] = (200, 200),
    fixes: Sequence[tuple[float, float]] = (),
    time_ns: int = FIRST_NS,
) -> LiveWindow:
    """A window about the pose: free ground, a wall in front, nothing seen in the west."""
    height, width = size
    at_m = (0.0, 0.0) if pose is None or np.isnan(pose.east_m) else (pose.east_m, pose.north_m)
    i, j = (round(value / CELL_M) for value in at_m)
    place = Window(i - width // 2, j - height // 2, width, height)
    density = np.zeros(size, dtype=np.uint8)
    wall = height // 2 + round(OBSTACLE_M / CELL_M)
    density[wall : wall + 5] = 255
    observed = np.ones(size, dtype=np.bool_)
    observed[:, : width // 2] = False
    view = MapView(Lattice(CELL_M), place, density, observed, DATUM, is_base=True)
    return _window(view, pose, doubt, gear, fixes, time_ns)


def noisy(size: tuple[int, int], pose: Pose) -> LiveWindow:
    """A window that no picture format makes small."""
    random = np.random.default_rng(1)
    density = random.integers(0, 256, size, dtype=np.uint8)
    place = Window(0, 0, size[1], size[0])
    seen = np.ones(size, dtype=np.bool_)
    view = MapView(Lattice(CELL_M), place, density, seen, DATUM, is_base=True)
    return _window(view, pose, "", 0, (), FIRST_NS)


def _window(
    view: MapView,
    pose: Pose | None,
    doubt: str,
    gear: int,
    fixes: Sequence[tuple[float, float]],
    time_ns: int,
) -> LiveWindow:
    lat_deg, lon_deg, _ = DATUM.to_geodetic(*np.array([*fixes, (0.0, 0.0)]).T, 0.0)
    times = time_ns + np.arange(len(fixes)) * 100_000_000
    columns = FixColumns.of(
        times,
        lat_deg=lat_deg[:-1],
        lon_deg=lon_deg[:-1],
        height_m=DATUM.height_m,
        quality=int(Quality.RTK_FIXED),
    )
    random = np.random.default_rng(2)
    age_s = np.where(view.observed, random.uniform(0.0, 100.0, view.observed.shape), np.nan)
    sigma_m = np.where(view.observed, random.uniform(0.0, 3.0, view.observed.shape), np.nan)
    cells = Costmap.from_view(view), view, age_s.astype(np.float32), sigma_m.astype(np.float32)
    used = np.arange(len(fixes)) > 0  # all but the first
    code = WindowDoubt.POSE if doubt else WindowDoubt.NONE
    return LiveWindow(time_ns, *cells, pose, doubt, 7, "000007", 0.1, code, gear, columns, used)


def settled(
    east_m: float, north_m: float, status: Status = Status.OK, *, gear: int = 1
) -> LivePose:
    return LivePose("000007", pose_of(east_m, north_m, 90.0, status), gear, is_settled=True)


def event(text: str, what: What = What.POSE) -> LiveEvent:
    return LiveEvent(what, text, FIRST_NS)
