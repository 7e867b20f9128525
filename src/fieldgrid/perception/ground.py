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

from fieldgrid.core import Float64, Int32, kernel
from fieldgrid.geometry import Mount, R_level_vehicle, Rig, Tilt, narrowing, robust_plane
from fieldgrid.perception.cloud import Cloud
from fieldgrid.perception.depth import CodedDepth, rays
from fieldgrid.perception.edges import STEEPEST, Edges, find_edges

PATCH_M = 0.5
"""Side of the square patches on which the ground is estimated."""

SAMPLE_STEP_PX = 4
"""Every fourth pixel of every fourth row is enough for the ground; of a cloud, which is sparse
where it is far, every point is taken."""

BIN_M, BINS = 0.025, 80
"""Heights are collected in 80 bins of 2.5 cm, from 1 m below to 1 m above the reference."""

DEEP_M, DEEP_SHARE = 5.0, 0.5
"""A patch has fallen away where more than this share of its points are lower than the bins, down to
so far below the reference."""

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

BANK_M = 0.1
"""The vehicle is taken to stand on a bank where the nearest ground is within this of its level."""

DROP_M, WIDEST_DITCH = 0.15, 4
"""Ground that falls more than this from one patch to the next may rise again as much behind a ditch
of at most this number of patches: a slope of 15° falls 0.13 m."""

STANDING_M, STANDING_SHARE, NEAR = 0.10, 0.05, 2
"""A patch with more than this share of its points so far above all ground of the patches up to the
second beside it has something standing on it, and its low height may not be ground: no step is told
from it."""


class GroundPlane(NamedTuple):
    """The ground plane of one frame, and the axes of its grid.

    Where the vehicle's tilt is known, a grid's columns are vertical and its x and y are level; else
    they are square to the plane. `A_grid_sensor` [3, 3] carries the sensor's axes to x right,
    y forward and the height above the plane along a column, in which the sensor itself is at
    `height_m`: a rotation in the one case, sheared along the columns in the other.

    `pitch_deg` and `roll_deg` are the plane's against the mount; `refined` is False where the mount
    was kept. `tilt` is the vehicle's against the grid's axes, and `rise` the plane's, metres per
    metre right and forward.
    """

    A_grid_sensor: Float64
    height_m: float
    pitch_deg: float
    roll_deg: float
    refined: bool
    tilt: Tilt
    rise: tuple[float, float]


def estimate_ground(
    seen: CodedDepth | Cloud,
    rig: Rig,
    half_width_m: float,
    length_m: float,
    tilt: Tilt | None = None,
    drop_range_m: float = math.inf,
) -> tuple[GroundPlane, Float64, Edges]:
    """The plane of a frame, the ground's height above it on patches [ny, nx], metres, and the edges
    in it.

    Patch (0, 0) starts at x = -half_width_m, y = 0. What was `seen` is an image of depths, or
    points in the sensor's frame. `tilt` is the vehicle's against gravity, where it is known.
    Drops are looked for up to `drop_range_m`.
    """
    nx, ny = math.ceil(2.0 * half_width_m / PATCH_M), math.ceil(length_m / PATCH_M)

    def heights_above(A_grid_sensor: Float64, height_m: float) -> Int32:
        counts: Int32 = np.zeros((ny, nx, BINS + 1), dtype=np.int32)
        if isinstance(seen, CodedDepth):
            geometry = rays(rig, A_grid_sensor, height_m)
            collect_heights(*seen, *geometry, half_width_m, counts)
        else:
            A_grid = A_grid_sensor.astype(np.float32)
            collect_point_heights(seen, A_grid, height_m, half_width_m, counts)
        return counts

    plane = _of_mount(rig.mount, tilt)
    low = low_heights(heights_above(plane.A_grid_sensor, plane.height_m)[..., :BINS])
    c, patches = _plane_of_patches(low, half_width_m)
    if patches >= MIN_PATCHES:
        plane = _along_columns(plane, c) if tilt is not None else _levelled(rig.mount, c)
    counts = heights_above(plane.A_grid_sensor, plane.height_m)
    deep, counts = counts[..., BINS], counts[..., :BINS]
    low = low_heights(counts)
    ground = follow_ground(low, _under_vehicle(low, plane.height_m - rig.mount.height_m))
    j, i = np.indices(low.shape) + 0.5
    range_m = np.hypot(PATCH_M * i - half_width_m, PATCH_M * j)
    height = ground_heights(low, ground, counts, deep)
    steep = plane.height_m > STEEPEST * range_m
    return plane, ground, find_edges(height, range_m <= drop_range_m, steep)


