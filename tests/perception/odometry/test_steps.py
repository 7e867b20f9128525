"""Stereo odometry: signs and sizes of a step, its stated error, and when it is refused."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import Rig, StereoCamera, wrap_deg
from fieldgrid.perception import CameraStep, Features, Refusal, features, step, steps_of
from fieldgrid.recordings import open_recording
from tests.conftest import TWO_LANES
from tests.scenes import paper_rig

Image = npt.NDArray[np.uint8]
Float64 = npt.NDArray[np.float64]


def vehicle_pose(
    forward_m: float = 0.0,
    right_m: float = 0.0,
    turn_deg: float = 0.0,
    *,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
) -> tuple[Float64, Float64]:
    """R_start_vehicle and where the grid origin is, in the vehicle frame of the start.

    Nose up and right side down are positive; the vehicle leans about the baseline's middle, so
    that the point below it stays where it is.
    """
    turn, pitch, roll = (math.radians(v) for v in (turn_deg, pitch_deg, roll_deg))
    turned = [[math.cos(turn), math.sin(turn), 0], [-math.sin(turn), math.cos(turn), 0], [0, 0, 1]]
    nose_up = [
        [1, 0, 0],
        [0, math.cos(pitch), -math.sin(pitch)],
        [0, math.sin(pitch), math.cos(pitch)],
    ]
    right_down = [
        [math.cos(roll), 0, math.sin(roll)],
        [0, 1, 0],
        [-math.sin(roll), 0, math.cos(roll)],
    ]
    R = np.array(turned) @ np.array(nose_up) @ np.array(right_down)
    return R, np.array([right_m, forward_m, 0.0])


def seen(rig: Rig, points_m: Float64, pose: tuple[Float64, Float64]) -> Float64:
    """Column, row and disparity [n, 3] of points of the start's vehicle frame, NaN if unseen."""
    camera, (R, origin) = rig.camera, pose
    middle = origin + np.array([0.0, 0.0, rig.mount.height_m])
    in_camera = (points_m - middle) @ (R @ rig.mount.rotation())
    x, y, z = (in_camera + np.array([camera.baseline_m / 2.0, 0.0, 0.0])).T
    pixels = np.column_stack(
        [
            camera.cx_px + camera.focal_px * x / z,
            camera.cy_px + camera.focal_px * y / z,
            camera.focal_baseline_px_m / z,
        ]
    )
    inside = (z > 2.0) & (pixels[:, 2] >= 1.0)
    inside &= (pixels[:, 0] > 8.0) & (pixels[:, 0] < camera.width_px - 8.0)
    inside &= (pixels[:, 1] > 8.0) & (pixels[:, 1] < camera.height_px - 8.0)
    return np.where(inside[:, None], pixels, np.nan)


def made_features(rig: Rig, measured_px: Float64, descriptors: npt.NDArray[np.uint64]) -> Features:
    camera, (u, v, d) = rig.camera, measured_px.T
    depth = camera.focal_baseline_px_m / d
    per_px = depth / camera.focal_px
    points = [(u - camera.cx_px) * per_px, (v - camera.cy_px) * per_px, depth]
    return Features(measured_px, np.column_stack(points), np.ones(len(u)), descriptors)


def made_pair(
    rig: Rig,
    pose: tuple[Float64, Float64],
    *,
    count: int = 1500,
    noise: float = 0.0,
    wrong: float = 0.0,
    seed: int = 0,
) -> tuple[Features, Features]:
    """Features of points on the ground, in canopies and far away, before and after a motion.

    `noise` is in units of (0.5, 0.5, 0.25) px; a share `wrong` of the points carries the look
    of another one at the stop.
    """
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-10.0, 10.0, count), rng.uniform(2.0, 40.0, count)
    z = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0.0, 2.5, count))
    points_m = np.column_stack([x, y, z])
    looks = rng.integers(0, 2**64, (count, 4), dtype=np.uint64)
    changed = looks ^ (np.uint64(1) << rng.integers(0, 64, (count, 4), dtype=np.uint64))
    mixed = rng.permutation(np.flatnonzero(rng.random(count) < wrong))
    changed[np.sort(mixed)] = changed[mixed]
    frames = []
    for where, look in ((vehicle_pose(), looks), (pose, changed)):
        pixels = seen(rig, points_m, where)
        pixels += noise * rng.normal(0.0, 1.0, pixels.shape) * np.array([0.5, 0.5, 0.25])
        kept = pixels[:, 2] >= 1.0
        frames.append(made_features(rig, pixels[kept], look[kept]))
    return frames[0], frames[1]


