"""The turns of a camera beside those of a gyro: whether both have one clock."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Gyro, Steps

FEWEST_STEPS = 10

GYRO_TURN_SIGMA_DEG = 0.3
"""How far the turns of a gyro and of a camera differ when their clocks agree."""

CLEAR_SIGMAS, BETTER_SHARE = 5.0, 0.5
"""A step turns otherwise than the gyro beyond this number of sigmas; another clock is believed
where its misfit is less than this share."""

LEAST_TURNING_DEG, SLIPPED_SHARE = 90.0, 0.05
"""A gyro vouches for the images of a drive that turns by at least this in all, where no more than
this share of the steps turns otherwise."""


def goes_with(steps: Steps, gyro: Gyro, offset_s: float) -> bool:
    """Whether the camera's turns fit the gyro's clearly better as they are stamped than when they
    are moved by `offset_s`: then images and gyro have one clock, and the fixes another."""
    return _misfit(steps, gyro, 0.0) < BETTER_SHARE * _misfit(steps, gyro, offset_s)


def _misfit(steps: Steps, gyro: Gyro, shift_s: float) -> float:
    """How badly the turns fit with the steps moved; infinite with too few of them."""
    off_deg, _ = _turns_off(steps, gyro, shift_s)
    if len(off_deg) < FEWEST_STEPS:
        return math.inf
    return float(np.log1p((off_deg / GYRO_TURN_SIGMA_DEG) ** 2).mean())


def turns_with(steps: Steps, gyro: Gyro) -> bool:
    """Whether the camera turns as the gyro does in all but a few steps of a drive that turns: then
    the images are of the moments that they are stamped with."""
    off_deg, turn_deg = _turns_off(steps, gyro, 0.0)
    off = np.abs(off_deg) > CLEAR_SIGMAS * GYRO_TURN_SIGMA_DEG
    if len(off) < FEWEST_STEPS or np.abs(turn_deg).sum() < LEAST_TURNING_DEG:
        return False
    return int(np.count_nonzero(off)) <= SLIPPED_SHARE * len(off)


def _turns_off(steps: Steps, gyro: Gyro, shift_s: float) -> tuple[Float64, Float64]:
    """How much more the gyro turns than the camera in each step within its time, and by how much
    the gyro does, degrees; the steps are moved by `shift_s`."""
    time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
    mean = (gyro.rate_rad_s[1:] + gyro.rate_rad_s[:-1]) / 2.0
    turned = np.degrees(np.concatenate([[0.0], np.cumsum(mean * np.diff(time_s))]))
    start_s = (steps.start_ns - gyro.time_ns[0]) / 1e9 + shift_s
    stop_s = (steps.stop_ns - gyro.time_ns[0]) / 1e9 + shift_s
    inside = (start_s >= 0.0) & (stop_s <= time_s[-1])
    turn = np.interp(stop_s, time_s, turned) - np.interp(start_s, time_s, turned)
    return (turn - steps.turn_deg)[inside], turn[inside]
