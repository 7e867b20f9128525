"""Raw stereo pairs to rectified ones: the two rotations that align the rows.

Camera frames are optical: x right, y down, z forward. Pixel (0, 0) is the centre of the upper
left pixel.
"""

from __future__ import annotations

import math
import threading
from typing import Any, NamedTuple, cast

import cv2
import numpy as np

from fieldgrid.core import CalibrationError, Float32, Float64, UInt8
from fieldgrid.geometry import MAX_NUMBER, SAME, LensModel, RawCamera, StereoCamera

_Maps = tuple[Float32, Float32]

_RECTIFY = "rectified images are required: rectify them and give the P1, P2 of that rectification"
_NOTHING_PX = 1e-3
"""A map that moves no pixel by more than this changes no grey value by more than a half."""
_SAMPLES = 33
_MIN_SEEN = 0.25
_MAX_TURN_DEG = 45.0


class View(NamedTuple):
    """One raw camera, and the rectified camera that its image is turned into."""

    camera: RawCamera
    R_rect_raw: Float64
    K_rect: Float64

    def sources_px(self, pixels: Float64) -> Float64:
        """Where in the raw image the rectified image's `pixels` [n, 2] are; NaN behind it."""
        rays = np.column_stack([pixels, np.ones(len(pixels))])
        rays = rays @ np.linalg.inv(self.K_rect).T @ self.R_rect_raw
        ahead = rays[:, 2] > 1e-6 * np.linalg.norm(rays, axis=1)
        found = np.full((len(pixels), 2), np.nan)
        if ahead.any():
            found[ahead] = self.camera.project(rays[ahead])
        return found

    def maps(self) -> _Maps:
        """For each rectified pixel its place in the raw image: columns, rows."""
        camera = self.camera
        make = (
            cv2.fisheye.initUndistortRectifyMap
            if camera.model is LensModel.EQUIDISTANT
            else cv2.initUndistortRectifyMap
        )
        D = np.array(camera.distortion)
        maps = make(camera.K, D, self.R_rect_raw, self.K_rect, camera.size_px, cv2.CV_32FC1)
        return cast(_Maps, maps)


class Rectifier:
    """Makes the rectified pair of a raw one (a `PairRectifier` of recordings).

    Safe to call from threads. The maps are made at the first call: a calibration that claims
    absurd sizes has been compared with the images by then.
    """

    def __init__(self, left: View, right: View) -> None:
        self._views = left, right
        self._maps: tuple[_Maps, _Maps] | None = None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        # The maps are large, and another process makes them as fast as it would read them.
        return Rectifier, self._views

    @property
    def raw_size_px(self) -> tuple[int, int]:
        """(width, height) of the raw images."""
        return self._views[0].camera.size_px

    def __call__(self, left: UInt8, right: UInt8) -> tuple[UInt8, UInt8]:
        """The rectified pair, of the same size; black where the raw images show nothing."""
        with self._lock:
            if self._maps is None:
                self._maps = self._views[0].maps(), self._views[1].maps()
            maps_left, maps_right = self._maps
        return _remapped(left, maps_left), _remapped(right, maps_right)


def _remapped(image: UInt8, maps: _Maps) -> UInt8:
    return cast(UInt8, cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))


class Rectification(NamedTuple):
    """The rectified camera, and how its pairs are made; None where the raw ones are rectified.

    `R_rect_left` turns directions of the raw left camera into the rectified camera's frame.
    """

    camera: StereoCamera
    rectifier: Rectifier | None
    R_rect_left: Float64


def rectify_by_projections(
    left: RawCamera,
    right: RawCamera,
    rotations: tuple[Float64, Float64],
    projections: tuple[Float64, Float64],
    source: str,
) -> Rectification:
    """Rectify as a calibration prescribes: R1, R2 (3 x 3) and P1, P2 (3 x 4 px), as in ROS's
    CameraInfo R and P of the left and the right camera.

    CalibrationError for matrices that do not make rectified pairs of these cameras.
    """
    _check_sizes(left, right, source)
    for name, rotation in zip(("left", "right"), rotations, strict=True):
        _check_rotation(rotation, f"the rectifying rotation of the {name} camera", source)
    camera = camera_from_projections(*projections, left.size_px, source)
    views = (
        View(left, rotations[0], np.ascontiguousarray(projections[0][:, :3])),
        View(right, rotations[1], np.ascontiguousarray(projections[1][:, :3])),
    )
    places = [_sampled(view, source) for view in views]
    rectifier = None if max(places) < _NOTHING_PX else Rectifier(*views)
    return Rectification(camera, rectifier, rotations[0])


