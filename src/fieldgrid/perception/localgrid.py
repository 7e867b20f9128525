"""What a sensor saw becomes a vehicle-fixed local grid of 3D density.

The core step, in the paper's order: match, find the ground, carry each matched pixel into the
ground frame, keep the slice, count by cell, compensate for range, scale to 0-255. Depth images
enter after the matching, and clouds with their points.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np

from fieldgrid.core import (
    Bool,
    CalibrationError,
    DensitySettings,
    Float32,
    Float64,
    Int16,
    Int32,
    StereoSettings,
    UInt8,
)
from fieldgrid.geometry import DepthCamera, GridSpec, Lidar, LocalGrid, Rig, StereoCamera, Tilt
from fieldgrid.perception.binning import bin_pixels, bin_points
from fieldgrid.perception.cloud import Cloud
from fieldgrid.perception.depth import (
    CodedDepth,
    depth_table,
    encode_depth,
    metric_table,
    points_per_rad,
    rays,
)
from fieldgrid.perception.frame_ground import (
    FrameGround,
    HeightBlocks,
    drops_cm,
    ground_heights_cm,
    steps_cm,
)
from fieldgrid.perception.ground import PATCH_M, GroundPlane, estimate_ground
from fieldgrid.perception.standing import BINS_PER_M, reach_dm, stack_pixels, stack_points
from fieldgrid.perception.stereo import (
    SUBPIXELS,
    Disparity,
    SearchRegion,
    StereoMatcher,
    search_region,
)

SPARSE_SHARE, SPARSE_POINTS = 0.1, 2
"""A cell of a lidar needs no more points than a tenth of those that a wall through it, or bare
ground in it, would give, and no more than two: a lidar makes no false matches, and two points in
one cell are no rain drop."""


_NEIGHBOURS = np.ones((3, 3), dtype=np.uint8)


SURE_TILT_DEG = 0.5
"""Of a vehicle that leans by an angle less sure than this, heights of the ground are not kept: 15 m
ahead they would be off by more than 13 cm."""

STEP_SIGMA_M = 0.045
"""Steps are looked for where the height of a matched point is surer than this: 10 m with the
paper's rig. Beyond, noise makes steps of 15 cm."""