def _under_vehicle(low: Float64, start_m: float) -> float:
    """Where the ground begins, above the plane: at 0, or at `start_m`, where the vehicle stands, if
    that is more than a step higher and the nearest ground is there: on a bank, whose plane is that
    of the land below."""
    known = ~np.isnan(low)
    if start_m <= STEP_UP_M or not known.any():
        return 0.0
    first = int(known.any(axis=1).argmax())
    nearest = low[first : first + 2]
    return start_m if np.nanmedian(np.abs(nearest - start_m)) < BANK_M else 0.0


def _plane_of_patches(low: Float64, half_width_m: float) -> tuple[Float64, int]:
    """(c0, c1, c2) of the plane z = c0 + c1·x + c2·y through the low heights of patches [ny, nx],
    NaN where there is none, and how many of them agree; the mount is a prior measurement."""
    j, i = np.nonzero(~np.isnan(low))
    x: Float64 = (i.astype(np.float64) + 0.5) * PATCH_M - half_width_m
    y: Float64 = (j.astype(np.float64) + 0.5) * PATCH_M
    sigma: Float64 = 0.03 + 0.0004 * y * y

    def cutoff(round_: int, _: Float64) -> Float64 | float:
        return narrowing(round_, sigma, first=0.15 + 0.06 * y)

    return robust_plane(x, y, low[j, i], sigma, cutoff, prior_sigma=MOUNT_SIGMA)


def _of_mount(mount: Mount, tilt: Tilt | None) -> GroundPlane:
    """The plane that the vehicle stands on, which is what the mount tells of the ground ahead."""
    height_m, R_mount = mount.height_m, mount.rotation()
    if tilt is None:
        return GroundPlane(R_mount, height_m, 0.0, 0.0, False, Tilt(0.0, 0.0), (0.0, 0.0))
    R_level = R_level_vehicle(tilt.roll_deg, tilt.pitch_deg)
    right, ahead, up = R_level[:, 2]  # the plane's normal, in level axes
    rise = (-float(right / up), -float(ahead / up))
    A = R_level @ R_mount
    A[2] -= rise[0] * A[0] + rise[1] * A[1]
    return GroundPlane(A, height_m / float(up), 0.0, 0.0, False, tilt, rise)


def _along_columns(plane: GroundPlane, c: Float64) -> GroundPlane:
    """The plane raised by c0 + c1·x + c2·y along the columns of its grid, which stay vertical."""
    A = plane.A_grid_sensor.copy()
    A[2] -= c[1] * A[0] + c[2] * A[1]
    return GroundPlane(
        A,
        plane.height_m - float(c[0]),
        math.degrees(math.atan(c[2])),
        math.degrees(math.atan(c[1])),
        True,
        plane.tilt,
        (plane.rise[0] + float(c[1]), plane.rise[1] + float(c[2])),
    )


def _levelled(mount: Mount, c: Float64) -> GroundPlane:
    """The mount turned so that the plane z = c0 + c1·x + c2·y is level, its heading kept."""
    norm = math.sqrt(1.0 + c[1] * c[1] + c[2] * c[2])
    # The plane's normal is the vertical of the grid, as the vehicle sees it.
    tilt = Tilt(
        math.degrees(math.atan(float(c[1]))),
        math.degrees(math.atan2(-float(c[2]), math.hypot(1.0, float(c[1])))),
    )
    return GroundPlane(
        R_level_vehicle(tilt.roll_deg, tilt.pitch_deg) @ mount.rotation(),
        (mount.height_m - float(c[0])) / norm,
        math.degrees(math.atan(c[2])),
        math.degrees(math.atan(c[1])),
        True,
        tilt,
        (0.0, 0.0),
    )


@kernel
def collect_heights(disparity, row_start, depth_m, ray, du, dv, offset_m, half_width_m, counts):  # type: ignore[no-untyped-def]
    """Add to a histogram of heights per patch, int32 [ny, nx, BINS + 1], those of every fourth
    pixel; the last bin has those below all others, down to `DEEP_M`."""
    ny, nx, _ = counts.shape
    per_patch, per_bin = np.float32(1.0 / PATCH_M), np.float32(1.0 / BIN_M)
    deepest = np.float32(BINS / 2 - DEEP_M / BIN_M)
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
                if x >= 0.0 and y >= 0.0 and z > deepest and x < nx and y < ny and z < BINS:
                    counts[int(y), int(x), int(z) if z >= 0.0 else BINS] += 1


@kernel
def collect_point_heights(points, R_level_sensor, height_m, half_width_m, counts):  # type: ignore[no-untyped-def]
    """Collect the heights of all points float32 [n, 3] in the sensor's frame."""
    ny, nx, _ = counts.shape
    per_patch, per_bin = np.float32(1.0 / PATCH_M), np.float32(1.0 / BIN_M)
    deepest = np.float32(BINS / 2 - DEEP_M / BIN_M)
    x0, middle, up = np.float32(half_width_m), np.float32(BINS / 2), np.float32(height_m)
    R = R_level_sensor
    for k in range(points.shape[0]):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        x = (R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + x0) * per_patch
        y = (R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz) * per_patch
        z = (R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + up) * per_bin + middle
        if x >= 0.0 and y >= 0.0 and z > deepest and x < nx and y < ny and z < BINS:
            counts[int(y), int(x), int(z) if z >= 0.0 else BINS] += 1