def rectify_by_pose(
    left: RawCamera, right: RawCamera, R: Float64, T: Float64, source: str
) -> Rectification:
    """Rectify by where the cameras are: x_right = R · x_left + T, in metres.

    CalibrationError for cameras that are not side by side, the left one on the left. A pair that
    is rectified already stays as it is.
    """
    _check_sizes(left, right, source)
    _check_rotation(R, "the rotation between the cameras", source)
    T = np.asarray(T, dtype=np.float64).ravel()
    _check_places(R, T, source)
    # Whether two pinholes share orientation, rows and focal length as they are.
    bare = left.model is right.model is LensModel.NONE
    turned = float(np.abs(R - np.eye(3)).max()) * left.fx_px
    apart_px = np.array(
        [right.fx_px - left.fx_px, right.fy_px - left.fy_px, right.cy_px - left.cy_px]
    )
    aside_px = np.abs(T[1:]) / abs(T[0]) * max(left.size_px)
    if (
        bare
        and left.fx_px == left.fy_px
        and max(turned, np.abs(apart_px).max(), aside_px.max()) < _NOTHING_PX
    ):
        shift = np.array([[right.fx_px * T[0]], [0.0], [0.0]])
        projections = (np.hstack([left.K, np.zeros((3, 1))]), np.hstack([right.K, shift]))
        return rectify_by_projections(left, right, (np.eye(3), np.eye(3)), projections, source)
    fisheye = {camera.model is LensModel.EQUIDISTANT for camera in (left, right)}
    if len(fisheye) != 1:
        raise CalibrationError(
            f"{source}: one lens is {left.model.value}, the other {right.model.value}; calibrate "
            "both with one model."
        )
    rotations, projections = _aligned(left, right, R, T, source, *fisheye)
    return rectify_by_projections(left, right, rotations, projections, source)


def _aligned(
    left: RawCamera, right: RawCamera, R: Float64, T: Float64, source: str, fisheye: bool
) -> tuple[tuple[Float64, Float64], tuple[Float64, Float64]]:
    """R1 and R2, P1 and P2 of a common focal length at which no rectified pixel is empty."""
    D_left, D_right = np.array(left.distortion), np.array(right.distortion)
    cameras = (left.K, D_left, right.K, D_right, left.size_px, R, T.reshape(3, 1))
    try:
        if fisheye:
            found = cv2.fisheye.stereoRectify(*cameras, cv2.CALIB_ZERO_DISPARITY, balance=0.0)
        else:
            found = cv2.stereoRectify(*cameras, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.0)
    except cv2.error as problem:
        raise CalibrationError(
            f"{source}: the pair cannot be rectified ({problem.err}); calibrate it again."
        ) from problem
    matrices = [np.asarray(matrix, dtype=np.float64) for matrix in found[:4]]
    return (matrices[0], matrices[1]), (matrices[2], matrices[3])


def _check_sizes(left: RawCamera, right: RawCamera, source: str) -> None:
    if left.size_px != right.size_px:
        raise CalibrationError(
            f"{source}: the left camera has images of {left.width_px} x {left.height_px} px, the "
            f"right one {right.width_px} x {right.height_px} px; both must be of one size."
        )


def is_rotation(R: Float64) -> bool:
    """Whether a 3 x 3 matrix is a rotation, as well as calibrations are written."""
    bounded = bool((np.abs(R) < 2.0).all())  # which NaN is not
    return bounded and np.abs(R @ R.T - np.eye(3)).max() <= 1e-3 and bool(np.linalg.det(R) > 0.0)


