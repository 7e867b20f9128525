"""`camchain.yaml` of Kalibr and `sensor.yaml` of EuRoC (ASL) folders: raw pinholes, and where they
are: the second seen from the first, or each on the body.

A sensor's T_BS takes points from its frame to that of the body, which is the IMU as a rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import CalibrationError, Float64, quoted
from fieldgrid.perception import is_rotation
from fieldgrid.recordings.calibration.calibrated import (
    CalibratedPair,
    Entries,
    pinhole_matrix,
    raw_pair,
)
from fieldgrid.recordings.calibration.yaml_text import image_size, load_yaml, numbers

_MAX_AWAY_M = 100.0


def read_kalibr(path: Path) -> CalibratedPair:
    """The pair in a file, cam0 being the left camera. It describes raw images."""
    document = load_yaml(path)
    for name in ("cam0", "cam1"):
        if not isinstance(document.get(name), dict):
            raise CalibrationError(f"{path} has no {name}; calibrate both cameras of the pair.")
    left, right = (_pinhole(document[name], path, name) for name in ("cam0", "cam1"))
    return raw_pair(path, left, right, numbers(document["cam1"], "T_cn_cnm1", (4, 4), path))


def read_euroc(left: Path, right: Path) -> CalibratedPair:
    """The pair of two files. It describes raw images."""
    coefficients = "distortion_coefficients"
    cameras = [
        _pinhole(load_yaml(path), path, path.parent.name, coefficients) for path in (left, right)
    ]
    T = np.linalg.inv(body_pose(right)) @ body_pose(left)
    return raw_pair(left.parents[1], cameras[0], cameras[1], T)


def body_pose(path: Path) -> Float64:
    """T_BS, once it is sure to be a rigid motion."""
    T = numbers(load_yaml(path), "T_BS", (4, 4), path)
    is_near = bool((np.abs(T[:3, 3]) < _MAX_AWAY_M).all())
    if not (is_rotation(T[:3, :3]) and is_near and (T[3] == (0, 0, 0, 1)).all()):
        raise CalibrationError(f"{path}: T_BS is no rigid transformation; restore the file.")
    return T


def _pinhole(
    entry: Mapping[str, Any], path: Path, name: str, coefficients: str = "distortion_coeffs"
) -> Entries:
    """One camera; `coefficients` is how its file calls those of the lens."""
    kind = entry.get("camera_model")
    if kind != "pinhole":
        raise CalibrationError(
            f"{path}: the camera_model of {name} is {quoted(str(kind))}, and only pinhole is read; "
            "calibrate with pinhole-radtan or pinhole-equi."
        )
    K = pinhole_matrix(*numbers(entry, "intrinsics", (4,), path))
    model = str(entry.get("distortion_model"))
    D = () if model == "none" else numbers(entry, coefficients, None, path)
    whose = Path(f"{path}: {name}")
    return Entries({"K": K, "D": D}, whose, image_size(entry, path), model=model)
