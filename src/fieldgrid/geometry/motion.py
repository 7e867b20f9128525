"""How the vehicle moved, by what it carries: gyro, wheels, camera. No positions on the globe."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float32, Float64, Int64


class Gyro(NamedTuple):
    """Rate of turn of the vehicle, length n, in order of time.

    `rate_rad_s` is clockwise seen from above, so that it integrates to the heading: minus the
    z axis of a gyro whose frame is forward, left, up.
    """

    time_ns: Int64
    rate_rad_s: Float64


class Inertial(NamedTuple):
    """An IMU with all its axes, length n, in order of time, in the vehicle's axes: x right,
    y forward, z up.

    `rate_rad_s` [n, 3] is the rate of turn about them, right-handed; `force_mps2` [n, 3] the
    specific force, which at rest on level ground is (0, 0, 9.8): NaN without an accelerometer.
    """

    time_ns: Int64
    rate_rad_s: Float32
    force_mps2: Float32

    def feels_force(self) -> bool:
        """Whether an accelerometer measured over most of what was logged."""
        felt = np.isfinite(self.force_mps2).all(axis=1)
        return int(felt.sum()) * 2 > len(self.time_ns)


class RecordedTilt(NamedTuple):
    """Roll and pitch that a recording states, length n, in order of time, with 1-sigma errors.

    Pitch is positive with the nose up, roll with the right side down.
    """

    time_ns: Int64
    roll_deg: Float64
    pitch_deg: Float64
    sigma_deg: Float64


class Orientation(NamedTuple):
    """Roll and pitch by what is not calibrated to its vehicle, an IMU's own estimate or odometry,
    length n, in order of time.

    As in :class:`RecordedTilt`, but in the vehicle's axes they may be off by the same all the time.
    `sigma_deg` is the rest of the error, `frame_sigma_deg` by how much the frame that they were
    measured in may lean.
    """

    time_ns: Int64
    roll_deg: Float64
    pitch_deg: Float64
    sigma_deg: Float64
    frame_sigma_deg: Float64


class WheelSpeed(NamedTuple):
    """Speed over ground from wheels or transmission, length n, negative in reverse."""

    time_ns: Int64
    speed_mps: Float64


class Steps(NamedTuple):
    """Relative motion of the grid origin between pairs of instants, length n, in order of time.

    The displacement is given in the vehicle frame at the start of the step; the turn is that of
    the heading, clockwise. `sigma_m` is the 1-sigma error of the displacement along one axis,
    `sigma_deg` that of the turn. `roll_deg` and `pitch_deg` are those of the vehicle at the stop
    against its own axes at the start, `tilt_sigma_deg` their error; they and `up_m` are NaN where
    a step does not tell them.
    """

    start_ns: Int64
    stop_ns: Int64
    forward_m: Float64
    right_m: Float64
    turn_deg: Float64
    sigma_m: Float64
    sigma_deg: Float64
    up_m: Float64
    roll_deg: Float64
    pitch_deg: Float64
    tilt_sigma_deg: Float64


class GivenPoses(NamedTuple):
    """Poses that another program estimated, length n, in order of time, in a frame of its own
    whose z axis is up.

    `x_m`, `y_m`, `z_m` are those of the sensor; of a drive without a rig, of the antenna.
    `heading_deg` is where the vehicle's nose points, clockwise from the y axis. Pitch is positive
    with the nose up, roll with the right side down; both are 0 where the poses are level ones.
    `sigma_m` and `sigma_deg` are the 1-sigma errors of the place along one horizontal axis and of
    the heading that the program states, NaN where it states none.
    """

    time_ns: Int64
    x_m: Float64
    y_m: Float64
    z_m: Float64
    heading_deg: Float64
    roll_deg: Float64
    pitch_deg: Float64
    sigma_m: Float64
    sigma_deg: Float64


class Motion(NamedTuple):
    """Everything a drive knows of its own motion; None for what it does not carry."""

    gyro: Gyro | None = None
    wheels: WheelSpeed | None = None
    steps: Steps | None = None
    inertial: Inertial | None = None
    tilt: RecordedTilt | None = None
    poses: GivenPoses | None = None
    orientation: Orientation | None = None

    def between(self, from_ns: int, until_ns: int) -> Motion:
        """What was measured from one time to before another."""
        parts: dict[str, Any] = {}
        for name, series in self._asdict().items():
            if series is None:
                continue
            inside = (series[0] >= from_ns) & (series[0] < until_ns)
            if isinstance(series, Steps):
                inside &= series.stop_ns < until_ns
            if inside.any():
                parts[name] = type(series)._make(column[inside] for column in series)
        return Motion(**parts)