def solved(result: CameraStep | Refusal) -> CameraStep:
    assert isinstance(result, CameraStep), result
    return result


@pytest.mark.parametrize(
    ("forward_m", "right_m", "turn_deg"),
    [(1.9, 0.0, 0.0), (-1.4, 0.0, 0.0), (0.0, 0.0, 14.0), (0.001, 0.0, 0.0), (1.2, 0.5, -9.0)],
    ids=["forward", "reverse", "turn in place", "standing", "all at once"],
)
@pytest.mark.parametrize(
    "rig",
    [
        paper_rig(),
        paper_rig(tilt_deg=0.0, height_m=1.6, focal_px=600.0),
        paper_rig(roll_deg=6.0, yaw_deg=-11.0),
    ],
    ids=["tilted", "level", "rolled and yawed"],
)
def test_a_step_without_noise_is_exact(
    rig: Rig, forward_m: float, right_m: float, turn_deg: float
) -> None:
    found = solved(step(*made_pair(rig, vehicle_pose(forward_m, right_m, turn_deg)), rig))
    assert found.forward_m == pytest.approx(forward_m, abs=1e-5)
    assert found.right_m == pytest.approx(right_m, abs=1e-5)
    assert found.turn_deg == pytest.approx(turn_deg, abs=1e-4)
    assert 0.0 < found.sigma_m < 0.03
    assert 0.0 < found.sigma_deg < 0.1


@settings(max_examples=60, deadline=None)
@given(
    forward_m=st.floats(-2.2, 2.2),
    right_m=st.floats(-0.4, 0.4),
    turn_deg=st.floats(-14.0, 14.0),
    pitch_deg=st.floats(-2.0, 2.0),
    roll_deg=st.floats(-2.0, 2.0),
    tilt_deg=st.floats(5.0, 22.0),
    mount_roll_deg=st.floats(-5.0, 5.0),
    wrong=st.floats(0.0, 0.5),
    seed=st.integers(0, 1000),
)
def test_a_step_is_within_its_stated_error(
    forward_m: float,
    right_m: float,
    turn_deg: float,
    pitch_deg: float,
    roll_deg: float,
    tilt_deg: float,
    mount_roll_deg: float,
    wrong: float,
    seed: int,
) -> None:
    rig = paper_rig(tilt_deg=tilt_deg, roll_deg=mount_roll_deg)
    pose = vehicle_pose(forward_m, right_m, turn_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)
    found = solved(step(*made_pair(rig, pose, noise=1.0, wrong=wrong, seed=seed), rig))
    off_m = max(abs(found.forward_m - forward_m), abs(found.right_m - right_m))
    # The error is that of noise alone; 5 sigma because many examples are drawn.
    assert off_m < 5.0 * found.sigma_m
    assert abs(found.turn_deg - turn_deg) < 5.0 * found.sigma_deg
    assert found.sigma_m < 0.06
    assert found.sigma_deg < 0.12


def test_the_stated_error_grows_with_the_noise_and_shrinks_with_more_points() -> None:
    rig, pose = paper_rig(), vehicle_pose(0.1)
    usual = solved(step(*made_pair(rig, pose, noise=1.0), rig))
    noisy = solved(step(*made_pair(rig, pose, noise=2.0), rig))
    few = solved(step(*made_pair(rig, pose, noise=1.0, count=300), rig))
    for worse in (noisy, few):
        assert worse.sigma_m > 1.2 * usual.sigma_m
        assert worse.sigma_deg > 1.05 * usual.sigma_deg  # most of it is the floor


@lru_cache(maxsize=2)
def texture(seed: int) -> Float64:
    """20 m x 30 m of ground, a pixel a centimetre: clods, stones and tufts."""
    rng = np.random.default_rng(seed)
    grey = np.zeros((3000, 2000))
    for size_px in (1.5, 4.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(0.0, 1.0, grey.shape), (0, 0), size_px)
        grey += layer / layer.std()
    return 118.0 + 28.0 * grey


