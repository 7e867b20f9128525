"""`sensor.yaml` of EuRoC (ASL) folders: a raw pinhole, and where a sensor is on the body.

A sensor's T_BS takes points from its frame to that of the body, which is the IMU as a rule.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.perception import is_rotation
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, raw_pair
from fieldgrid.recordings.calibration.kalibr import pinhole
from fieldgrid.recordings.calibration.yaml_text import load_yaml, matrix

_MAX_AWAY_M = 100.0


def read_euroc(left: Path, right: Path) -> CalibratedPair:
    """The pair of two files."""
    cameras = [
        pinhole(load_yaml(path), path, path.parent.name, "distortion_coefficients")
        for path in (left, right)
    ]
    T = np.linalg.inv(body_pose(right)) @ body_pose(left)
    return raw_pair(left.parents[1], cameras[0], cameras[1], T)


def body_pose(path: Path) -> Float64:
    """T_BS, once it is sure to be a rigid motion."""
    T = matrix(load_yaml(path), "T_BS", (4, 4), path)
    is_near = bool((np.abs(T[:3, 3]) < _MAX_AWAY_M).all())
    if not (is_rotation(T[:3, :3]) and is_near and (T[3] == (0, 0, 0, 1)).all()):
        raise CalibrationError(f"{path}: T_BS is no rigid transformation; restore the file.")
    return T