def _check_rotation(R: Float64, what: str, source: str) -> None:
    if not is_rotation(R):
        raise CalibrationError(f"{source}: {what} is no rotation; restore the calibration.")


def _check_places(R: Float64, T: Float64, source: str) -> None:
    """Refuse cameras that no rows can be aligned of."""
    if not ((np.abs(T) <= 10.0).all() and 0.005 <= float(np.linalg.norm(T)) <= 10.0):
        raise CalibrationError(
            f"{source}: the cameras are {T.tolist()} m apart, which is outside 0.005..10 m; give "
            "the translation in metres."
        )
    turn_deg = math.degrees(math.acos(max(-1.0, min(1.0, (float(np.trace(R)) - 1.0) / 2.0))))
    if turn_deg > _MAX_TURN_DEG:
        raise CalibrationError(
            f"{source}: one camera is turned by {turn_deg:.0f}° against the other, beyond "
            f"{_MAX_TURN_DEG:.0f}°; check the rotation between them."
        )
    right_m, down_m, ahead_m = (-R.T @ T).tolist()  # of the right camera, seen from the left
    if abs(right_m) < max(abs(down_m), abs(ahead_m)):
        raise CalibrationError(
            f"{source}: the second camera is {right_m:g} m to the right of the first, {down_m:g} m "
            f"below and {ahead_m:g} m ahead of it; only pairs side by side can be used."
        )
    if right_m < 0.0:
        raise CalibrationError(
            f"{source}: the right camera is {-right_m:g} m to the left of the left one; swap left "
            "and right."
        )


def _sampled(view: View, source: str) -> float:
    """How far, in pixels, rectifying moves any pixel. CalibrationError where it shows nothing."""
    width, height = view.camera.size_px
    columns, rows = np.linspace(0, width - 1, _SAMPLES), np.linspace(0, height - 1, _SAMPLES)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    places = view.sources_px(pixels)
    with np.errstate(invalid="ignore"):
        seen = ((places >= -1.0) & (places <= (width, height))).all(axis=1)
    if seen.mean() < _MIN_SEEN:
        raise CalibrationError(
            f"{source}: the raw image fills {100 * seen.mean():.0f} % of the rectified one; the "
            "rotations, the intrinsics or the projection matrices are those of other cameras."
        )
    moved_px = np.abs(places - pixels)
    return math.inf if np.isnan(moved_px).any() else float(moved_px.max())


def camera_from_projections(
    left: Float64, right: Float64, size_px: tuple[int, int], source: str
) -> StereoCamera:
    """The camera of a rectified pair with projection matrices `left` and `right`, 3 x 4 px.

    `source` is what errors call the file. Both must share focal length and rows; the right
    camera's P[0, 3] less the left's is -f·b.
    """
    fx, fy = float(left[0, 0]), float(left[1, 1])
    if not (fx > 0.0 and all((np.abs(matrix) < MAX_NUMBER).all() for matrix in (left, right))):
        raise CalibrationError(
            f"{source}: a projection matrix starts with {fx}, so this camera is not calibrated; "
            "calibrate it."
        )
    if abs(fx - fy) > SAME * fx:
        raise CalibrationError(
            f"{source}: the focal lengths fx = {fx} and fy = {fy} px differ by more than 0.1 %; "
            f"{_RECTIFY}."
        )
    apart_px = np.abs(right[:2, :3] - left[:2, :3])
    apart_px[0, 2] = 0.0  # the principal points may differ along the row
    if apart_px.max() > SAME * fx or abs(right[1, 3] - left[1, 3]) > 0.01 * abs(right[0, 3]):
        raise CalibrationError(
            f"{source}: the two projection matrices do not share focal length and rows "
            f"({left.tolist()} and {right.tolist()}); {_RECTIFY}."
        )
    baseline_m = float(left[0, 3] - right[0, 3]) / fx
    cx, cx_right = float(left[0, 2]), float(right[0, 2])
    try:
        return StereoCamera(
            *size_px, fx, cx, float(left[1, 2]), baseline_m, None if cx == cx_right else cx_right
        )
    except CalibrationError as problem:
        raise CalibrationError(f"{source}: {problem}") from problem
