"""What poses and the window go through, once before a session: it is compiled or loaded then, which
takes seconds on the first run of a machine, and the first poses need not wait for it."""

from __future__ import annotations

import time

import numpy as np

from fieldgrid.core import BuildSettings, Quality
from fieldgrid.geometry import Datum, Fix, GridSpec, LocalGrid, Rig
from fieldgrid.live.options import LiveOptions
from fieldgrid.live.perceiver import PerceivedFrame
from fieldgrid.live.pose.poser import Poser
from fieldgrid.live.pose.sensor_rows import rows_of
from fieldgrid.perception import CameraStep

_SECONDS, _RATE_HZ, _SPEED_MPS = 8.0, 5.0, 1.0
_DATUM = Datum(45.0, 5.0, 200.0)


def warm_up_poses(rig: Rig, settings: BuildSettings) -> None:
    """Drive to the north in a drive that is made up, with one grid, and forget it."""
    poser = Poser(rig, settings, _DATUM, LiveOptions(map_side_m=4.0), lambda _: None)
    spec = GridSpec.of(settings.grid)
    grid = LocalGrid(spec, np.zeros(spec.shape, np.uint8), np.ones(spec.shape, np.bool_))
    noise_m = np.random.default_rng(0).normal(0.0, 0.01, (round(_SECONDS * _RATE_HZ), 2))
    for k, (east_m, north_m) in enumerate(noise_m.tolist()):
        seconds = k / _RATE_HZ
        time_ns = round(1e9 * (1.0 + seconds))
        lat, lon, height_m = _DATUM.to_geodetic(east_m, north_m + _SPEED_MPS * seconds, 1.0)
        place = float(lat), float(lon), float(height_m)
        poser.put(Fix(time_ns, *place, Quality.RTK_FIXED, 12, sigma_m=0.02))
        poser.put(("gyro", rows_of("gyro", time_ns, 0.0)))
        way = (_SPEED_MPS / _RATE_HZ, 0.0, 0.0, 0.01, 0.05, 0.0, 0.0, 0.0, 0.1)
        step = CameraStep(*way, 100)
        poser.put(PerceivedFrame(str(k), time_ns, grid, True, step, time.monotonic()))
    poser.close()
