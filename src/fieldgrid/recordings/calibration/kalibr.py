"""`camchain.yaml` of Kalibr: two raw pinholes, and where the second is seen from the first."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import LensModel, RawCamera, lens_model, raw_camera
from fieldgrid.perception import rectify_by_pose
from fieldgrid.recordings.calibration.calibrated import Calibration, rectified_here
from fieldgrid.recordings.calibration.yaml_text import listed, load_yaml, resolution, rows


def read_kalibr(path: Path, rectified: bool | None) -> Calibration:
    """The calibration in a file, cam0 being the left camera. It describes raw images."""
    document = load_yaml(path)
    entries = [document.get(name) for name in ("cam0", "cam1")]
    for name, entry in zip(("cam0", "cam1"), entries, strict=True):
        if not isinstance(entry, dict):
            raise CalibrationError(f"{path} has no {name}; calibrate both cameras of the pair.")
    first, second = (entry for entry in entries if isinstance(entry, dict))
    left, right = pinhole(first, path, "cam0"), pinhole(second, path, "cam1")
    T = rows(second, "T_cn_cnm1", (4, 4), path)
    found = rectify_by_pose(left, right, T[:3, :3], T[:3, 3], str(path))
    if rectified and found.rectifier is not None:
        raise CalibrationError(
            f"{path} describes raw images, and recording.toml says rectified = true; give P1 and "
            "P2 of the rectified ones in stereo_opencv.yaml."
        )
    return rectified_here(found, path)


def pinhole(
    entry: Mapping[str, Any], path: Path, name: str, coefficients: str = "distortion_coeffs"
) -> RawCamera:
    """One camera as Kalibr and EuRoC describe it; `coefficients` is how the file calls those."""
    model = entry.get("camera_model")
    if model != "pinhole":
        raise CalibrationError(
            f"{path}: the camera_model of {name} is {str(model)[:40]!r}, and only pinhole is read; "
            "calibrate with pinhole-radtan or pinhole-equi."
        )
    fx, fy, cx, cy = listed(entry, "intrinsics", 4, path).tolist()
    K = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    lens = lens_model(str(entry.get("distortion_model")), f"{path}: {name}")
    D = () if lens is LensModel.NONE else listed(entry, coefficients, None, path)
    return raw_camera(resolution(entry, path), K, D, lens, f"{path}: {name}")
