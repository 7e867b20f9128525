"""Orientations that the drive denies: no grid is level by them while driving, as in a build."""

from __future__ import annotations

import math

import pytest

from fieldgrid.live import LiveOptions
from fieldgrid.live.pose.poser import Poser
from fieldgrid.live.pose.sensor_rows import rows_of
from tests.live.making import Told
from tests.live.test_poser import DATUM, RIG, SETTINGS, at_ns, fix, frame


@pytest.mark.parametrize("sway_deg", [0.3, 40.0])
def test_only_orientations_that_the_drive_does_not_deny_make_grids_level(sway_deg: float) -> None:
    """The antenna, a metre up, does not sway."""
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), Told())
    for k in range(101):
        seconds = 0.2 * k
        poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        roll_deg = sway_deg * math.sin(0.6 * seconds)
        stated = rows_of("orientation", at_ns(seconds), roll_deg, 0.0, 0.5, 0.0)
        poser.put(("orientation", stated))
        poser.put(frame(seconds, 0.2))
    poser.close()
    tilt = poser.tilt.at(at_ns(19.0))
    assert (tilt is None) is (sway_deg > 1.0)
