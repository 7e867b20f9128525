"""How the vehicle moved, by what it carries: gyro, wheels, camera. No positions."""

from __future__ import annotations

from typing import NamedTuple

from fieldgrid.array_types import Float64, Int64


class Gyro(NamedTuple):
    """Rate of turn of the vehicle, length n, in order of time.

    `rate_rad_s` is clockwise seen from above, so that it integrates to the heading: minus the
    z axis of a gyro whose frame is forward, left, up.
    """

    time_ns: Int64
    rate_rad_s: Float64


class WheelSpeed(NamedTuple):
    """Speed over ground from wheels or transmission, length n, negative in reverse."""

    time_ns: Int64
    speed_mps: Float64


class Steps(NamedTuple):
    """Relative motion of the grid origin between pairs of instants, length n, in order of time.

    The displacement is given in the vehicle frame at the start of the step; the turn is that of
    the heading, clockwise. `sigma_m` is the 1-sigma error of the displacement along one axis,
    `sigma_deg` that of the turn.
    """

    start_ns: Int64
    stop_ns: Int64
    forward_m: Float64
    right_m: Float64
    turn_deg: Float64
    sigma_m: Float64
    sigma_deg: Float64


class Motion(NamedTuple):
    """Everything a drive knows of its own motion; None for what it does not carry."""

    gyro: Gyro | None = None
    wheels: WheelSpeed | None = None
    steps: Steps | None = None