class LocalGridder:
    """Makes local grids for one rig and one set of settings; safe to call from threads.

    From pairs, depth images or clouds, whichever the rig's sensor gives; CalibrationError for
    what it does not.
    """

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
        self._matcher: StereoMatcher | None = None
        if isinstance(rig.sensor, StereoCamera):
            region = search_region(rig, self.stereo, self.settings.slice_top_m, self.max_range_m)
            self._matcher = StereoMatcher(rig.sensor, self.stereo, region)
            self._depth_m = depth_table(rig, region.num_disparities, SUBPIXELS)
            nearest_m = 0.0
        else:
            # The camera may look down: its depths reach beyond the range on the ground.
            highest_m = max(rig.mount.height_m, self.settings.slice_top_m)
            self._depth_m = metric_table(math.hypot(self.max_range_m, 2.0 * highest_m))
            nearest_m = self.settings.min_range_m
        range_m = _ranges_m(self.spec)
        self._within = (range_m >= nearest_m) & (range_m <= self.max_range_m)
        self._step_range_m = step_range_m(rig, self.max_range_m, self.stereo)
        self._tells_steps = range_m <= self._step_range_m
        self._blocks = HeightBlocks(self.spec)
        self._gain = density_gain(rig, self.spec, self.settings)
        self._needed = points_needed(rig, self.spec, self.settings)

    def __reduce__(self) -> tuple[Any, ...]:
        # Another process makes its own matchers and tables.
        return LocalGridder, (self.rig, self.spec, self.stereo, self.settings)

    @property
    def matcher(self) -> StereoMatcher:
        """What matches the pairs; CalibrationError for a rig without a stereo camera."""
        if self._matcher is None:
            raise CalibrationError(_gives_no(self.rig, "pairs"))
        return self._matcher

    @property
    def region(self) -> SearchRegion:
        """The rows and disparities that are searched; CalibrationError as for `matcher`."""
        return self.matcher.region

    def __call__(
        self, left: UInt8, right: UInt8, tilt: Tilt | None = None
    ) -> tuple[LocalGrid, FrameGround]:
        """The local grid of a rectified grey pair [height, width].

        With the vehicle's `tilt` against gravity, here and below, x and y of the grid are level and
        its columns vertical; without it they are square to the ground ahead.
        """
        return self.from_disparity(self.matcher.disparity(left, right), tilt)

    def from_disparity(
        self, disparity: Disparity, tilt: Tilt | None = None
    ) -> tuple[LocalGrid, FrameGround]:
        """The local grid of a disparity image of the rig's own matcher."""
        if self._matcher is None:
            raise CalibrationError(_gives_no(self.rig, "disparities"))
        return self.from_coded(self.coded(*disparity), tilt)

    def from_depth(
        self, depth_m: Float32, tilt: Tilt | None = None
    ) -> tuple[LocalGrid, FrameGround]:
        """The local grid of an image of depths along the optical axis [height, width], metres,
        NaN where there is none."""
        return self.from_coded(self.coded_depth(depth_m), tilt)

    def from_coded(
        self, seen: CodedDepth, tilt: Tilt | None = None
    ) -> tuple[LocalGrid, FrameGround]:
        """The local grid of a disparity or depth image that this gridder has coded (`coded`,
        `coded_depth`)."""
        return self._from_seen(seen, tilt)

    def coded(self, codes: Int16, row_start: int) -> CodedDepth:
        """Codes of this gridder, of the rows from `row_start`, with what they mean: disparities of
        the rig's own matcher are such, and what `coded_depth` made."""
        if isinstance(self.rig.sensor, Lidar):
            raise CalibrationError(_gives_no(self.rig, "images"))
        return CodedDepth(codes, row_start, self._depth_m)

    def coded_depth(self, depth_m: Float32) -> CodedDepth:
        """Depths along the optical axis [height, width], metres, NaN where there is none, coded;
        CalibrationError for another sensor's."""
        camera = self.rig.sensor
        if not isinstance(camera, DepthCamera):
            raise CalibrationError(_gives_no(self.rig, "depth images"))
        if depth_m.shape != (camera.height_px, camera.width_px):
            shape = " x ".join(str(size) for size in reversed(depth_m.shape))
            raise CalibrationError(
                f"The depth image is {shape} px, the calibration is for {camera.width_px} x "
                f"{camera.height_px}; use the calibration of these images."
            )
        depth_m = np.ascontiguousarray(depth_m, dtype=np.float32)
        return encode_depth(depth_m, self._depth_m)

    def from_cloud(self, points: Cloud, tilt: Tilt | None = None) -> tuple[LocalGrid, FrameGround]:
        """The local grid of points [n, 3] in the lidar's frame, metres: x right, y down, z
        forward. What is not finite is left out."""
        if not isinstance(self.rig.sensor, Lidar):
            raise CalibrationError(_gives_no(self.rig, "clouds"))
        if points.ndim != 2 or points.shape[1] != 3:
            raise CalibrationError(
                f"The cloud is an array of shape {points.shape}; give its points as [n, 3]."
            )
        return self._from_seen(np.ascontiguousarray(points, dtype=np.float32), tilt)

    def _from_seen(
        self, seen: CodedDepth | Cloud, tilt: Tilt | None
    ) -> tuple[LocalGrid, FrameGround]:
        spec = self.spec
        plane, patches, edges = estimate_ground(
            seen, self.rig, spec.width_m / 2.0, spec.length_m, tilt, self._step_range_m
        )
        if not plane.refined:
            # Heights above a ground that was not found are not known, so nothing is claimed.
            unseen = np.zeros(spec.shape, dtype=np.uint8)
            return LocalGrid(spec, unseen, unseen.astype(np.bool_)), _summary(plane)
        ground_m = local_ground(patches, spec, self._within)
        counts = self._count(seen, plane, ground_m)
        density, observed = scale_density(counts, self._gain, self._needed)
        # How high what stands at cells reaches, and how low it begins: see `reach_dm`.
        bottom_m = np.float32(self.settings.slice_bottom_m)
        top_m = np.float32(self.settings.slice_top_m)
        bins = math.ceil(BINS_PER_M * self.settings.slice_top_m - 1e-6)
        stacks: Int32 = np.zeros((*self._blocks.shape, bins), dtype=np.int32)
        above = (self._blocks.middle(ground_m), self._blocks.side_m, bottom_m, top_m, stacks)
        if isinstance(seen, CodedDepth):
            geometry = rays(self.rig, plane.A_grid_sensor, plane.height_m)
            stack_pixels(*seen, *geometry, *above)
        else:
            A_grid_sensor = plane.A_grid_sensor.astype(np.float32)
            stack_points(seen, A_grid_sensor, plane.height_m, *above)
        top, foot = reach_dm(stacks, np.stack([self._blocks.middle(one) for one in self._needed]))
        tops_dm, feet_dm = self._blocks.at_cells(top), self._blocks.at_cells(foot)
        ground = _summary(plane)._replace(
            steps_cm=steps_cm(edges.steps, spec, self._tells_steps),
            drops_cm=drops_cm(edges, spec, self._step_range_m),
            tops_dm=tops_dm,
            feet_dm=feet_dm,
        )
        if tilt is not None and tilt.sigma_deg <= SURE_TILT_DEG:
            mounted_m, on_ground = self.rig.mount.height_m, counts[0] >= self._needed[0]
            heights_cm = ground_heights_cm(plane, mounted_m, spec, ground_m, on_ground)
            ground = ground._replace(heights_cm=heights_cm)
        return LocalGrid(spec, density, observed), ground

    def _count(self, seen: CodedDepth | Cloud, plane: GroundPlane, ground_m: Float32) -> Int32:
        """Points on the ground and in the slice of each cell, [2, n_y, n_x]."""
        bottom_m = np.float32(self.settings.slice_bottom_m)
        top_m = np.float32(self.settings.slice_top_m)
        above = (ground_m, self.spec.cell_m, bottom_m, top_m)
        counts: Int32
        if isinstance(seen, CodedDepth):
            counts = bin_pixels(*seen, *rays(self.rig, plane.A_grid_sensor, plane.height_m), *above)
        else:
            A_grid_sensor = plane.A_grid_sensor.astype(np.float32)
            counts = bin_points(seen, A_grid_sensor, plane.height_m, *above)
        return counts


