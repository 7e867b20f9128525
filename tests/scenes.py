"""Scenes and drives of which everything is known: disparities of planes and boxes, and paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import DepthCamera, LeverArm, Lidar, Mount, Rig, StereoCamera

_Float64 = npt.NDArray[np.float64]


def paper_rig(
    *,
    focal_px: float = 780.0,
    size_px: tuple[int, int] = (640, 480),
    height_m: float = 2.8,
    tilt_deg: float = 15.0,
    roll_deg: float = 0.0,
    yaw_deg: float = 0.0,
    antenna: LeverArm | None = None,
    rear_axle_forward_m: float | None = None,
) -> Rig:
    """A rig like the paper's: 20 cm of baseline, 2.8 m above ground, looking down."""
    width_px, height_px = size_px
    return Rig(
        StereoCamera(width_px, height_px, focal_px, width_px / 2.0, height_px / 2.0, 0.2),
        Mount(height_m, tilt_deg, roll_deg, yaw_deg),
        antenna or LeverArm(0.0, 0.0, 3.0),
        rear_axle_forward_m,
    )


class Ground(NamedTuple):
    """A strip of ground, z = height + slope_x·x + slope_y·y, from one x to another, and from one
    y to another (metres). Between strips of different heights there is no face."""

    height_m: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    x_from_m: float = -math.inf
    x_to_m: float = math.inf
    y_from_m: float = -math.inf
    y_to_m: float = math.inf


class Box(NamedTuple):
    """A box with sides along the axes of the vehicle, metres."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    z_m: tuple[float, float]


def render(
    rig: Rig,
    things: Sequence[Ground | Box],
    num_disparities: int,
    *,
    row_start: int = 0,
    mount: Mount | None = None,
) -> npt.NDArray[np.int16]:
    """Disparities in sixteenths of the rows from `row_start`, ray by ray; -16 where nothing is.

    The camera hangs as `mount` says, which may differ from the rig's own.
    """
    camera, mount = rig.camera, mount or rig.mount
    R = mount.rotation()
    left = R @ np.array([-camera.baseline_m / 2.0, 0.0, 0.0])
    left = left + np.array([0.0, 0.0, mount.height_m])
    rows, focal_px = range(row_start, camera.height_px), (camera.focal_px, camera.focal_px)
    in_camera = _pixels(rows, camera.width_px, focal_px, (camera.cx_px, camera.cy_px))
    depth_m = _nearest(left, np.tensordot(R, in_camera, axes=1), things)
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = camera.focal_px * camera.baseline_m / depth_m + camera.disparity_offset_px
    found = np.isfinite(depth_m) & (disparity > 0.0) & (disparity <= num_disparities - 1)
    return np.where(found, np.rint(disparity * 16.0), -16.0).astype(np.int16)


def depth_rig(
    focal_px: tuple[float, float] = (780.0, 780.0),
    size_px: tuple[int, int] = (640, 480),
    mount: Mount | None = None,
    baseline_m: float | None = None,
) -> Rig:
    """The paper's rig with a depth camera instead of the pair."""
    width_px, height_px = size_px
    camera = DepthCamera(
        width_px, height_px, *focal_px, width_px / 2.0, height_px / 2.0, baseline_m
    )
    return Rig(camera, mount or Mount(2.8, 15.0), LeverArm(0.0, 0.0, 3.0))


def lidar_rig(points_per_sr: float, mount: Mount | None = None) -> Rig:
    """The paper's rig with a lidar instead of the pair."""
    return Rig(Lidar(points_per_sr), mount or Mount(2.0, 0.0), LeverArm(0.0, 0.0, 3.0))


def depths(
    rig: Rig, things: Sequence[Ground | Box], mount: Mount | None = None
) -> npt.NDArray[np.float32]:
    """What a depth camera sees: metres along the optical axis, NaN where nothing is."""
    camera, mount = rig.sensor, mount or rig.mount
    assert isinstance(camera, DepthCamera)
    focal_px, centre_px = (camera.fx_px, camera.fy_px), (camera.cx_px, camera.cy_px)
    in_camera = _pixels(range(camera.height_px), camera.width_px, focal_px, centre_px)
    ray = np.tensordot(mount.rotation(), in_camera, axes=1)
    depth_m = _nearest(np.array([0.0, 0.0, mount.height_m]), ray, things)
    return np.where(np.isfinite(depth_m), depth_m, np.nan).astype(np.float32)


