"""Roll and pitch over a drive, with their sigmas: what an estimate of the attitude gives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Finding, Float64, Int64
from fieldgrid.geometry import R_level_vehicle, Tilt
from fieldgrid.poses.attitude.axes import AxisTilt

TERRAIN_NOISE_RAD = np.radians([2.0, 2.0, 60.0])
"""How ground and steering turn a vehicle that nothing watches, rad/√s, about its axes."""


class Attitude(NamedTuple):
    """Roll and pitch at n instants in order of time, degrees, with 1-sigma errors.

    Pitch is positive with the nose up, roll with the right side down. `heading_deg` is that of the
    same estimate, without a jump at 360°, and `up_m` the height of the sensor, LTP metres.
    `push_misfit` is how many sigmas the accelerometer is from the motion of the fixes, root mean
    square; NaN without one. `bodies` are those of the recorded axes that were used, and `findings`
    name what contradicts the rest of the drive and was not. `gyro_bias_rad_s` [3] is that of the
    rates about the vehicle's axes at the end, None where they were not looked at.
    """

    time_ns: Int64
    roll_deg: Float64
    pitch_deg: Float64
    roll_sigma_deg: Float64
    pitch_sigma_deg: Float64
    heading_deg: Float64
    up_m: Float64
    push_misfit: float = math.nan
    findings: tuple[Finding, ...] = ()
    bodies: frozenset[str] = frozenset()
    gyro_bias_rad_s: Float64 | None = None

    def as_dict(self) -> dict[str, float]:
        """What a report says of it, degrees: the steepest and the median sigmas."""
        return {
            "steepest_roll_deg": float(np.abs(self.roll_deg).max()),
            "steepest_pitch_deg": float(np.abs(self.pitch_deg).max()),
            "roll_sigma_deg": float(np.median(self.roll_sigma_deg)),
            "pitch_sigma_deg": float(np.median(self.pitch_sigma_deg)),
        }

    def tilt_at(self, time_ns: int) -> Tilt:
        """Roll and pitch at one instant."""
        at = self.at(np.array([time_ns]))
        sigma_deg = float(max(at.roll_sigma_deg[0], at.pitch_sigma_deg[0]))
        return Tilt(float(at.roll_deg[0]), float(at.pitch_deg[0]), sigma_deg)

    def at(self, time_ns: Int64) -> Attitude:
        """At other instants: between nodes linear; beyond them that of the nearest node, and
        ever less sure."""
        columns = (np.interp(time_ns, self.time_ns, column) for column in self[1:7])
        roll, pitch, roll_sigma, pitch_sigma, heading, up = columns
        late_ns = np.maximum(self.time_ns[0] - time_ns, time_ns - self.time_ns[-1])
        late = np.degrees(TERRAIN_NOISE_RAD[0]) * np.sqrt(np.maximum(late_ns, 0) / 1e9)
        roll_sigma, pitch_sigma = np.hypot(roll_sigma, late), np.hypot(pitch_sigma, late)
        return Attitude(time_ns, roll, pitch, roll_sigma, pitch_sigma, heading, up, *self[7:])

    def if_late(self, late_s: float) -> Attitude:
        """The attitude by sensors whose stamps may be `late_s` late: as unsure as a vehicle leans
        otherwise after that time, root mean square."""
        time_s = (self.time_ns - self.time_ns[0]) / 1e9
        roll, pitch = (
            np.hypot(sigma, late_s * np.sqrt(np.mean(np.gradient(angle, time_s) ** 2)))
            for angle, sigma in (
                (self.roll_deg, self.roll_sigma_deg),
                (self.pitch_deg, self.pitch_sigma_deg),
            )
        )
        return self._replace(roll_sigma_deg=roll, pitch_sigma_deg=pitch)

    def rise_at(self, axis: AxisTilt) -> tuple[Float64, Float64]:
        """How much an axis of the vehicle rises at its own instants, with the sigma, degrees."""
        at = self.at(axis.time_ns)
        level = R_level_vehicle(at.roll_deg, at.pitch_deg)[:, 2] @ axis.direction
        right, forward, _ = np.abs(axis.direction)
        sigma = np.hypot(right * at.roll_sigma_deg, forward * at.pitch_sigma_deg)
        return np.degrees(np.arcsin(level)), sigma
