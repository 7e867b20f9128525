"""The factory calibration of a ZED, `SN*.conf`: a section for each camera and resolution, and
[STEREO] with where the right camera is, in millimetres.

After `examples/include/calibration.hpp` of github.com/stereolabs/zed-open-capture.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Entries, data, raw_pair
from fieldgrid.recordings.files import read_text

_MAX_BYTES = 1 << 20
_NAMES = {
    **{(2208, 1242): "2K", (1920, 1080): "FHD", (1280, 720): "HD", (672, 376): "VGA"},
    **{(1920, 1200): "FHD1200", (960, 600): "SVGA"},
}
"""How sections call the (width, height) of an image."""


def read_zed(path: Path, size_px: tuple[int, int] | None) -> CalibratedPair:
    """The pair in a file for images of this (width, height). It describes raw images, and the
    camera's SDK exports rectified ones."""
    values: dict[str, str] = {}
    section = ""
    for line in read_text(path, _MAX_BYTES, CalibrationError).upper().splitlines():
        if line.startswith("["):
            section = line.strip(" []")
        key, _, value = line.partition("=")
        values[f"[{section}] {key.strip()}"] = value.strip()
    if size_px not in _NAMES:
        sizes = ", ".join(f"{width} x {height}" for width, height in _NAMES)
        raise CalibrationError(
            f"{path} is of images of {sizes} px, and these have {size_px or 'an unknown size'}; "
            "write the calibration of these into stereo_opencv.yaml."
        )
    name = _NAMES[size_px]

    def numbers(section: str, keys: str, **usual: str) -> Float64:
        texts = [values.get(f"[{section}] {key}", usual.get(key, "")) for key in keys.split()]
        try:
            return np.array(texts, dtype=np.float64)
        except ValueError:
            raise CalibrationError(
                f"{path} lacks [{section}] with the numbers {keys}; download the file again."
            ) from None

    cameras = []
    for side in ("LEFT_CAM", "RIGHT_CAM"):
        fx, fy, cx, cy, *lens = numbers(f"{side}_{name}", "FX FY CX CY K1 K2 P1 P2 K3", K3="0")
        K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        cameras.append(Entries({"K": data(K), "D": data(lens)}, path, size_px))
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(numbers("STEREO", f"RX_{name} CV_{name} RZ_{name}"))[0]
    # Where the right camera is, while T takes points to its frame. TY and TZ may be of a size.
    aside = {f"{key}_{name}": values.get(f"[STEREO] {key}", "0") for key in ("TY", "TZ")}
    T[:3, 3] = -numbers("STEREO", " ".join(("BASELINE", *aside)), **aside) / 1000.0
    return raw_pair(path, cameras[0], cameras[1], T, is_factory=True)
