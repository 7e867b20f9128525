"""A rectified pair becomes a vehicle-fixed local grid of 3D density.

The core step, in the paper's order: match, find the ground, carry each matched pixel into the
ground frame, keep the slice, count by cell, compensate for range, scale to 0-255. One compiled
kernel does the last five; `bin_pixels_reference` is what it is held to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.ground import (
    PATCH_M,
    GroundPlane,
    depth_table,
    estimate_ground,
    rays,
)
from fieldgrid.kernel import kernel
from fieldgrid.rig import Rig
from fieldgrid.stereo import SUBPIXELS, Disparity, StereoMatcher, StereoSettings, search_region

_Float32 = npt.NDArray[np.float32]


class DensitySettings(BaseModel):
    """What of the point cloud enters a local grid, and how counts become 3D density.

    3D density is the number of points in a cell's column of the slice per m³, compensated for
    range: d_c = d·(R/R0)^p. Times (R0/f)², the area that one pixel sees at R0, it is the
    facing surface in m² per m³, which does not depend on the camera; 255 stands for
    `saturation_m2_per_m3` of it, in every frame.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    slice_bottom_m: float = Field(default=0.2, ge=0.02, le=5.0)
    slice_top_m: float = Field(default=2.2, gt=0.05, le=20.0)
    max_range_m: float = Field(default=15.0, gt=1.0, le=200.0)
    max_range_sigma_m: float = Field(default=0.2, gt=0.01, le=10.0)
    range_exponent: float = Field(default=2.0, ge=0.0, le=4.0)
    reference_range_m: float = Field(default=8.0, gt=0.5, le=100.0)
    max_gain: float = Field(default=4.0, ge=1.0, le=100.0)
    min_points: int = Field(default=5, ge=1, le=1000)
    min_ground_points: int = Field(default=2, ge=1, le=1000)
    saturation_m2_per_m3: float = Field(default=0.2, gt=0.0, le=100.0)

    @model_validator(mode="after")
    def _slice_has_height(self) -> DensitySettings:
        if self.slice_top_m <= self.slice_bottom_m + 0.05:
            raise ValueError(
                f"the slice from {self.slice_bottom_m} to {self.slice_top_m} m has no height"
            )
        return self

    @property
    def slice_m(self) -> float:
        """Thickness of the slice, ΔZ = Z_max - Z_min."""
        return self.slice_top_m - self.slice_bottom_m


class FrameGround(NamedTuple):
    """What was found of the ground in one frame: for tables and for doubt."""

    camera_height_m: float
    pitch_deg: float
    roll_deg: float
    refined: bool


class LocalGridder:
    """Makes local grids for one rig and one set of settings; safe to call from threads."""

    def __init__(
        self,
        rig: Rig,
        spec: GridSpec | None = None,
        stereo: StereoSettings | None = None,
        density: DensitySettings | None = None,
    ):
        self.rig = rig
        self.spec = spec or GridSpec()
        self.stereo = stereo or StereoSettings()
        self.settings = density or DensitySettings()
        self.max_range_m = reliable_range_m(rig, self.spec, self.stereo, self.settings)
        self.region = search_region(rig, self.stereo, self.settings.slice_top_m, self.max_range_m)
        self.matcher = StereoMatcher(rig.camera, self.stereo, self.region)
        self._depth_m = depth_table(rig, self.region.num_disparities, SUBPIXELS)
        self._gain = density_gain(rig, self.spec, self.settings)

    def __call__(
        self, left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8]
    ) -> tuple[LocalGrid, FrameGround]:
        """The local grid of a rectified grey pair [height, width]."""
        return self.from_disparity(self.matcher.disparity(left, right))

    def from_disparity(self, disparity: Disparity) -> tuple[LocalGrid, FrameGround]:
        """The local grid of a disparity image."""
        spec, settings = self.spec, self.settings
        values, row_start = disparity
        plane, patches = estimate_ground(
            values, row_start, self._depth_m, self.rig, spec.width_m / 2.0, spec.length_m
        )
        if not plane.refined:
            # Heights above a ground that was not found are not known, so nothing is claimed.
            unseen = np.zeros(spec.shape, dtype=np.uint8)
            return LocalGrid(spec, unseen, unseen.astype(np.bool_)), _summary(plane)
        ground_m = local_ground(patches, spec.n_x, spec.n_y, spec.cell_m, self.max_range_m)
        counts = bin_pixels(
            values,
            row_start,
            self._depth_m,
            *rays(self.rig, plane.R_level_camera, plane.height_m),
            ground_m,
            spec.cell_m,
            np.float32(settings.slice_bottom_m),
            np.float32(settings.slice_top_m),
        )
        density, observed = scale_density(
            counts, self._gain, settings.min_points, settings.min_ground_points
        )
        return LocalGrid(spec, density, observed), _summary(plane)


