"""Rectification: rows that agree, disparities that measure, and what is refused."""

from __future__ import annotations

import math
import threading
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import LensModel, RawCamera, lens_model, raw_camera
from fieldgrid.perception import (
    Rectification,
    camera_from_projections,
    rectify_by_pose,
    rectify_by_projections,
)

Float64 = npt.NDArray[np.float64]

SIZE_PX = (640, 480)


def turn(x_deg: float, y_deg: float, z_deg: float) -> Float64:
    """A rotation about x, then y, then z."""
    x, y, z = (math.radians(v) for v in (x_deg, y_deg, z_deg))
    about_x = np.array([[1, 0, 0], [0, math.cos(x), -math.sin(x)], [0, math.sin(x), math.cos(x)]])
    about_y = np.array([[math.cos(y), 0, math.sin(y)], [0, 1, 0], [-math.sin(y), 0, math.cos(y)]])
    about_z = np.array([[math.cos(z), -math.sin(z), 0], [math.sin(z), math.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def project(camera: RawCamera, points: Float64) -> Float64:
    """Raw pixels of points in the camera's frame, by the formulas of the models themselves."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    D = camera.distortion
    r2 = x * x + y * y
    if camera.model is LensModel.EQUIDISTANT:
        r = np.sqrt(r2)
        angle = np.arctan(r)
        bent = angle * (1 + sum(k * angle ** (2 * n + 2) for n, k in enumerate(D)))
        with np.errstate(invalid="ignore"):
            scale = np.where(r > 1e-12, bent / r, 1.0)
        u, v = x * scale, y * scale
    else:
        k1, k2, p1, p2, k3, k4, k5, k6, *thin = (*D, *[0.0] * (14 - len(D)))
        s1, s2, s3, s4, *_ = thin
        radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + s1 * r2 + s2 * r2**2
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2
    return np.column_stack([camera.fx_px * u + camera.cx_px, camera.fy_px * v + camera.cy_px])


small = st.floats(-1.0, 1.0)
LENSES = {
    LensModel.NONE: (),
    LensModel.PLUMB_BOB: (0.2, 0.08, 0.002, 0.002, 0.02),
    LensModel.RATIONAL: (0.2, 0.05, 0.002, 0.002, 0.01, 0.1, 0.03, 0.01),
    LensModel.EQUIDISTANT: (0.05, 0.01, 0.005, 0.001),
}


@st.composite
def cameras(draw: st.DrawFn, model: LensModel, scale: tuple[float, ...]) -> RawCamera:
    """A camera of some 56° and its lens."""
    return RawCamera(
        *SIZE_PX,
        600 + 20 * draw(small),
        600 + 20 * draw(small),
        320 + 15 * draw(small),
        240 + 15 * draw(small),
        model,
        tuple(size * draw(small) for size in scale),
    )


class Stereo(NamedTuple):
    left: RawCamera
    right: RawCamera
    R: Float64
    T: Float64


@st.composite
def pairs(draw: st.DrawFn) -> Stereo:
    """Two cameras that look nearly the same way, about 0.2 m apart."""
    model = draw(st.sampled_from(list(LENSES)))
    scale = LENSES[model]
    if model is LensModel.PLUMB_BOB:
        scale = scale[: draw(st.sampled_from([4, 5]))]
    if model is LensModel.RATIONAL:
        scale += (0.002,) * draw(st.sampled_from([0, 4]))
    R = turn(*(2.0 * draw(small) for _ in range(3)))
    place = np.array([0.2 + 0.1 * draw(small), 0.01 * draw(small), 0.01 * draw(small)])
    return Stereo(draw(cameras(model, scale)), draw(cameras(model, scale)), R, -R @ place)


COLUMNS, ROWS = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
RAMPS = COLUMNS.astype(np.float32), ROWS.astype(np.float32)


def sources(found: Rectification, side: int) -> Float64:
    """Where each rectified pixel [row, column] of a side is taken from: (column, row).

    Images that say of each pixel where it is go through the rectifier itself.
    """
    if found.rectifier is None:
        return np.stack(RAMPS, axis=-1).astype(np.float64)
    taken = [found.rectifier(ramp, ramp)[side] for ramp in RAMPS]  # type: ignore[arg-type]
    return np.stack(taken, axis=-1).astype(np.float64)


def between(image: Float64, pixels: Float64) -> Float64:
    """Values of an image between its pixels (column, row), linearly."""
    whole = np.floor(pixels).astype(int)
    (x, y), (column, row) = (pixels - whole).T[:, :, None], whole.T
    upper = (1 - x) * image[row, column] + x * image[row, column + 1]
    lower = (1 - x) * image[row + 1, column] + x * image[row + 1, column + 1]
    return (1 - y) * upper + y * lower


def miss_px(pair: Stereo, found: Rectification) -> Float64:
    """How far the rectified images are off, in raw pixels, (left, right) of each point seen.

    A point of the rectified camera's frame is to be seen at (u, v) of the left image, and at
    (u - d, v) of the right one with the d of its depth: there the raw images must show it.
    """
    camera = found.camera
    grid = np.stack(np.meshgrid(np.linspace(60, 579, 7), np.linspace(30, 449, 5)), axis=-1)
    missed = []
    for z in (2.0, 5.0, 15.0):
        left_px = grid.reshape(-1, 2)
        right_px = left_px.copy()
        right_px[:, 0] -= camera.focal_px * camera.baseline_m / z + camera.disparity_offset_px
        rays = (left_px - (camera.cx_px, camera.cy_px)) / camera.focal_px
        points = np.column_stack([rays, np.ones(len(rays))]) * z @ found.R_rect_left
        raw = project(pair.left, points), project(pair.right, points @ pair.R.T + pair.T)
        inside = (right_px[:, 0] > 0) & (right_px[:, 0] < SIZE_PX[0] - 2)
        for places in raw:
            inside &= ((places > 1) & (places < np.array(SIZE_PX) - 2)).all(axis=1)
        off = [
            np.abs(between(sources(found, side), pixels[inside]) - raw[side][inside]).max(axis=1)
            for side, pixels in enumerate((left_px, right_px))
        ]
        missed.append(np.column_stack(off))
    return np.concatenate(missed)


@settings(max_examples=60, deadline=None)
@given(pair=pairs())
def test_a_point_lands_on_one_row_at_the_disparity_of_its_depth(pair: Stereo) -> None:
    found = rectify_by_pose(*pair, "test")
    assert found.camera.baseline_m == pytest.approx(float(np.linalg.norm(pair.T)), rel=1e-9)
    missed = miss_px(pair, found)
    assert len(missed) >= 50
    assert missed.max() < 0.02


PINHOLE = RawCamera(*SIZE_PX, 600.0, 600.0, 320.0, 240.0)
BENT = RawCamera(
    *SIZE_PX, 610.0, 608.0, 322.0, 238.0, LensModel.PLUMB_BOB, (-0.2, 0.05, 0.001, -0.001)
)
ASIDE = np.array([-0.2, 0.0, 0.0])
IMAGE = np.random.default_rng(5).integers(0, 256, SIZE_PX[::-1], dtype=np.uint8)


def projections(focal_px: float = 600.0, baseline_m: float = 0.2) -> tuple[Float64, Float64]:
    P = np.array([[focal_px, 0, 320, 0], [0, focal_px, 240, 0], [0, 0, 1, 0.0]])
    right = P.copy()
    right[0, 3] = -focal_px * baseline_m
    return P, right


def test_a_pair_that_is_rectified_stays_as_it_is() -> None:
    found = rectify_by_pose(PINHOLE, PINHOLE, np.eye(3), ASIDE, "test")
    assert found.rectifier is None
    camera = found.camera
    assert (camera.focal_px, camera.cx_px, camera.cy_px) == (600.0, 320.0, 240.0)
    assert camera.baseline_m == pytest.approx(0.2, abs=1e-15)
    assert (found.R_rect_left == np.eye(3)).all()
    given_too = rectify_by_projections(
        PINHOLE, PINHOLE, (np.eye(3), np.eye(3)), projections(), "test"
    )
    assert given_too == (camera, None, given_too.R_rect_left)


def test_principal_points_that_differ_along_the_row_need_no_rectifying() -> None:
    right = RawCamera(*SIZE_PX, 600.0, 600.0, 312.0, 240.0)
    found = rectify_by_pose(PINHOLE, right, np.eye(3), ASIDE, "test")
    assert found.rectifier is None
    assert found.camera.disparity_offset_px == 8.0


def test_a_map_that_moves_less_than_a_grey_value_is_none() -> None:
    turned = turn(0, 0, 1e-5)  # 7e-5 px at the corner
    found = rectify_by_projections(PINHOLE, PINHOLE, (turned, np.eye(3)), projections(), "test")
    assert found.rectifier is None
    turned = turn(0, 0, 1e-3)
    found = rectify_by_projections(PINHOLE, PINHOLE, (turned, np.eye(3)), projections(), "test")
    assert found.rectifier is not None


@pytest.mark.parametrize("side", [0, 1])
def test_either_image_that_must_be_moved_is_enough(side: int) -> None:
    cameras = [PINHOLE, PINHOLE]
    cameras[side] = BENT
    found = rectify_by_projections(*cameras, (np.eye(3), np.eye(3)), projections(), "test")
    assert found.rectifier is not None
    images = found.rectifier(IMAGE, IMAGE)
    assert (images[1 - side] == IMAGE).all()
    assert (images[side] != IMAGE).mean() > 0.9
    assert all(image.shape == IMAGE.shape and image.dtype == np.uint8 for image in images)


def test_matrices_that_are_given_are_those_that_are_used() -> None:
    R = turn(0.4, -0.7, 0.5)
    pair = Stereo(BENT, BENT, R, -R @ np.array([0.2, 0.002, -0.003]))
    own = rectify_by_pose(*pair, "test")
    # The same rows by another rectification: turned about the baseline, of another focal length.
    about = turn(1.0, 0.0, 0.0)
    rotations = about @ own.R_rect_left, about @ own.R_rect_left @ R.T
    baseline_m = float(np.linalg.norm(pair.T))
    P = projections(580.0, baseline_m)
    found = rectify_by_projections(BENT, BENT, rotations, P, "test")
    assert (found.R_rect_left == rotations[0]).all()
    assert found.camera.focal_px == 580.0
    assert miss_px(pair, found).max() < 0.02


def test_a_fisheye_of_110_degrees() -> None:
    lens = RawCamera(
        *SIZE_PX, 330.0, 330.0, 318.0, 243.0, LensModel.EQUIDISTANT, (0.02, -0.01, 0.004, -0.001)
    )
    R = turn(0.5, 1.0, -0.6)
    pair = Stereo(lens, lens, R, -R @ np.array([0.15, 0.001, 0.002]))
    found = rectify_by_pose(*pair, "test")
    missed = miss_px(pair, found)
    assert len(missed) >= 50
    assert missed.max() < 0.02


def test_no_rectified_pixel_is_empty() -> None:
    white = np.full(SIZE_PX[::-1], 255, dtype=np.uint8)
    found = rectify_by_pose(BENT, BENT, turn(0.5, 1.0, 0.5), ASIDE, "test")
    assert found.rectifier is not None
    for image in found.rectifier(white, white):
        assert image[8:-8, 8:-8].min() == 255


def test_threads_share_a_rectifier() -> None:
    found = rectify_by_pose(BENT, PINHOLE, turn(0.5, 1.0, 0.5), ASIDE, "test")
    other = rectify_by_pose(BENT, PINHOLE, turn(0.5, 1.0, 0.5), ASIDE, "test")
    assert found.rectifier is not None
    assert other.rectifier is not None
    expected = other.rectifier(IMAGE, IMAGE)
    results: list[bool] = []

    def work() -> None:
        for _ in range(5):
            left, right = found.rectifier(IMAGE, IMAGE)  # type: ignore[misc]
            results.append(bool((left == expected[0]).all() and (right == expected[1]).all()))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [True] * 20


def test_a_huge_calibration_allocates_nothing_before_the_images_fit_it() -> None:
    huge = RawCamera(20_000, 20_000, 2e4, 2e4, 1e4, 1e4, LensModel.PLUMB_BOB, (-0.1, 0, 0, 0))
    P, right = projections()
    P[:2, :3] = right[:2, :3] = huge.K[:2]
    right[0, 3] = -2e4 * 0.2
    found = rectify_by_projections(huge, huge, (np.eye(3), np.eye(3)), (P, right), "test")
    assert found.rectifier is not None
    assert found.rectifier.raw_size_px == (20_000, 20_000)


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("plumb_bob", LensModel.PLUMB_BOB),
        ("radtan", LensModel.PLUMB_BOB),
        ("radial-tangential", LensModel.PLUMB_BOB),
        ("Rational_Polynomial", LensModel.RATIONAL),
        ("equidistant", LensModel.EQUIDISTANT),
        ("fisheye", LensModel.EQUIDISTANT),
        ("none", LensModel.NONE),
        ("", LensModel.NONE),
    ],
)
def test_models_by_the_names_that_others_give_them(name: str, model: LensModel) -> None:
    assert lens_model(name, "test") is model


def test_an_unknown_model_is_named() -> None:
    with pytest.raises(CalibrationError, match=r"^info\.yaml: the distortion model 'fov' is not"):
        lens_model("fov", "info.yaml")


def camera(**changes: object) -> RawCamera:
    arguments: dict[str, object] = {
        "size_px": SIZE_PX,
        "K": [[600, 0, 320], [0, 600, 240], [0, 0, 1]],
        "distortion": [-0.1, 0, 0, 0, 0],
        "model": LensModel.PLUMB_BOB,
        "source": "info.yaml",
    }
    return raw_camera(**{**arguments, **changes})  # type: ignore[arg-type]


def test_zero_coefficients_are_no_distortion_but_for_a_fisheye() -> None:
    assert camera(distortion=[0.0] * 5).model is LensModel.NONE
    assert camera(distortion=[]).distortion == ()
    fisheye = camera(distortion=[0.0] * 4, model=LensModel.EQUIDISTANT)
    assert fisheye.model is LensModel.EQUIDISTANT


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"distortion": [0.1]}, "plumb_bob has 4 or 5 coefficients, not 1"),
        ({"model": LensModel.RATIONAL}, "rational has 8 or 12 or 14 coefficients, not 5"),
        ({"model": LensModel.EQUIDISTANT}, "equidistant has 4 coefficients, not 5"),
        ({"model": LensModel.NONE}, "none has 0 coefficients, not 5"),
        ({"distortion": [1e5, 0, 0, 0, 0]}, "are those of no lens"),
        ({"distortion": [math.nan] * 5}, "are not finite"),
        ({"distortion": [1e300] * 5}, "are not finite, or huge"),
        ({"K": [[math.inf, 0, 1], [0, 1, 1], [0, 0, 1]]}, "are not finite"),
        ({"K": np.zeros((3, 3))}, r"K\[0\] = 0 means that the camera was never calibrated"),
        ({"K": [[600, 9, 320], [0, 600, 240], [0, 0, 1]]}, "have a skew of 9"),
        ({"K": [[-600, 0, 320], [0, 600, 240], [0, 0, 1]]}, "fx = -600.0 px with the principal"),
        ({"K": [[600, 0, 320], [0, 6e6, 240], [0, 0, 1]]}, "fy = 6000000.0 px"),
        ({"K": [[600, 0, 320], [0, 600, 9000], [0, 0, 1]]}, "cy = 9000.0 px does not fit"),
        ({"size_px": (0, 480)}, "images of 0 x 480 px, which no camera makes"),
        ({"size_px": (640, 10**9)}, "images of 640 x 1000000000 px"),
    ],
)
def test_a_camera_that_cannot_be(changes: dict[str, object], message: str) -> None:
    with pytest.raises(CalibrationError, match=rf"^info\.yaml: [^\n]*{message}"):
        camera(**changes)


FISHEYE = RawCamera(*SIZE_PX, 600.0, 600.0, 320.0, 240.0, LensModel.EQUIDISTANT, (0.0,) * 4)
NO_ROTATION = np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T": [0.2, 0, 0]}, r"right camera is 0\.2 m to the left of the left one; swap"),
        ({"T": [0, -0.2, 0]}, r"0\.2 m below and .* only pairs side by side"),
        ({"T": [0, 0, -0.2]}, r"0\.2 m ahead of it; only pairs side by side"),
        ({"T": [-200, 0, 0]}, r"\[-200\.0, 0\.0, 0\.0\] m apart, which is outside"),
        ({"T": [0, 0, 0]}, "m apart, which is outside"),
        ({"T": [math.nan, 0, 0]}, "m apart, which is outside"),
        ({"T": [1e300, 1e300, 0]}, "m apart, which is outside"),
        ({"R": NO_ROTATION}, "rotation between the cameras is no rotation"),
        ({"R": np.full((3, 3), 1e300)}, "rotation between the cameras is no rotation"),
        ({"R": np.full((3, 3), math.nan)}, "rotation between the cameras is no rotation"),
        ({"R": 2 * np.eye(3)}, "rotation between the cameras is no rotation"),
        ({"R": turn(0, 0, 90)}, "turned by 90° against the other"),
        ({"right": FISHEYE}, "one lens is none, the other equidistant"),
        ({"right": RawCamera(320, 240, 300.0, 300.0, 160.0, 120.0)}, "both must be of one size"),
    ],
)
def test_cameras_whose_places_cannot_be(changes: dict[str, object], message: str) -> None:
    arguments = {"left": PINHOLE, "right": PINHOLE, "R": np.eye(3), "T": ASIDE}
    arguments |= {k: np.array(v) if isinstance(v, list) else v for k, v in changes.items()}
    with pytest.raises(CalibrationError, match=rf"^camchain\.yaml: [^\n]*{message}"):
        rectify_by_pose(**arguments, source="camchain.yaml")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rotations", "P", "message"),
    [
        ((NO_ROTATION, np.eye(3)), projections(), "rotation of the left camera is no rotation"),
        ((np.eye(3), np.zeros((3, 3))), projections(), "rotation of the right camera is no rot"),
        ((np.eye(3), np.eye(3)), projections(1e300), "this camera is not calibrated"),
        ((np.eye(3), np.eye(3)), projections(0.0), "this camera is not calibrated"),
        ((np.eye(3), np.eye(3)), projections(600, -0.2), r"baseline of -0\.2 m"),
        ((turn(0, 60, 0), np.eye(3)), projections(), "fills 0 % of the rectified one"),
        ((np.eye(3), turn(0, 180, 0)), projections(), "fills 0 % of the rectified one"),
        ((np.eye(3), np.eye(3)), projections(70.0), "fills . % of the rectified one"),
    ],
)
def test_matrices_that_do_not_rectify_these_cameras(
    rotations: tuple[Float64, Float64], P: tuple[Float64, Float64], message: str
) -> None:
    with pytest.raises(CalibrationError, match=rf"^info\.yaml: [^\n]*{message}"):
        rectify_by_projections(BENT, BENT, rotations, P, "info.yaml")


def test_a_vertical_pair_has_no_common_rows() -> None:
    P, right = projections()
    right[:2, 3] = 0.0, right[0, 3]
    with pytest.raises(CalibrationError, match=r"do not share focal length and rows"):
        camera_from_projections(P, right, SIZE_PX, "info.yaml")


def test_a_tilted_sensor_of_14_coefficients_is_projected_as_opencv_does() -> None:
    D = (0.05, 0.01, 0.001, 0.002, 0.0, 0.02, 0.01, 0.0, 1e-3, 0.0, -1e-3, 0.0, 0.02, -0.01)
    lens = RawCamera(*SIZE_PX, 600.0, 600.0, 320.0, 240.0, LensModel.RATIONAL, D)
    found = rectify_by_pose(lens, lens, np.eye(3), ASIDE, "test")
    pixels = np.array([[100.0, 80.0], [320.0, 240.0], [500.0, 400.0]])
    camera = found.camera
    rays = (pixels - (camera.cx_px, camera.cy_px)) / camera.focal_px
    directions = np.column_stack([rays, np.ones(3)]) @ found.R_rect_left
    raw, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), lens.K, np.array(D))
    assert np.abs(between(sources(found, 0), pixels) - raw.reshape(-1, 2)).max() < 0.02


def test_the_rotation_and_baseline_that_are_published_for_euroc() -> None:
    """Of its first camera, as OpenCV's stereoRectify found them once and programs carry them."""
    T_body_left = np.array(
        [
            [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975],
            [0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768],
            [-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    T_body_right = np.array(
        [
            [0.0125552670891, -0.999755099723, 0.0182237714554, -0.0198435579556],
            [0.999598781151, 0.0130119051815, 0.0251588363115, 0.0453689425024],
            [-0.0253898008918, 0.0179005838253, 0.999517347078, 0.00786212447038],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    lens = LensModel.PLUMB_BOB
    left = RawCamera(
        *(752, 480, 458.654, 457.296, 367.215, 248.375, lens),
        (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05),
    )
    right = RawCamera(
        *(752, 480, 457.587, 456.134, 379.999, 255.238, lens),
        (-0.28368365, 0.07451284, -0.00010473, -3.55590700e-05),
    )
    T = np.linalg.inv(T_body_right) @ T_body_left
    found = rectify_by_pose(left, right, T[:3, :3], T[:3, 3], "euroc")
    published = [
        [0.999966347530033, -0.001422739138722922, 0.008079580483432283],
        [0.001365741834644127, 0.9999741760894847, 0.007055629199258132],
        [-0.008089410156878961, -0.007044357138835809, 0.9999424675829176],
    ]
    assert np.abs(found.R_rect_left - published).max() < 1e-9
    assert found.camera.baseline_m == pytest.approx(47.90639384423901 / 435.2046959714599, rel=1e-9)