def photo(
    rig: Rig, pose: tuple[Float64, Float64], seed: int = 0, cx_right_px: float | None = None
) -> tuple[Image, Image]:
    """A rectified pair of textured, level ground; the cameras have some noise and unlike gains."""
    camera, (R, origin) = rig.camera, pose
    R_start_camera = R @ rig.mount.rotation()
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(np.float64)
    rng = np.random.default_rng(round(1e6 * abs(origin).sum()) + 1)
    images = []
    for side, cx_px in ((-0.5, camera.cx_px), (0.5, cx_right_px or camera.cx_px)):
        in_camera = [(u - cx_px) / camera.focal_px, (v - camera.cy_px) / camera.focal_px]
        ray = np.tensordot(R_start_camera, np.stack([*in_camera, np.ones_like(u)]), axes=1)
        eye = origin + R_start_camera @ np.array([side * camera.baseline_m, 0.0, 0.0])
        eye[2] += rig.mount.height_m
        depth = np.where(ray[2] < -0.02, -eye[2] / np.minimum(ray[2], -0.02), np.nan)
        x, y = ((eye[k] + depth * ray[k]) * 100.0 for k in (0, 1))
        grey = cv2.remap(
            texture(seed),
            (x + 1000.0).astype(np.float32),
            (y + 500.0).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=118.0,
        )
        grey = (1.0 + 0.1 * side) * grey + rng.normal(0.0, 1.5, grey.shape)
        images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    return images[0], images[1]


LOOKING_DOWN = paper_rig(tilt_deg=24.0)


@pytest.mark.parametrize(
    ("forward_m", "right_m", "turn_deg"),
    [(0.8, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.0, 0.0, 10.0), (0.001, 0.0, 0.0), (0.6, 0.3, -6.0)],
    ids=["forward", "reverse", "turn in place", "standing", "all at once"],
)
def test_a_step_is_found_in_images(forward_m: float, right_m: float, turn_deg: float) -> None:
    rig = LOOKING_DOWN
    poses = (vehicle_pose(), vehicle_pose(forward_m, right_m, turn_deg))
    start, stop = (features(rig.camera, *photo(rig, pose)) for pose in poses)
    found = solved(step(start, stop, rig))
    assert found.inliers > 60
    assert found.sigma_m < 0.02
    assert found.sigma_deg < 0.1
    assert abs(found.forward_m - forward_m) < 3.0 * found.sigma_m
    assert abs(found.right_m - right_m) < 3.0 * found.sigma_m
    assert abs(found.turn_deg - turn_deg) < 3.0 * found.sigma_deg


def test_corners_carry_the_depth_of_the_ground() -> None:
    rig = LOOKING_DOWN
    found = features(rig.camera, *photo(rig, vehicle_pose()))
    assert len(found.blur_px) > 300
    assert found.descriptors.shape == (len(found.blur_px), 4)
    height_m = rig.mount.height_m + (found.points_m @ rig.mount.rotation().T)[:, 2]
    error_m = np.abs(height_m) / rig.camera.range_sigma_m(found.points_m[:, 2], 0.25)
    assert np.median(error_m) < 0.5
    assert (error_m < 3.0).mean() > 0.97


@pytest.mark.parametrize("offset_px", [-25.0, 40.0])
def test_a_disparity_at_infinity_is_taken_off(offset_px: float) -> None:
    """A right camera whose principal point is elsewhere moves the disparities, not the points."""
    cx_right_px = LOOKING_DOWN.camera.cx_px - offset_px
    shifted = replace(LOOKING_DOWN, sensor=replace(LOOKING_DOWN.camera, cx_right_px=cx_right_px))
    found = features(shifted.camera, *photo(shifted, vehicle_pose(), cx_right_px=cx_right_px))
    assert len(found.blur_px) > 200
    height_m = shifted.mount.height_m + (found.points_m @ shifted.mount.rotation().T)[:, 2]
    assert np.median(np.abs(height_m)) < 0.05


def same(one: Features, other: Features) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_the_same_images_give_the_same_bits_in_any_thread() -> None:
    rig = LOOKING_DOWN
    pairs = [photo(rig, vehicle_pose(forward)) for forward in (0.0, 0.4, 0.8)]
    alone = [features(rig.camera, *pair) for pair in pairs]
    threads_before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        with ThreadPoolExecutor(3) as pool:
            beside = list(pool.map(lambda pair: features(rig.camera, *pair), pairs * 2))
            steps = list(pool.map(lambda k: step(alone[k], alone[k + 1], rig), [0, 1, 0, 1]))
    finally:
        cv2.setNumThreads(threads_before)
    assert all(same(a, b) for a, b in zip(alone * 2, beside, strict=True))
    cv2.setRNGSeed(12345)
    assert steps == [step(alone[k], alone[k + 1], rig) for k in (0, 1, 0, 1)]


