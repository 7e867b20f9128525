"""One model of a stereo pair for all dialects of calibrations, and the camera that it comes to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.geometry import LensModel, RawCamera, StereoCamera, lens_model, raw_camera
from fieldgrid.perception import (
    Rectification,
    Rectifier,
    camera_from_projections,
    rectify_by_pose,
    rectify_by_projections,
)
from fieldgrid.recordings.calibration.yaml_text import numbers

_BY_COUNT = {
    **{0: LensModel.NONE, 5: LensModel.PLUMB_BOB},
    **dict.fromkeys((8, 12, 14), LensModel.RATIONAL),
}
"""OpenCV's models, which its files do not name; 4 coefficients can be of two."""

_SHAPES = {"K": (3, 3), "D": None, "R": (3, 3), "T": (3, 1), "P": (3, 4)}
_SAME = 1e-6


class Calibration(NamedTuple):
    """The rectified camera that calibration files describe, remarks on them, and how raw images
    are rectified: None where they are taken as they are. `R_rect_left` turns directions of the
    raw left camera into the rectified camera's frame."""

    camera: StereoCamera
    notes: tuple[str, ...] = ()
    rectifier: Rectifier | None = None
    R_rect_left: Float64 = np.eye(3)


class Entries(NamedTuple):
    """The matrices of one camera, K, D, R and P (or R and T between two), as a document has them,
    each read when it is asked for, and the size of its images. `names` are what it calls them,
    where that is something else; `model` is what it calls the lens, None for a dialect that tells
    it by the count of D."""

    document: Mapping[str, Any]
    path: Path
    size_px: tuple[int, int] = (0, 0)
    names: Mapping[str, str] = {}
    model: str | None = None

    def has(self, key: str) -> bool:
        """Whether there is such a matrix."""
        return self.names.get(key, key) in self.document

    def get(self, key: str) -> Float64:
        """The matrix; CalibrationError for one that is missing or has another shape."""
        return numbers(self.document, self.names.get(key, key), _SHAPES[key], self.path)

    def camera(self) -> RawCamera:
        """The camera behind its lens."""
        K, D = self.get("K"), self.get("D")
        if self.model is not None:
            model = lens_model(self.model, str(self.path))
        elif D.size in _BY_COUNT:
            model = _BY_COUNT[D.size]
        else:
            raise CalibrationError(
                f"{self.path} has {D.size} distortion coefficients and does not name their model; "
                "add a line distortion_model: plumb_bob, rational or fisheye."
            )
        return raw_camera(self.size_px, K, D, model, str(self.path))


def pinhole_matrix(fx: float, fy: float, cx: float, cy: float) -> Float64:
    """The matrix K of a camera, pixels."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


class CalibratedPair(NamedTuple):
    """What files say of a stereo pair, whichever their dialect: both cameras, and R and T from the
    left to the right one (metres). `is_raw` tells a dialect that describes raw images, `is_factory`
    one that does so whatever images the camera delivers."""

    path: Path
    left: Entries
    right: Entries
    between: Entries
    is_raw: bool = False
    is_factory: bool = False
    notes: tuple[str, ...] = ()

    def calibration(self, rectified: bool | None) -> Calibration:
        """The calibration of images that are `rectified`, or not; where nobody says it, they are
        where the files say how to rectify, or know of nothing that rectifying would change."""
        sides = left, right = self.left, self.right
        if left.size_px != right.size_px:
            raise CalibrationError(
                f"{left.path} is for images of {left.size_px} px, {right.path} for "
                f"{right.size_px} px; both must be of one size."
            )
        turns = [one.get("R") for one in (*sides, self.between) if one.has("R")]
        lenses = [side.get("D") for side in sides if side.has("D")]
        turned = any(np.abs(turn - np.eye(3)).max() > _SAME for turn in turns)
        straight = not turned and not any(lens.any() for lens in lenses)
        projected = any(side.has("P") for side in sides)
        if self.is_factory and rectified is None:
            raise CalibrationError(
                f"{self.path} is of raw images, and the camera gives rectified ones, too; add "
                "[images] rectified = false to recording.toml if these are raw, else put P1 and P2 "
                "of the rectified ones into stereo_opencv.yaml."
            )
        if rectified is False or self.is_raw or not (straight or projected):
            found = self._rectification()
            if found.rectifier is None:
                return Calibration(found.camera, self.notes)
            if rectified:
                raise CalibrationError(
                    f"{self.path} describes raw images, and recording.toml says rectified = true; "
                    "give P1 and P2 of the rectified ones in stereo_opencv.yaml, or set rectified "
                    "= false."
                )
            note = f"The images are raw, and rectified by {self.path.name}."
            return Calibration(
                found.camera, (note, *self.notes), found.rectifier, found.R_rect_left
            )
        if projected:
            P_left, P_right = (side.get("P") for side in sides)
        else:
            P_left, P_right = (np.hstack([side.get("K"), np.zeros((3, 1))]) for side in sides)
            P_right[:, 3:] = P_right[:, :3] @ self.between.get("T")
        camera = camera_from_projections(P_left, P_right, left.size_px, str(right.path))
        if straight or rectified:
            return Calibration(camera, self.notes)
        note = (
            f"{self.path.name} describes how to rectify; the images are taken as rectified already;"
            " if they are raw, say so in recording.toml: [images] rectified = false."
        )
        return Calibration(camera, (note, *self.notes))

    def _rectification(self) -> Rectification:
        left, right, source = self.left, self.right, str(self.between.path)
        cameras = left.camera(), right.camera()
        if any(side.has(key) for side in (left, right) for key in "RP"):
            turns, projections = ((left.get(key), right.get(key)) for key in "RP")
            return rectify_by_projections(*cameras, turns, projections, source)
        return rectify_by_pose(*cameras, self.between.get("R"), self.between.get("T"), source)


def raw_pair(
    path: Path, left: Entries, right: Entries, T: Float64, *, is_factory: bool = False
) -> CalibratedPair:
    """Two raw cameras, of which `T` [4, 4] takes points of the left one's frame to the right's."""
    between = Entries({"R": T[:3, :3], "T": T[:3, 3]}, path)
    return CalibratedPair(path, left, right, between, is_raw=True, is_factory=is_factory)