def _gives_no(rig: Rig, what: str) -> str:
    return (
        f"The rig's sensor is a {type(rig.sensor).__name__}, which gives no {what}; give what it "
        "does, or the calibration of another sensor."
    )


def _summary(plane: GroundPlane) -> FrameGround:
    return FrameGround(plane.height_m, plane.pitch_deg, plane.roll_deg, plane.refined)


def reliable_range_m(
    rig: Rig, spec: GridSpec, stereo: StereoSettings, settings: DensitySettings
) -> float:
    """The range up to which points enter: by setting, by grid, and where sigma_R allows.

    sigma_R = R²·sigma_d/(f·b) of a pair reaches `max_range_sigma_m` at
    R = sqrt(sigma·f·b/sigma_d). A lidar's does not grow so, and that of a depth camera whose
    baseline nobody says is not known.
    """
    within_m = min(settings.max_range_m, spec.reach_m)
    product_px_m = _focal_baseline_px_m(rig)
    if product_px_m is None:
        return within_m
    by_sigma_m = math.sqrt(settings.max_range_sigma_m * product_px_m / stereo.disparity_sigma_px)
    return min(within_m, by_sigma_m)


def step_range_m(rig: Rig, max_range_m: float, stereo: StereoSettings) -> float:
    """The range up to which steps of the ground are looked for.

    The height of a point on the ground is off by sigma_R·h/R; that reaches `STEP_SIGMA_M` at
    R = STEP_SIGMA_M·f·b/(sigma_d·h).
    """
    product_px_m = _focal_baseline_px_m(rig)
    if product_px_m is None:
        return max_range_m
    by_sigma_m = STEP_SIGMA_M * product_px_m / (stereo.disparity_sigma_px * rig.mount.height_m)
    return min(max_range_m, by_sigma_m)


def _focal_baseline_px_m(rig: Rig) -> float | None:
    """f·b of the pair that the rig's depths come from, None without one."""
    sensor = rig.sensor
    if isinstance(sensor, StereoCamera):
        return sensor.focal_baseline_px_m
    if isinstance(sensor, DepthCamera) and sensor.baseline_m is not None:
        return sensor.fx_px * sensor.baseline_m
    return None