def test_what_was_given_is_not_changed() -> None:
    rig = LOOKING_DOWN
    start, stop = made_pair(rig, vehicle_pose(1.0), noise=1.0)
    before = [array.copy() for array in (*start, *stop)]
    step(start, stop, rig)
    assert all(np.array_equal(a, b) for a, b in zip(before, (*start, *stop), strict=True))


def test_blank_images_are_refused() -> None:
    camera = LOOKING_DOWN.camera
    blank = np.full((camera.height_px, camera.width_px), 90, dtype=np.uint8)
    nothing = features(camera, blank, blank)
    assert len(nothing.blur_px) == 0
    assert step(nothing, nothing, LOOKING_DOWN) is Refusal.FEW_POINTS


def test_unrelated_images_are_refused() -> None:
    rig = LOOKING_DOWN
    here = features(rig.camera, *photo(rig, vehicle_pose()))
    elsewhere = features(rig.camera, *photo(rig, vehicle_pose(), seed=1))
    for pair in ((here, elsewhere), (elsewhere, here)):
        assert step(*pair, rig) in (Refusal.FEW_AGREE, Refusal.NOT_IN_VIEW)


def test_too_few_points_are_refused() -> None:
    start, stop = made_pair(LOOKING_DOWN, vehicle_pose(1.0), count=60)
    few = Features(*(array[:29] for array in stop))
    assert step(start, few, LOOKING_DOWN) is Refusal.FEW_POINTS
    assert step(few, start, LOOKING_DOWN) is Refusal.FEW_POINTS


def test_an_image_that_comes_again_says_nothing_of_the_motion() -> None:
    start, _ = made_pair(LOOKING_DOWN, vehicle_pose(1.0))
    assert step(start, start, LOOKING_DOWN) is Refusal.SAME


def test_points_that_agree_by_chance_only_are_refused() -> None:
    """The looks of all points mixed: whatever few of them fit is no step."""
    for seed in range(10):
        pair = made_pair(LOOKING_DOWN, vehicle_pose(1.0), wrong=1.0, noise=1.0, seed=seed)
        assert isinstance(step(*pair, LOOKING_DOWN), Refusal)


def test_two_motions_that_explain_the_images_alike_are_refused() -> None:
    """Few points, some of which moved one way and about as many another."""
    rig = LOOKING_DOWN
    start, stop = made_pair(rig, vehicle_pose(1.0), count=290, seed=1)
    start_too, stop_too = made_pair(rig, vehicle_pose(-0.5), count=280, seed=2)
    one, other = solved(step(start, stop, rig)), solved(step(start_too, stop_too, rig))
    assert max(one.inliers, other.inliers) < 60
    both = [
        Features(*(np.concatenate(arrays) for arrays in zip(first, second, strict=True)))
        for first, second in ((start, start_too), (stop, stop_too))
    ]
    assert step(both[0], both[1], rig) is Refusal.RIVAL


@pytest.mark.parametrize(
    ("rise_m", "roll_deg", "refusal"),
    [(0.0, 14.0, Refusal.TIPPED), (0.8, 0.0, Refusal.LIFTED)],
)
def test_what_no_vehicle_does_is_not_believed(
    rise_m: float, roll_deg: float, refusal: Refusal
) -> None:
    R, origin = vehicle_pose(0.5, roll_deg=roll_deg)
    origin[2] = rise_m
    assert step(*made_pair(LOOKING_DOWN, (R, origin)), LOOKING_DOWN) is refusal


def test_images_of_another_size_are_refused() -> None:
    camera = StereoCamera(320, 240, 390.0, 160.0, 120.0, 0.2)
    small, large = np.zeros((240, 320), np.uint8), np.zeros((480, 640), np.uint8)
    with pytest.raises(CalibrationError, match=r"right image is 640 x 480 px.* 320 x 240"):
        features(camera, small, large)


