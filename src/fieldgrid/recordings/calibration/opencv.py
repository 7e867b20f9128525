"""OpenCV's stereo calibration: K1 D1 K2 D2 R T R1 R2 P1 P2 in `stereo_opencv.yaml`, or in the two
files of its own program, with M1 and M2 for K1 and K2 and without the size of the images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import LensModel, RawCamera, lens_model, raw_camera
from fieldgrid.perception import (
    Rectification,
    camera_from_projections,
    rectify_by_pose,
    rectify_by_projections,
)
from fieldgrid.recordings.calibration.calibrated import (
    Calibration,
    rectified_here,
    taken_as_rectified,
)
from fieldgrid.recordings.calibration.yaml_text import image_size, load_yaml, matrix

_MOST_ASIDE = 0.2
"""Of a side of an image, how far the middle of a lens may be from that of the image."""

_RECTIFYING = ("R1", "R2", "P1", "P2")
_BY_COUNT = {
    **{0: LensModel.NONE, 5: LensModel.PLUMB_BOB},
    **dict.fromkeys((8, 12, 14), LensModel.RATIONAL),
}


def read_opencv(
    path: Path,
    rectified: bool | None,
    size_px: tuple[int, int] | None = None,
    extrinsics: Path | None = None,
) -> Calibration:
    """The calibration in a file, or in that of the lenses and in `extrinsics`.

    Where nobody says whether images are `rectified`, they are when the file has P1 and P2, and
    when it knows of nothing that rectifying would change. `size_px` is the (width, height) of the
    images, where the file does not say it.
    """
    document = load_yaml(path)
    for theirs, ours in (("M1", "K1"), ("M2", "K2")):
        if theirs in document:
            document.setdefault(ours, document[theirs])
    if extrinsics is not None:
        document |= load_yaml(extrinsics)
        path = path.with_name(f"{path.name} with {extrinsics.name}")
    if size_px is None or {"image_width", "image_height"} & document.keys():
        return _calibration(document, path, rectified)
    width, height = size_px
    middle_px = matrix(document, "K1", (3, 3), path)[:2, 2]
    if (np.abs(middle_px / size_px - 0.5) > _MOST_ASIDE).any():
        raise CalibrationError(
            f"{path} does not say the size of its images, and the middle of the lens, "
            f"{middle_px[0]:.0f}, {middle_px[1]:.0f} px, is not that of images of {size_px[0]} x "
            f"{size_px[1]} px; add image_width and image_height, or calibrate with such images."
        )
    document |= {"image_width": width, "image_height": height}
    note = (
        f"{path.name} does not say the size of its images; that of the first one is taken, "
        f"{width} x {height} px."
    )
    found = _calibration(document, path, rectified)
    return found._replace(notes=(*found.notes, note))


def _calibration(document: Mapping[str, Any], path: Path, rectified: bool | None) -> Calibration:
    turns = [matrix(document, k, (3, 3), path) for k in ("R", "R1", "R2") if k in document]
    lenses = [matrix(document, k, None, path) for k in ("D1", "D2") if k in document]
    turned = any(np.abs(turn - np.eye(3)).max() > 1e-6 for turn in turns)
    straight = not turned and all(not lens.any() for lens in lenses)
    projected = "P1" in document or "P2" in document
    if rectified is False or (rectified is None and not straight and not projected):
        return rectified_here(_rectification(document, path), path)
    size_px = image_size(document, path)
    if projected:
        left, right = (matrix(document, key, (3, 4), path) for key in ("P1", "P2"))
        camera = camera_from_projections(left, right, size_px, str(path))
        told = straight or rectified is True
        return Calibration(camera, () if told else (taken_as_rectified(path),))
    if not straight:
        raise CalibrationError(
            f"{path} has lens distortion or a rotation between the cameras, and no P1 and P2 of "
            "rectified images; add them, or set rectified = false for raw images."
        )
    k_left, k_right = (matrix(document, key, (3, 3), path) for key in ("K1", "K2"))
    shift = matrix(document, "T", (3, 1), path)
    left, right = np.hstack([k_left, np.zeros((3, 1))]), np.hstack([k_right, k_right @ shift])
    return Calibration(camera_from_projections(left, right, size_px, str(path)))


def _rectification(document: Mapping[str, Any], path: Path) -> Rectification:
    left, right = (_camera(document, number, path) for number in "12")
    if any(key in document for key in _RECTIFYING):
        rotations = [matrix(document, key, (3, 3), path) for key in ("R1", "R2")]
        projections = [matrix(document, key, (3, 4), path) for key in ("P1", "P2")]
        return rectify_by_projections(
            left,
            right,
            (rotations[0], rotations[1]),
            (projections[0], projections[1]),
            str(path),
        )
    R, T = matrix(document, "R", (3, 3), path), matrix(document, "T", (3, 1), path)
    return rectify_by_pose(left, right, R, T, str(path))


def _camera(document: Mapping[str, Any], number: str, path: Path) -> RawCamera:
    K = matrix(document, f"K{number}", (3, 3), path)
    D = matrix(document, f"D{number}", None, path)
    return raw_camera(image_size(document, path), K, D, _model(document, D.size, path), str(path))


def _model(document: Mapping[str, Any], count: int, path: Path) -> LensModel:
    """OpenCV's files do not name the model; 4 coefficients can be of two."""
    if "distortion_model" in document:
        return lens_model(str(document["distortion_model"]), str(path))
    if count not in _BY_COUNT:
        raise CalibrationError(
            f"{path} has {count} distortion coefficients and does not name their model; add a line "
            "distortion_model: plumb_bob, rational or fisheye."
        )
    return _BY_COUNT[count]
