"""The ground under a frame: its plane, refined against the mount, and its local height.

A tilt error is a height error (1° is 26 cm at 15 m), so the plane is fitted per frame. One
plane is not enough either: a verge 25 cm above the road would become an obstacle. So the
ground is followed outward from the vehicle, patch by patch, and the slice of the local grid
is taken above that.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int32
from fieldgrid.cloud import Cloud, level_points
from fieldgrid.depth import CodedDepth, rays
from fieldgrid.kernel import kernel
from fieldgrid.rig import Rig

PATCH_M = 0.5
"""Side of the square patches on which the ground is estimated."""

SAMPLE_STEP_PX = 4
"""Every fourth pixel of every fourth row is enough for the ground; of a cloud, which is sparse
where it is far, every point is taken."""

BIN_M, BINS = 0.025, 80
"""Heights are collected in 80 bins of 2.5 cm, from 1 m below to 1 m above the reference."""

MIN_SAMPLES = 6
LOW_SHARE = 0.25
"""The ground of a patch is where the lowest quarter of its points ends: vegetation is above."""

MIN_PATCHES = 12
"""A plane from fewer ground patches than this is no better than the mount."""

MOUNT_SIGMA = (0.08, math.radians(2.5), math.radians(2.5))
"""How far height (m), roll and pitch (rad) may be off the mount before the data must insist."""

STEP_UP_M, STEP_DOWN_M = 0.20, 0.35
"""Ground may rise or fall this much from one patch to the next: kerbs and banks pass, rocks,
canopies and cars do not."""


class GroundPlane(NamedTuple):
    """The ground plane of one frame and what it corrects.

    `R_level_camera` turns the sensor's axes into the frame that is level with the
    ground; `height_m` is the sensor's height above it. `refined` is False where the mount was kept.
    """

    R_level_camera: Float64
    height_m: float
    pitch_deg: float
    roll_deg: float
    refined: bool


def estimate_ground(
    seen: CodedDepth | Cloud, rig: Rig, half_width_m: float, length_m: float
) -> tuple[GroundPlane, Float64]:
    """The plane of a frame, and the ground's height above it on patches [ny, nx], metres.

    Patch (0, 0) starts at x = -half_width_m, y = 0. What was `seen` is an image of depths, or
    points in the sensor's frame.
    """
    nx, ny = math.ceil(2.0 * half_width_m / PATCH_M), math.ceil(length_m / PATCH_M)

    def heights(R_level_sensor: Float64, height_m: float) -> Int32:
        found: Int32
        if isinstance(seen, CodedDepth):
            found = collect_heights(
                *seen, *rays(rig, R_level_sensor, height_m), half_width_m, nx, ny
            )
        else:
            level_m = level_points(seen, R_level_sensor, height_m)
            found = collect_point_heights(level_m, half_width_m, nx, ny)
        return found

    R_mount, mounted_m = rig.mount.rotation(), rig.mount.height_m
    low = low_heights(heights(R_mount, mounted_m))
    c, patches = fit_plane(low, half_width_m, np.array(MOUNT_SIGMA))
    plane = _levelled(R_mount, mounted_m, c, patches >= MIN_PATCHES)
    return plane, follow_ground(low_heights(heights(plane.R_level_camera, plane.height_m)))


def _levelled(R_mount: Float64, height_m: float, c: Float64, trusted: bool) -> GroundPlane:
    """The mount turned by the least rotation that levels the plane z = c0 + c1·x + c2·y."""
    if not trusted:
        return GroundPlane(R_mount, height_m, 0.0, 0.0, False)
    norm = math.sqrt(1.0 + c[1] * c[1] + c[2] * c[2])
    normal = np.array([-c[1], -c[2], 1.0]) / norm
    # Rodrigues' formula for the rotation that takes `normal` to the vertical.
    axis = np.cross(normal, [0.0, 0.0, 1.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R_level_mount = np.eye(3) + cross + cross @ cross / (1.0 + normal[2])
    return GroundPlane(
        R_level_mount @ R_mount,
        (height_m - float(c[0])) / norm,
        math.degrees(math.atan(c[2])),
        math.degrees(math.atan(c[1])),
        True,
    )


@kernel
def collect_heights(disparity, row_start, depth_m, ray, du, dv, offset_m, half_width_m, nx, ny):  # type: ignore[no-untyped-def]
    """Histogram of heights per patch, int32 [ny, nx, BINS], of every fourth pixel."""
    counts = np.zeros((ny, nx, BINS), dtype=np.int32)
    per_patch, per_bin = np.float32(1.0 / PATCH_M), np.float32(1.0 / BIN_M)
    x0, middle = offset_m[0] + np.float32(half_width_m), np.float32(BINS / 2)
    for row in range(0, disparity.shape[0], SAMPLE_STEP_PX):
        v = np.float32(row + row_start)
        rx, ry, rz = ray[0] + v * dv[0], ray[1] + v * dv[1], ray[2] + v * dv[2]
        for u in range(0, disparity.shape[1], SAMPLE_STEP_PX):
            d = disparity[row, u]
            if d > 0:
                depth, uf = depth_m[d], np.float32(u)
                x = (depth * (rx + uf * du[0]) + x0) * per_patch
                y = (depth * (ry + uf * du[1]) + offset_m[1]) * per_patch
                z = (depth * (rz + uf * du[2]) + offset_m[2]) * per_bin + middle
                if x >= 0.0 and y >= 0.0 and z >= 0.0 and x < nx and y < ny and z < BINS:
                    counts[int(y), int(x), int(z)] += 1
    return counts


@kernel
def collect_point_heights(level_m, half_width_m, nx, ny):  # type: ignore[no-untyped-def]
    """The same of points of the level frame, float32 [n, 3]."""
    counts = np.zeros((ny, nx, BINS), dtype=np.int32)
    per_patch, per_bin = np.float32(1.0 / PATCH_M), np.float32(1.0 / BIN_M)
    x0, middle = np.float32(half_width_m), np.float32(BINS / 2)
    for k in range(level_m.shape[0]):
        x, y = (level_m[k, 0] + x0) * per_patch, level_m[k, 1] * per_patch
        z = level_m[k, 2] * per_bin + middle
        if x >= 0.0 and y >= 0.0 and z >= 0.0 and x < nx and y < ny and z < BINS:
            counts[int(y), int(x), int(z)] += 1
    return counts


@kernel
def low_heights(counts):  # type: ignore[no-untyped-def]
    """Height in metres below which `LOW_SHARE` of each patch's points lie, NaN for too few."""
    ny, nx = counts.shape[0], counts.shape[1]
    low = np.full((ny, nx), np.nan)
    for j in range(ny):
        for i in range(nx):
            total = counts[j, i].sum()
            if total < MIN_SAMPLES:
                continue
            target, below, k = LOW_SHARE * total, 0, 0
            while below + counts[j, i, k] < target:
                below += counts[j, i, k]
                k += 1
            low[j, i] = (k + (target - below) / counts[j, i, k] - BINS / 2) * BIN_M
    return low