def test_steps_of_a_drive_leave_the_refused_ones_out() -> None:
    first = CameraStep(1.0, 0.1, 2.0, 0.01, 0.1, 0.3, 1.0, -2.0, 0.05, 50)
    last = CameraStep(-0.5, 0.0, -3.0, 0.02, 0.2, 0.4, 1.5, -2.5, 0.06, 40)
    steps = steps_of([10, 20, 30, 40], [first, Refusal.FEW_AGREE, last])
    assert steps.start_ns.tolist() == [10, 30]
    assert steps.stop_ns.tolist() == [20, 40]
    assert steps.start_ns.dtype == np.int64
    assert steps.forward_m.tolist() == [1.0, -0.5]
    assert steps.right_m.tolist() == [0.1, 0.0]
    assert steps.turn_deg.tolist() == [2.0, -3.0]
    assert steps.sigma_m.tolist() == [0.01, 0.02]
    assert steps.sigma_deg.tolist() == [0.1, 0.2]
    assert steps.up_m.tolist() == [0.3, 0.4]
    assert steps.roll_deg.tolist() == [1.0, 1.5]
    assert steps.pitch_deg.tolist() == [-2.0, -2.5]
    assert steps.tilt_sigma_deg.tolist() == [0.05, 0.06]
    assert len(steps_of([10], []).start_ns) == 0


def frames_of(path: Path, gnss: str | None = None) -> tuple[Rig, list[Features]]:
    with open_recording(path, gnss) as drive:
        images = (frame.images() for frame in drive.frames())
        return drive.rig, [features(drive.rig.camera, *pair) for pair in images]


@pytest.fixture(scope="module")
def vineyard() -> tuple[Rig, list[Features]]:
    return frames_of(TWO_LANES, "gnss_rtk.nmea")


def vineyard_truth() -> Float64:
    """Forward and right in metres, turn in degrees, from each frame to the next, [49, 3]."""
    with (TWO_LANES / "truth" / "poses_frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    east, north, heading = (
        np.array([float(row[name]) for row in rows])
        for name in ("cam_mid_E", "cam_mid_N", "heading_deg")
    )
    phi, de, dn = np.radians(heading[:-1]), np.diff(east), np.diff(north)
    forward, right = de * np.sin(phi) + dn * np.cos(phi), de * np.cos(phi) - dn * np.sin(phi)
    return np.column_stack([forward, right, wrap_deg(np.diff(heading))])


def test_the_vineyard_drive(vineyard: tuple[Rig, list[Features]]) -> None:
    rig, frames = vineyard
    results = [step(a, b, rig) for a, b in pairwise(frames)]
    found = [(k, one) for k, one in enumerate(results) if isinstance(one, CameraStep)]
    assert len(found) >= 0.95 * len(results)
    truth = vineyard_truth()[[k for k, _ in found]]
    values = np.array([one for _, one in found])
    off_m = np.hypot(*(values[:, :2] - truth[:, :2]).T)
    off_deg = np.abs(values[:, 2] - truth[:, 2])
    assert np.median(off_m) < 0.02
    assert np.percentile(off_m, 95) < 0.08
    assert np.median(off_deg) < 0.05
    assert np.percentile(off_deg, 95) < 0.2
    assert (off_m < 3.0 * math.sqrt(2.0) * values[:, 3]).mean() >= 0.97
    assert (off_deg < 3.0 * values[:, 4]).mean() >= 0.97
    assert (np.sign(values[:, 0]) == np.sign(truth[:, 0])).all()
    assert (truth[:, 0] < 0.0).sum() == 3  # the pieces in reverse are among the found ones


def test_frames_that_do_not_overlap_are_refused(vineyard: tuple[Rig, list[Features]]) -> None:
    """The other lane, the other way: vines look like vines there too."""
    rig, frames = vineyard
    for start, stop in [(0, 48), (4, 40), (8, 36), (15, 45), (17, 45), (1, 19), (20, 12), (47, 38)]:
        assert isinstance(step(frames[start], frames[stop], rig), Refusal)


def test_a_real_road(shared_data: Callable[[str], Path]) -> None:
    """KITTI's own poses, without the frames whose positions it interpolated."""
    folder = shared_data("kitti_2011_09_30_drive_0020")
    rig, frames = frames_of(folder)
    results = [step(a, b, rig) for a, b in pairwise(frames[13:])]
    found = np.array([solved(one) for one in results])
    poses = np.loadtxt(folder / "native_poses.txt").reshape(-1, 3, 4)[13:]
    distance_m = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    # Camera yaw: y is down, so a turn to the right is positive about it.
    yaw_deg = np.degrees(np.arctan2(poses[:, 0, 2], poses[:, 2, 2]))
    off_m = np.abs(found[:, 0] - distance_m)
    off_deg = np.abs(found[:, 2] - np.diff(yaw_deg))
    assert np.median(off_m) < 0.02
    assert np.median(off_deg) < 0.03
    assert (off_m < 3.0 * found[:, 3]).mean() >= 0.97
    assert (off_deg < 3.0 * found[:, 4]).mean() >= 0.97