def _summary(plane: GroundPlane) -> FrameGround:
    return FrameGround(plane.height_m, plane.pitch_deg, plane.roll_deg, plane.refined)


def reliable_range_m(
    rig: Rig, spec: GridSpec, stereo: StereoSettings, settings: DensitySettings
) -> float:
    """The range up to which points enter: by setting, by grid, and where sigma_R allows.

    sigma_R = R²·sigma_d/(f·b) reaches `max_range_sigma_m` at R = sqrt(sigma·f·b/sigma_d).
    """
    by_sigma_m = math.sqrt(
        settings.max_range_sigma_m * rig.camera.focal_baseline_px_m / stereo.disparity_sigma_px
    )
    return min(settings.max_range_m, spec.reach_m, by_sigma_m)


def density_gain(rig: Rig, spec: GridSpec, settings: DensitySettings) -> npt.NDArray[np.float32]:
    """What one point is worth in a cell, of 255, float32 [n_y, n_x]: all scaling in one table."""
    x, y = spec.centres_m()
    range_m = np.hypot(x[None, :], y[:, None])
    compensation = (range_m / settings.reference_range_m) ** settings.range_exponent
    compensation = np.minimum(compensation, settings.max_gain)
    column_m3 = spec.cell_m**2 * settings.slice_m
    pixel_m2 = (settings.reference_range_m / rig.camera.focal_px) ** 2
    worth = 255.0 * compensation * pixel_m2 / column_m3 / settings.saturation_m2_per_m3
    return worth.astype(np.float32)


@kernel
def local_ground(patches, n_x, n_y, cell_m, max_range_m):  # type: ignore[no-untyped-def]
    """Ground heights of patches [ny, nx], metres, bilinear to cells, float32 [n_y, n_x].

    NaN beyond `max_range_m`: no height compares with NaN, so no point enters there.
    """
    ny, nx = patches.shape
    out = np.full((n_y, n_x), np.float32(np.nan), dtype=np.float32)
    # Where each column lies between the patches, once for all rows.
    left, share = np.empty(n_x, dtype=np.int32), np.empty(n_x, dtype=np.float32)
    for c in range(n_x):
        u = min(max((c + 0.5) * cell_m / PATCH_M - 0.5, 0.0), nx - 1.0)
        left[c] = min(int(u), max(nx - 2, 0))
        share[c] = u - left[c] if nx > 1 else 0.0
    line = np.zeros(nx + 1, dtype=np.float32)
    for r in range(n_y):
        y = (r + 0.5) * cell_m
        if y > max_range_m:
            break
        v = min(max(y / PATCH_M - 0.5, 0.0), ny - 1.0)
        j = int(v)
        j1, fv = min(j + 1, ny - 1), v - j
        for i in range(nx):
            line[i] = patches[j, i] * (1.0 - fv) + patches[j1, i] * fv
        half_chord = math.sqrt(max_range_m * max_range_m - y * y) / cell_m
        middle = 0.5 * (n_x - 1)
        first = max(math.ceil(middle - half_chord), 0)
        last = min(math.floor(middle + half_chord), n_x - 1)
        for c in range(first, last + 1):
            out[r, c] = line[left[c]] + share[c] * (line[left[c] + 1] - line[left[c]])
    return out