@kernel
def fit_plane(low, half_width_m, mount_sigma):  # type: ignore[no-untyped-def]
    """Robust plane z = c0 + c1·x + c2·y through the low heights, and how many patches agree.

    Tukey's weights, narrowing over eight rounds; the mount is a prior observation.
    """
    ny, nx = low.shape
    c = np.zeros(3)
    agreeing = 0
    for round_ in range(8):
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for k in range(3):
            normal[k, k] = 1.0 / mount_sigma[k] ** 2
        agreeing = 0
        for j in range(ny):
            for i in range(nx):
                if np.isnan(low[j, i]):
                    continue
                x, y = (i + 0.5) * PATCH_M - half_width_m, (j + 0.5) * PATCH_M
                sigma = 0.03 + 0.0004 * y * y
                cutoff = (0.15 + 0.06 * y) if round_ == 0 else max(6.0 - round_, 2.5) * sigma
                share = (low[j, i] - (c[0] + c[1] * x + c[2] * y)) / cutoff
                if abs(share) >= 1.0:
                    continue
                agreeing += 1
                weight = (1.0 - share * share) ** 2 / (sigma * sigma)
                row = (1.0, x, y)
                for a in range(3):
                    right[a] += weight * row[a] * low[j, i]
                    for b in range(3):
                        normal[a, b] += weight * row[a] * row[b]
        c = np.linalg.solve(normal, right).astype(np.float64)
    return c, agreeing


@kernel
def follow_ground(low):  # type: ignore[no-untyped-def]
    """Local height of the ground on patches [ny, nx], metres above the plane.

    From the vehicle outward, row by row and from the middle to the sides, each patch's low
    height is taken as ground if it is within a step of what its inner neighbours predict;
    otherwise (canopy, car, nothing seen) the prediction stands. Then one light smoothing.
    """
    ny, nx = low.shape
    ground, trust = np.zeros((ny, nx)), np.zeros((ny, nx))
    for j in range(ny):
        for k in range(nx):
            # Middle, then alternately one further left and right.
            i = nx // 2 + ((k + 1) // 2) * (1 - 2 * (k % 2))
            if i < 0 or i >= nx:
                i = nx - 1 - i
            total, predicted = 0.02, 0.0
            for dj, di in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1)):
                jj, ii = j + dj, i + di
                if jj >= 0 and ii >= 0 and ii < nx:
                    total += trust[jj, ii]
                    predicted += trust[jj, ii] * ground[jj, ii]
            predicted /= total
            step = low[j, i] - predicted
            if step < STEP_UP_M and step > -STEP_DOWN_M:  # never, when it is NaN
                ground[j, i], trust[j, i] = low[j, i], 1.0
            else:
                ground[j, i], trust[j, i] = predicted, 0.3 * min(total / 3.0, 1.0)
    smooth = np.zeros((ny, nx))
    for j in range(ny):
        for i in range(nx):
            total, value = 0.0, 0.0
            for jj in range(max(j - 1, 0), min(j + 2, ny)):
                for ii in range(max(i - 1, 0), min(i + 2, nx)):
                    w = (trust[jj, ii] + 1e-6) * (4.0 if (jj == j and ii == i) else 1.0)
                    total += w
                    value += w * ground[jj, ii]
            smooth[j, i] = value / total
    return smooth
