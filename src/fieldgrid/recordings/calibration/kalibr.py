"""`camchain.yaml` of Kalibr: two raw pinholes, and where the second is seen from the first."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fieldgrid.core import CalibrationError, quoted
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Entries, data, raw_pair
from fieldgrid.recordings.calibration.yaml_text import listed, load_yaml, resolution, rows


def read_kalibr(path: Path) -> CalibratedPair:
    """The pair in a file, cam0 being the left camera. It describes raw images."""
    document = load_yaml(path)
    for name in ("cam0", "cam1"):
        if not isinstance(document.get(name), dict):
            raise CalibrationError(f"{path} has no {name}; calibrate both cameras of the pair.")
    left, right = (pinhole(document[name], path, name) for name in ("cam0", "cam1"))
    return raw_pair(path, left, right, rows(document["cam1"], "T_cn_cnm1", (4, 4), path))


def pinhole(
    entry: Mapping[str, Any], path: Path, name: str, coefficients: str = "distortion_coeffs"
) -> Entries:
    """One camera as Kalibr and EuRoC describe it; `coefficients` is how the file calls those."""
    kind = entry.get("camera_model")
    if kind != "pinhole":
        raise CalibrationError(
            f"{path}: the camera_model of {name} is {quoted(kind)}, and only pinhole is read; "
            "calibrate with pinhole-radtan or pinhole-equi."
        )
    fx, fy, cx, cy = listed(entry, "intrinsics", 4, path).tolist()
    model = str(entry.get("distortion_model"))
    D = () if model == "none" else listed(entry, coefficients, None, path)
    document = {"K": data([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]), "D": data(D)}
    return Entries(document, Path(f"{path}: {name}"), resolution(entry, path), model=model)
