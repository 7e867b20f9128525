"""Cameras as they are calibrated: a pinhole, a size and a model of how the lens bends rays.

Camera frames are optical: x right, y down, z forward. Pixel (0, 0) is the centre of the upper
left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.core import CalibrationError, Float64, quoted

SAME = 1e-3
"""Relative: two focal lengths, or two products f·b, that differ by less are one."""
_MAX_SIZE_PX = 20_000
MAX_NUMBER = 1e9


class LensModel(StrEnum):
    """How a lens bends rays."""

    NONE = "none"
    PLUMB_BOB = "plumb_bob"
    RATIONAL = "rational"
    EQUIDISTANT = "equidistant"


_NAMES = {
    **dict.fromkeys(("plumb_bob", "radtan", "radial_tangential"), LensModel.PLUMB_BOB),
    "brown_conrady": LensModel.PLUMB_BOB,
    **dict.fromkeys(("rational_polynomial", "rational", "thin_prism"), LensModel.RATIONAL),
    **dict.fromkeys(("equidistant", "fisheye", "kannala_brandt4"), LensModel.EQUIDISTANT),
    **dict.fromkeys(("none", ""), LensModel.NONE),
}
_COUNTS = {
    LensModel.NONE: (0,),
    LensModel.PLUMB_BOB: (4, 5),
    LensModel.RATIONAL: (8, 12, 14),
    LensModel.EQUIDISTANT: (4,),
}


def lens_model(name: str, source: str) -> LensModel:
    """The model by the name that ROS, Kalibr, EuRoC or OpenCV gives it.

    plumb_bob, radtan, radial-tangential, Brown Conrady; rational_polynomial, rational, thin_prism;
    equidistant, fisheye, kannala_brandt4; none or an empty name. CalibrationError for any other.
    """
    found = _NAMES.get(name.strip().lower().replace("-", "_").replace(" ", "_"))
    if found is None:
        raise CalibrationError(
            f"{source}: the distortion model {quoted(name)} is not known; calibrate with plumb_bob "
            "(radtan), rational_polynomial or equidistant."
        )
    return found


@dataclass(frozen=True, slots=True)
class RawCamera:
    """One camera as it is built: a pinhole behind a lens.

    `distortion` are OpenCV's coefficients in their order: of plumb_bob 4 or 5 (k1 k2 p1 p2 k3),
    of rational 8, 12 or 14, of equidistant 4, of none none.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    model: LensModel = LensModel.NONE
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (16 <= self.width_px <= _MAX_SIZE_PX and 16 <= self.height_px <= _MAX_SIZE_PX):
            raise CalibrationError(
                f"The calibration is for images of {self.width_px} x {self.height_px} px, which no "
                "camera makes; check the image size."
            )
        if len(self.distortion) not in _COUNTS[self.model]:
            raise CalibrationError(
                f"A lens model {self.model.value} has "
                f"{' or '.join(map(str, _COUNTS[self.model]))} coefficients, not "
                f"{len(self.distortion)}; correct the model or the coefficients."
            )
        # Strong wide-angle lenses have some tens; a k3 may reach hundreds.
        if not all(abs(value) < 1e4 for value in self.distortion):
            raise CalibrationError(
                f"The distortion coefficients {list(self.distortion)} are those of no lens; "
                "calibrate the camera again."
            )
        for focal_px, centre_px, size_px, axis in (
            (self.fx_px, self.cx_px, self.width_px, "x"),
            (self.fy_px, self.cy_px, self.height_px, "y"),
        ):
            # The same bounds as of a rectified camera, which refuses the sizes too.
            if not (0.1 < focal_px / size_px < 100.0 and -1 < centre_px / size_px < 2):
                raise CalibrationError(
                    f"A focal length f{axis} = {focal_px} px with the principal point c{axis} = "
                    f"{centre_px} px does not fit images of {self.width_px} x {self.height_px} px; "
                    "give the intrinsics of these images."
                )

    @property
    def K(self) -> Float64:
        """The intrinsic matrix, 3 x 3 px."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.width_px, self.height_px

    def project(self, directions: Float64) -> Float64:
        """Pixels [n, 2] of directions [n, 3] in the camera's frame, all with z > 0."""
        D = np.array(self.distortion)
        if self.model is LensModel.EQUIDISTANT:
            plane = directions[:, :2] / directions[:, 2:]
            bent = cv2.fisheye.distortPoints(plane[:, None], self.K, D)
        else:
            bent, _ = cv2.projectPoints(directions, np.zeros(3), np.zeros(3), self.K, D)
        return np.asarray(bent, dtype=np.float64).reshape(-1, 2)


def raw_camera(
    size_px: tuple[int, int],
    K: npt.ArrayLike,
    distortion: npt.ArrayLike,
    model: LensModel,
    source: str,
) -> RawCamera:
    """The camera with intrinsic matrix `K`, 3 x 3 px; `source` is what errors call it.

    Coefficients that are all 0, or absent, make it a camera without distortion; an equidistant
    lens bends rays even then.
    """
    matrix = np.asarray(K, dtype=np.float64).reshape(3, 3)
    values = np.asarray(distortion, dtype=np.float64).ravel()
    if not all((np.abs(numbers) < MAX_NUMBER).all() for numbers in (matrix, values)):
        raise CalibrationError(
            f"{source}: the intrinsics or distortion coefficients are not finite, or huge; "
            "calibrate again."
        )
    if matrix[0, 0] == 0.0:
        raise CalibrationError(
            f"{source}: K[0] = 0 means that the camera was never calibrated; calibrate it."
        )
    if abs(matrix[0, 1]) > SAME * abs(matrix[0, 0]):
        raise CalibrationError(
            f"{source}: the intrinsics have a skew of {matrix[0, 1]} px, which no camera of today "
            "has; correct the matrix, whose first row is fx, 0, cx."
        )
    if model is not LensModel.EQUIDISTANT and not values.any():
        model, values = LensModel.NONE, values[:0]
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    try:
        return RawCamera(*size_px, fx, fy, cx, cy, model, tuple(values.tolist()))
    except CalibrationError as problem:
        raise CalibrationError(f"{source}: {problem}") from problem
