"""Whether the IMU is turned about the vertical against what is declared, as the camera has it.

Over the same ground both roll and pitch. An IMU that is mounted sideways takes the one for the
other: its turns are right, so that no heading shows it, and the vehicle leans the wrong way.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Inertial, Steps

FEWEST_STEPS = 15
STRAIGHT_DEG = 10.0
"""In a step that turns by more, roll and pitch of its two ends are of other axes."""

LEAST_COHERENCE = 0.8
"""Camera and gyro must tell the same rolling and pitching, whichever way it is turned."""

LEAST_DEG, CLEAR_SIGMAS = 5.0, 4.0
"""A smaller turn makes a tenth of a roll out of a pitch at most."""


class ImuTurn(NamedTuple):
    """How far to the left of what is declared the IMU is turned, `off_deg` ± `sigma_deg`, by
    `steps` motions of the camera."""

    off_deg: float
    sigma_deg: float
    steps: int

    @property
    def is_off(self) -> bool:
        """Whether it is certainly turned, and by enough to matter."""
        return abs(self.off_deg) > max(LEAST_DEG, CLEAR_SIGMAS * self.sigma_deg)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**self._asdict(), "is_off": self.is_off}


def imu_turn(steps: Steps | None, sensed: Inertial | None) -> ImuTurn | None:
    """The turn of the IMU; None where camera or IMU tell too little of roll and pitch."""
    if steps is None or sensed is None or len(sensed.time_ns) < 2:
        return None
    start_ns, stop_ns = steps.start_ns, steps.stop_ns
    told = np.isfinite(steps.roll_deg) & (np.abs(steps.turn_deg) < STRAIGHT_DEG)
    told &= (start_ns >= sensed.time_ns[0]) & (stop_ns <= sensed.time_ns[-1])
    if np.count_nonzero(told) < FEWEST_STEPS:
        return None
    # About the right axis plus i times about the forward one: a turn to the left is a phase.
    seen = steps.pitch_deg[told] + 1j * steps.roll_deg[told]
    time_s = (sensed.time_ns - sensed.time_ns[0]) / 1e9
    rate = np.nan_to_num(sensed.rate_rad_s[:, :2].astype(np.float64))
    rate = np.degrees(rate - np.median(rate, axis=0))
    mean: Float64 = (rate[1:] + rate[:-1]) / 2.0 * np.diff(time_s)[:, None]
    turned = np.concatenate([[[0.0, 0.0]], np.cumsum(mean, axis=0)])
    right, forward = (
        np.diff(
            [
                np.interp((at - sensed.time_ns[0]) / 1e9, time_s, axis)
                for at in (start_ns[told], stop_ns[told])
            ],
            axis=0,
        )[0]
        for axis in turned.T
    )
    felt = np.asarray(right + 1j * forward, dtype=np.complex128)
    power, both = float(np.sum(np.abs(felt) ** 2)), complex(np.sum(seen * np.conj(felt)))
    if abs(both) < LEAST_COHERENCE * math.sqrt(power * float(np.sum(np.abs(seen) ** 2))):
        return None
    turn_rad = math.atan2(both.imag, both.real)
    left = np.abs(seen * np.exp(-1j * turn_rad) - felt) ** 2
    sigma_rad = math.sqrt(float(left.sum()) / (2.0 * power))
    return ImuTurn(
        math.degrees(turn_rad), math.degrees(sigma_rad) / math.sqrt(len(left)), len(left)
    )
