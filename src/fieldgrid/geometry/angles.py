"""Headings and yaws: the one place where an angle changes its convention.

A *heading* is in degrees, 0 = true north, clockwise positive, in (-180, 180]; it says where
the vehicle's nose points. A *course* has the same convention and says where it moves. A
*yaw* (ROS, KITTI) is in radians, 0 = east, counter-clockwise. `docs/conventions.md` has the
figure.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float64


def wrap_deg(angle_deg: npt.ArrayLike) -> Float64:
    """Angles in degrees, any shape, brought into (-180, 180]."""
    angle = np.asarray(angle_deg, dtype=np.float64)
    # The rest is in [0, 360), but rounding can make it 360, and -180 is not in the range.
    wrapped = 180.0 - (180.0 - angle) % 360.0
    return np.where(wrapped <= -180.0, 180.0, wrapped)


def heading_deg(d_east_m: npt.ArrayLike, d_north_m: npt.ArrayLike) -> Float64:
    """Heading of a displacement (metres east, metres north): atan2(dE, dN), degrees."""
    return wrap_deg(np.degrees(np.arctan2(d_east_m, d_north_m)))


def heading_from_yaw_rad(yaw_rad: npt.ArrayLike) -> Float64:
    """Heading in degrees of an ENU yaw in radians (0 = east, counter-clockwise)."""
    return wrap_deg(90.0 - np.degrees(np.asarray(yaw_rad, dtype=np.float64)))


def yaw_from_heading_rad(heading_deg: npt.ArrayLike) -> Float64:
    """ENU yaw in radians, in (-pi, pi], of a heading in degrees."""
    return np.radians(wrap_deg(90.0 - np.asarray(heading_deg, dtype=np.float64)))


def interpolate_deg(start_deg: float, end_deg: float, fraction: float) -> float:
    """The heading at `fraction` of the shorter way from `start_deg` to `end_deg`."""
    return float(wrap_deg(start_deg + fraction * float(wrap_deg(end_deg - start_deg))))
