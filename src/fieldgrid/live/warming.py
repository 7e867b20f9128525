"""What poses and the window go through, once before a session: it is compiled or loaded then, which
takes seconds on the first run of a machine, and the first poses need not wait for it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from fieldgrid.core import BuildSettings, FieldgridError, Quality
from fieldgrid.geometry import Datum, Fix, GridSpec, LocalGrid, Pose, Rig
from fieldgrid.live.pose.fixed_lag import FixedLagSmoother
from fieldgrid.live.pose.sensor_rows import rows_of
from fieldgrid.live.window import PlacedGrid, RollingWindow
from fieldgrid.maps import Costmap, Transfer
from fieldgrid.perception import CameraStep

_SECONDS, _RATE_HZ, _SPEED_MPS = 8.0, 5.0, 1.0
_DATUM = Datum(45.0, 5.0, 200.0)


def warm_up_poses(rig: Rig, settings: BuildSettings) -> None:
    """Estimate a made-up drive to the north, place a grid at its end, and forget both."""
    trailing = FixedLagSmoother(rig, settings, _DATUM, _SECONDS)
    noise_m = np.random.default_rng(0).normal(0.0, 0.01, (round(_SECONDS * _RATE_HZ), 2))
    for k, (east_m, north_m) in enumerate(noise_m.tolist()):
        seconds = k / _RATE_HZ
        time_ns = round(1e9 * (1.0 + seconds))
        lat, lon, height_m = _DATUM.to_geodetic(east_m, north_m + _SPEED_MPS * seconds, 1.0)
        place = float(lat), float(lon), float(height_m)
        trailing.add_fix(Fix(time_ns, *place, Quality.RTK_FIXED, 12, sigma_m=0.02))
        trailing.add_rows("gyro", rows_of("gyro", time_ns, 0.0))
        way = (_SPEED_MPS / _RATE_HZ, 0.0, 0.0, 0.01, 0.05, 0.0, 0.0, 0.0, 0.1)
        trailing.add_frame(time_ns, CameraStep(*way, 100))
    with suppress(FieldgridError):  # what asks for more than this drive tells, such as a heading
        trailing.estimate(trailing.newest_ns)
    pose = Pose(trailing.newest_ns, 0.0, 0.0, 0.0, 0.0, 0.1, 0.5, _SPEED_MPS)
    spec = GridSpec.of(settings.grid)
    seen = LocalGrid(spec, np.zeros(spec.shape, np.uint8), np.ones(spec.shape, np.bool_))
    transfer = settings.map.transfer or Transfer.CENTRE
    window = RollingWindow(settings.universal_cell_m, transfer, 4.0, spec.reach_m)
    view, *_ = window.view([PlacedGrid(seen, pose, pose.time_ns, 0.1)], _DATUM, pose.time_ns)
    Costmap.from_view(view)