def low_heights(counts: Int32) -> Float64:
    """Height in metres below which `LOW_SHARE` of each patch's points lie, NaN for too few.

    `counts` [ny, nx, BINS] are histograms of heights; within a bin points are spread evenly.
    """
    total = counts.sum(axis=2)
    known = total >= MIN_SAMPLES
    counts, target = counts[known], LOW_SHARE * total[known]
    up_to = np.cumsum(counts, axis=1)
    patch, in_bin = np.arange(len(counts)), (up_to >= target[:, None]).argmax(axis=1)
    points = counts[patch, in_bin]
    share = (target - (up_to[patch, in_bin] - points)) / points
    low: Float64 = np.full(total.shape, np.nan)
    low[known] = (in_bin + share - BINS / 2) * BIN_M
    return low


@kernel
def follow_ground(low, start):  # type: ignore[no-untyped-def]
    """Local height of the ground on patches [ny, nx], metres above the plane, on which it begins at
    `start`.

    From the vehicle outward, row by row and from the middle to the sides, each patch's low
    height is taken as ground if it is within a step of what its inner neighbours predict, or,
    behind a drop, if it is back on the level before it: the far side of a ditch. Otherwise (canopy,
    car, nothing seen) the prediction stands. Then one light smoothing.
    """
    ny, nx = low.shape
    ground, trust, smooth = np.empty((ny, nx)), np.empty((ny, nx)), np.empty((ny, nx))
    rim, age = np.empty((ny, nx)), np.empty((ny, nx))
    for j in range(ny):
        for i in range(nx):
            ground[j, i], trust[j, i], rim[j, i], age[j, i] = 0.0, 0.0, np.nan, 0.0
    for j in range(ny):
        for k in range(nx):
            # Middle, then alternately one further left and right.
            i = nx // 2 + ((k + 1) // 2) * (1 - 2 * (k % 2))
            if i < 0 or i >= nx:
                i = nx - 1 - i
            total, predicted = 0.02, 0.02 * start
            for dj, di in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1)):
                jj, ii = j + dj, i + di
                if jj >= 0 and ii >= 0 and ii < nx:
                    total += trust[jj, ii]
                    predicted += trust[jj, ii] * ground[jj, ii]
            predicted /= total
            # The level before a drop, of the nearest inner neighbour that knows of one.
            inward = i - 1 if i > nx // 2 else i + 1
            for jj, ii in ((j, inward), (j - 1, i)):
                inside = jj >= 0 and ii >= 0 and ii < nx
                if inside and age[jj, ii] < WIDEST_DITCH and not np.isnan(rim[jj, ii]):
                    rim[j, i], age[j, i] = rim[jj, ii], age[jj, ii] + 1
            step = low[j, i] - predicted
            if step < STEP_UP_M and step > -STEP_DOWN_M:  # never, when it is NaN
                ground[j, i], trust[j, i] = low[j, i], 1.0
                if step < -DROP_M and np.isnan(rim[j, i]):
                    rim[j, i] = predicted
            elif abs(low[j, i] - rim[j, i]) < DROP_M:
                ground[j, i], trust[j, i], rim[j, i] = low[j, i], 1.0, np.nan
            else:
                ground[j, i], trust[j, i] = predicted, 0.3 * min(total / 3.0, 1.0)
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


def ground_heights(low: Float64, ground: Float64, counts: Int32, deep: Int32) -> Float64:
    """The heights of patches [ny, nx] on which the ground is known and nothing stands, else NaN.

    `low` heights well above the followed `ground`, and patches on which something stands by their
    `counts` of heights, are no ground. Those below it are: the floor of a ditch. Where most points
    are `deep` [ny, nx] below all that is counted, the ground is at least that low.
    """
    found = low - ground < STEP_UP_M
    level = np.pad(np.where(found, np.maximum(low, ground), ground), NEAR, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(level, (2 * NEAR + 1, 2 * NEAR + 1))
    top = near.max(axis=(2, 3))[..., None] + STANDING_M
    above = (np.arange(BINS) - BINS / 2) * BIN_M > top
    total = counts.sum(axis=2)
    standing = (counts * above).sum(axis=2) > STANDING_SHARE * total
    height = np.where(found & ~standing, low, np.nan)
    height[(deep >= MIN_SAMPLES) & (deep > DEEP_SHARE * (total + deep))] = -BIN_M * BINS / 2
    return height