def sweep(
    mount: Mount,
    things: Sequence[Ground | Box],
    step_deg: float = 0.2,
    elevations_deg: tuple[float, float] = (-40.0, 15.0),
    azimuths_deg: tuple[float, float] = (-90.0, 90.0),
) -> npt.NDArray[np.float32]:
    """The points [n, 3] of a lidar with as many beams across as up, in its own frame."""
    up = np.radians(np.arange(*elevations_deg, step_deg))
    right = np.radians(np.arange(*azimuths_deg, step_deg))
    up, right = (angles.ravel() for angles in np.meshgrid(up, right))
    beams = np.stack([np.cos(up) * np.sin(right), -np.sin(up), np.cos(up) * np.cos(right)])
    range_m = _nearest(np.array([0.0, 0.0, mount.height_m]), mount.rotation() @ beams, things)
    hit = np.isfinite(range_m) & (range_m < 100.0)
    return np.ascontiguousarray((beams[:, hit] * range_m[hit]).T, dtype=np.float32)


def _pixels(
    rows: range, width_px: int, focal_px: tuple[float, float], centre_px: tuple[float, float]
) -> _Float64:
    """Directions [3, row, column] of pixels in the camera's frame, a metre along its axis."""
    v, u = np.mgrid[rows.start : rows.stop, 0:width_px].astype(np.float64)
    (fx, fy), (cx, cy) = focal_px, centre_px
    return np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)])


def _nearest(origin: _Float64, ray: _Float64, things: Sequence[Ground | Box]) -> _Float64:
    """How many rays it is to the first thing on the way, infinite where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.minimum.reduce([_hit(origin, ray, thing) for thing in things])


def _hit(left: _Float64, ray: _Float64, thing: Ground | Box) -> _Float64:
    """Depth at which each ray meets a thing, infinite where it does not."""
    if isinstance(thing, Ground):
        slopes = (thing.slope_x, thing.slope_y)
        above = left[2] - thing.height_m - slopes[0] * left[0] - slopes[1] * left[1]
        depth = above / (slopes[0] * ray[0] + slopes[1] * ray[1] - ray[2])
        x, y = left[0] + depth * ray[0], left[1] + depth * ray[1]
        inside = (x >= thing.x_from_m) & (x < thing.x_to_m)
        inside &= (y >= thing.y_from_m) & (y < thing.y_to_m)
        return np.where((depth > 0.0) & inside, depth, np.inf)
    enter, leave = np.full(ray.shape[1:], 0.0), np.full(ray.shape[1:], np.inf)
    for axis, (low, high) in enumerate((thing.x_m, thing.y_m, thing.z_m)):
        a, b = (low - left[axis]) / ray[axis], (high - left[axis]) / ray[axis]
        enter, leave = np.maximum(enter, np.minimum(a, b)), np.minimum(leave, np.maximum(a, b))
    return np.where((enter < leave) & (enter > 0.0), enter, np.inf)


class Leg(NamedTuple):
    """A stretch driven in one gear; a positive curvature turns right when driven forward."""

    length_m: float
    curvature_per_m: float = 0.0
    gear: int = 1


class Path(NamedTuple):
    """Where the axle that does not steer was, where the nose pointed, and the gear, by point."""

    east_m: _Float64
    north_m: _Float64
    heading_deg: _Float64
    gear: npt.NDArray[np.int64]

    def of(self, right_m: float, forward_m: float) -> tuple[_Float64, _Float64]:
        """East and north of another point of the vehicle, metres right and forward of it."""
        phi = np.radians(self.heading_deg)
        forward = np.stack([np.sin(phi), np.cos(phi)])
        right = np.stack([forward[1], -forward[0]])  # a quarter turn clockwise
        east, north = np.stack([self.east_m, self.north_m]) + right_m * right + forward_m * forward
        return east, north


def drive(
    legs: Sequence[Leg], heading_deg: float = 0.0, step_m: float = 0.3, east_m: float = 0.0
) -> Path:
    """The path along exact arcs, a point every `step_m`."""
    east, north, phi = [east_m], [0.0], [math.radians(heading_deg)]
    gears = [legs[0].gear]
    for leg in legs:
        for _ in range(round(leg.length_m / step_m)):
            turn = leg.gear * step_m * leg.curvature_per_m
            chord = leg.gear * step_m * (math.sin(turn / 2.0) / (turn / 2.0) if turn else 1.0)
            east.append(east[-1] + chord * math.sin(phi[-1] + turn / 2.0))
            north.append(north[-1] + chord * math.cos(phi[-1] + turn / 2.0))
            phi.append(phi[-1] + turn)
            gears.append(leg.gear)
    return Path(np.array(east), np.array(north), np.degrees(phi), np.array(gears))
