"""Rotations of the vehicle: matrices [n, 3, 3], rotation vectors [n, 3], roll and pitch.

The vehicle's axes are x right, y forward, z up; the LTP's are east, north, up. *Pitch* is
positive with the nose up, *roll* with the right side down, both in degrees. A rotation vector
is the axis times the angle in radians, right-handed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float64


class Tilt(NamedTuple):
    """How a vehicle leans against the vertical, degrees: pitch with the nose up, roll with the
    right side down, and the 1-sigma error of the less certain one."""

    roll_deg: float
    pitch_deg: float
    sigma_deg: float = 0.0


def cross_matrices(vectors: Float64) -> Float64:
    """[v]x of vectors [..., 3], so that [v]x · w = v x w; [..., 3, 3]."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    out = np.zeros((*vectors.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def from_vectors(vectors: Float64) -> Float64:
    """exp([v]x) of rotation vectors [..., 3]: Rodrigues' formula; [..., 3, 3]."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = cross_matrices(vectors)
    # sinc(x) of NumPy is sin(pi x) / (pi x).
    first, half = np.sinc(angle / np.pi), np.sinc(angle / (2.0 * np.pi))
    rotation: Float64 = np.eye(3) + first * cross + 0.5 * half**2 * (cross @ cross)
    return rotation


def to_vectors(rotations: Float64) -> Float64:
    """Rotation vectors [..., 3] of rotations by less than 180°, [..., 3, 3]."""
    R = rotations
    doubled = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    sine = np.linalg.norm(doubled, axis=-1) / 2.0
    angle = np.arctan2(sine, (np.trace(R, axis1=-2, axis2=-1) - 1.0) / 2.0)
    stretch = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 1.0)
    vectors: Float64 = doubled / 2.0 * stretch[..., None]
    return vectors


def R_level_vehicle(roll_deg: npt.ArrayLike, pitch_deg: npt.ArrayLike) -> Float64:
    """From the vehicle's axes to level ones with the same heading: right, forward, up.

    First the roll about the forward axis, then the pitch about the level axis to the right.
    """
    roll, pitch = np.radians(roll_deg), np.radians(pitch_deg)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    zero = np.zeros_like(cr * cp)
    rows = (
        (cr + zero, zero, sr + zero),
        (sp * sr, cp + zero, -sp * cr),
        (-cp * sr, sp + zero, cp * cr),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def R_enu_level(heading_deg: npt.ArrayLike) -> Float64:
    """From level axes (right, forward, up) to east, north, up: Eq. 3 of the paper."""
    phi = np.radians(heading_deg)
    c, s, zero, one = np.cos(phi), np.sin(phi), np.zeros_like(phi), np.ones_like(phi)
    rows = (c, s, zero), (-s, c, zero), (zero, zero, one)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def roll_pitch_deg(R_enu_vehicle: Float64) -> tuple[Float64, Float64]:
    """Roll and pitch in degrees of the vehicle's axes [..., 3, 3] in any frame whose z is up."""
    up = R_enu_vehicle[..., 2, :]  # the vertical, seen from the vehicle
    roll = np.degrees(np.arctan2(-up[..., 0], up[..., 2]))
    pitch = np.degrees(np.arctan2(up[..., 1], np.hypot(up[..., 0], up[..., 2])))
    return roll, pitch


def heading_rad(R_enu_vehicle: Float64) -> Float64:
    """Heading of the forward axis, radians clockwise from north."""
    heading: Float64 = np.arctan2(R_enu_vehicle[..., 0, 1], R_enu_vehicle[..., 1, 1])
    return heading
