"""The calibration that an OAK camera holds, as DepthAI writes it in JSON: each camera by its
socket, with its place relative to another one in centimetres.

After `CalibrationHandler` of luxonis/depthai-core and
https://docs.luxonis.com/software/depthai/calibration, "Calibration reader".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import CalibrationError, Float64, shortened
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Entries, raw_pair
from fieldgrid.recordings.calibration.yaml_text import numbers
from fieldgrid.recordings.readers.entries import read_document

_LEFT, _RIGHT = 1, 2  # sockets CAM_B and CAM_C
_FISHEYE = 1


def read_depthai(path: Path, size_px: tuple[int, int] | None) -> CalibratedPair:
    """The pair in a file for images of this (width, height), None for the size that was calibrated.
    It describes raw images, and the camera gives rectified ones, too."""
    try:
        document = read_document(path, "JSON", CalibrationError)
        cameras = dict(document["cameraData"])
        chosen = document.get("stereoRectificationData") or {}
        sockets = [chosen.get(f"{s}CameraSocket", -1) for s in ("left", "right")]
        if not set(sockets) <= cameras.keys() or sockets[0] == sockets[1]:
            sockets = [_LEFT, _RIGHT]
        left, right = (cameras[socket] for socket in sockets)
        sides = [_camera(camera, path, size_px) for camera in (left, right)]
        if left["extrinsics"]["toCameraSocket"] == sockets[1]:
            T = _place(left["extrinsics"], path)
        elif right["extrinsics"]["toCameraSocket"] == sockets[0]:
            T = np.asarray(np.linalg.inv(_place(right["extrinsics"], path)), dtype=np.float64)
        else:
            raise CalibrationError(
                f"{path} does not say how its left and right camera stand to each other; "
                "calibrate the pair again."
            )
    except CalibrationError:  # which says more
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as problem:
        raise CalibrationError(
            f"{path} is no calibration of an OAK camera with a left and a right one "
            f"({shortened(problem)}); "
            "write it again by CalibrationHandler.eepromToJsonFile."
        ) from problem
    return raw_pair(path, sides[0], sides[1], T, is_factory=True)


def _camera(camera: dict[str, Any], path: Path, size_px: tuple[int, int] | None) -> Entries:
    """A camera, for images that are scaled, and cut around their middle, to another size."""
    K = numbers(camera, "intrinsicMatrix", (3, 3), path)
    width, height = size_px or (camera["width"], camera["height"])
    scale = max(width / camera["width"], height / camera["height"])
    K[:2] *= scale
    K[0, 2] -= (scale * camera["width"] - width) / 2.0
    K[1, 2] -= (scale * camera["height"] - height) / 2.0
    is_fisheye = camera.get("cameraType") == _FISHEYE
    lens = camera["distortionCoeff"][: 4 if is_fisheye else None]
    return Entries(
        {"K": K, "D": lens},
        path,
        (width, height),
        model="fisheye" if is_fisheye else None,
    )


def _place(extrinsics: dict[str, Any], path: Path) -> Float64:
    """From the camera to that of its toCameraSocket, metres."""
    T = np.eye(4)
    T[:3, :3] = numbers(extrinsics, "rotationMatrix", (3, 3), path)
    T[:3, 3] = [float(extrinsics["translation"][axis]) / 100.0 for axis in "xyz"]
    return T