@kernel
def bin_pixels(  # type: ignore[no-untyped-def]
    disparity, row_start, depth_m, ray, du, dv, offset_m, ground_m, cell_m, bottom_m, top_m
):
    """From disparity to counts, fused: points on the ground and in the slice of each cell.

    Returns int32 [n_y, n_x, 2]: [..., 1] counts the points from `bottom_m` to `top_m` above
    the cell's ground, [..., 0] those from 0.5 m below it up to `bottom_m`. Three short loops
    a row, because the middle one then runs in vector registers. Single precision: 2^-24 of
    15 m is a micrometre.
    """
    n_y, n_x = ground_m.shape
    width = disparity.shape[1]
    counts = np.zeros((n_y, n_x, 2), dtype=np.int32)
    flat_counts, flat_ground = counts.reshape(-1), ground_m.reshape(-1)
    per_cell = np.float32(1.0 / cell_m)
    dx, dy, dz = du[0] * per_cell, du[1] * per_cell, du[2]
    x0, y0, z0 = offset_m[0] * per_cell + np.float32(0.5 * n_x), offset_m[1] * per_cell, offset_m[2]
    depth, height = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    cell = np.empty(width, dtype=np.int32)
    lowest_m = np.float32(-0.5)
    for row in range(disparity.shape[0]):
        v = np.float32(row + row_start)
        rx, ry = (ray[0] + v * dv[0]) * per_cell, (ray[1] + v * dv[1]) * per_cell
        rz = ray[2] + v * dv[2]
        for u in range(width):
            depth[u] = depth_m[max(disparity[row, u], 0)]
        for u in range(width):
            z, uf = depth[u], np.float32(u)
            x, y = z * (rx + uf * dx) + x0, z * (ry + uf * dy) + y0
            inside = (x >= 0.0) & (y >= 0.0) & (x < n_x) & (y < n_y)
            cell[u] = np.int32(y) * n_x + np.int32(x) if inside else -1
            height[u] = z * (rz + uf * dz) + z0
        for u in range(width):
            k = cell[u]
            if k >= 0:
                above = height[u] - flat_ground[k]
                if above > lowest_m and above < top_m:
                    flat_counts[2 * k + (1 if above > bottom_m else 0)] += 1
    return counts


def bin_pixels_reference(
    disparity: npt.NDArray[np.int16],
    row_start: int,
    depth_m: _Float32,
    ray: _Float32,
    du: _Float32,
    dv: _Float32,
    offset_m: _Float32,
    ground_m: _Float32,
    cell_m: float,
    bottom_m: np.float32,
    top_m: np.float32,
) -> npt.NDArray[np.int32]:
    """The same as `bin_pixels`, in NumPy, with histogram2d doing the counting."""
    row, u = np.nonzero(disparity > 0)
    depth = depth_m[disparity[row, u]]
    v, u = (row + row_start).astype(np.float32), u.astype(np.float32)
    per_cell = np.float32(1.0 / cell_m)
    n_y, n_x = ground_m.shape
    middle = np.float32(0.5 * n_x)
    x = depth * ((ray[0] + v * dv[0]) * per_cell + u * (du[0] * per_cell))
    x = x + (offset_m[0] * per_cell + middle)
    y = depth * ((ray[1] + v * dv[1]) * per_cell + u * (du[1] * per_cell))
    y = y + offset_m[1] * per_cell
    z = depth * (ray[2] + v * dv[2] + u * du[2]) + offset_m[2]
    inside = (x >= 0) & (y >= 0) & (x < n_x) & (y < n_y)
    c, r = x[inside].astype(np.intp), y[inside].astype(np.intp)
    above = z[inside] - ground_m[r, c]

    def count(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        edges = (np.arange(n_y + 1), np.arange(n_x + 1))
        counted: npt.NDArray[np.int32]
        counted = np.histogram2d(r[mask], c[mask], bins=edges)[0].astype(np.int32)
        return counted

    ground = count((above > np.float32(-0.5)) & (above <= bottom_m) & (above < top_m))
    return np.stack([ground, count((above > bottom_m) & (above < top_m))], axis=-1)


@kernel
def scale_density(counts, gain, min_points, min_ground_points):  # type: ignore[no-untyped-def]
    """Counts to 3D density, uint8, and the observed mask, both [n_y, n_x].

    A cell with enough points in the slice has a density. Without one a cell is seen, and empty,
    only where the ground shows, nothing of the slice does, and no neighbour is an obstacle: the
    edge of an obstacle is in doubt, and doubt is not free.
    """
    n_y, n_x = counts.shape[0], counts.shape[1]
    density = np.zeros((n_y, n_x), dtype=np.uint8)
    observed = np.zeros((n_y, n_x), dtype=np.bool_)
    for r in range(n_y):
        for c in range(n_x):
            in_slice = counts[r, c, 1]
            if in_slice >= min_points:
                value = np.float32(in_slice) * gain[r, c] + np.float32(0.5)
                density[r, c] = np.uint8(min(value, np.float32(255.0)))
                observed[r, c] = True
            elif in_slice == 0 and counts[r, c, 0] >= min_ground_points:
                observed[r, c] = True
    for r in range(n_y):
        for c in range(n_x):
            if counts[r, c, 1] >= min_points:
                for rr in range(max(r - 1, 0), min(r + 2, n_y)):
                    for cc in range(max(c - 1, 0), min(c + 2, n_x)):
                        observed[rr, cc] &= counts[rr, cc, 1] >= min_points
    return density, observed