def density_gain(rig: Rig, spec: GridSpec, settings: DensitySettings) -> Float32:
    """What one point is worth in a cell, of 255, float32 [n_y, n_x]: all scaling in one table."""
    range_m = _ranges_m(spec)
    compensation = (range_m / settings.reference_range_m) ** settings.range_exponent
    compensation = np.minimum(compensation, settings.max_gain)
    column_m3 = spec.cell_m**2 * settings.slice_m
    point_m2 = (settings.reference_range_m / points_per_rad(rig)) ** 2
    worth = 255.0 * compensation * point_m2 / column_m3 / settings.saturation_m2_per_m3
    return worth.astype(np.float32)


def points_needed(rig: Rig, spec: GridSpec, settings: DensitySettings) -> Int32:
    """How many points make a claim in a cell, int32 [2, n_y, n_x]: of free ground, of an obstacle.

    `min_ground_points` and `min_points`; of a lidar no more than two, and one where a wall through
    the cell as high as the slice, or the bare ground of the cell, would give up to ten. It sees
    ΔZ·cell/R² sr of the one and cell²·(h/R)/R² of the other.
    """
    needed = np.empty((2, *spec.shape), dtype=np.int32)
    needed[0], needed[1] = settings.min_ground_points, settings.min_points
    if isinstance(rig.sensor, Lidar):
        range_m = _ranges_m(spec)
        points_per_m2 = rig.sensor.points_per_sr / range_m**2
        wall = spec.cell_m * settings.slice_m * points_per_m2
        bare = spec.cell_m**2 * rig.mount.height_m / range_m * points_per_m2
        enough = np.ceil(SPARSE_SHARE * np.stack([bare, wall]))
        needed = np.minimum(needed, np.clip(enough, 1, SPARSE_POINTS)).astype(np.int32)
    return needed


def _ranges_m(spec: GridSpec) -> Float64:
    """Range of each cell's centre from the grid origin, [n_y, n_x]."""
    x, y = spec.centres_m()
    ranges_m: Float64 = np.hypot(x[None, :], y[:, None])
    return ranges_m


def local_ground(patches_m: Float64, spec: GridSpec, within: Bool) -> Float32:
    """Ground heights of patches [ny, nx], metres, bilinear to cells, float32 [n_y, n_x].

    NaN where not `within` [n_y, n_x]: no height compares with NaN, so no point enters there.
    """
    ny, nx = patches_m.shape
    u = np.clip((np.arange(spec.n_x) + 0.5) * spec.cell_m / PATCH_M - 0.5, 0.0, nx - 1.0)
    v = np.clip((np.arange(spec.n_y) + 0.5) * spec.cell_m / PATCH_M - 0.5, 0.0, ny - 1.0)
    left, below = u.astype(np.intp), v.astype(np.intp)
    right, above = np.minimum(left + 1, nx - 1), np.minimum(below + 1, ny - 1)
    share_u, share_v = (u - left).astype(np.float32), (v - below)[:, None]
    rows = (patches_m[below] * (1.0 - share_v) + patches_m[above] * share_v).astype(np.float32)
    start, stop = rows.take(left, axis=1), rows.take(right, axis=1)
    ground_m: Float32 = start + share_u * (stop - start)
    np.copyto(ground_m, np.nan, where=~within)
    return ground_m


def scale_density(counts: Int32, gain: Float32, needed: Int32) -> tuple[UInt8, Bool]:
    """Counts to 3D density, uint8, and the observed mask, both [n_y, n_x].

    `needed` [2, n_y, n_x] says how many points of the ground and of the slice make a claim. A
    cell with enough points in the slice has a density. Without one a cell is seen, and empty,
    only where the ground shows, nothing of the slice does, and no neighbour is an obstacle: the
    edge of an obstacle is in doubt, and doubt is not free.
    """
    on_ground, in_slice = counts
    obstacle = in_slice >= needed[1]
    value = np.minimum(in_slice.astype(np.float32) * gain + np.float32(0.5), np.float32(255.0))
    density = (value * obstacle).astype(np.uint8)
    beside = cv2.dilate(obstacle.view(np.uint8), _NEIGHBOURS).view(np.bool_)
    free = (on_ground >= needed[0]) & (in_slice == 0) & ~beside
    return density, obstacle | free
