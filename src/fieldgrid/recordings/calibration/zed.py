"""The factory calibration of a ZED, `SN*.conf`: a section for each camera and resolution, of newer
ones the lenses in [LEFT_DISTO] and [RIGHT_DISTO], and [STEREO] with how the cameras stand to each
other, in millimetres.

After what reads it, `examples/include/calibration.hpp` of github.com/stereolabs/zed-open-capture,
and what writes it, `stereo_calibration` of github.com/stereolabs/zedx-one-capture.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.recordings.calibration.calibrated import (
    CalibratedPair,
    Entries,
    pinhole_matrix,
    raw_pair,
)
from fieldgrid.recordings.files import read_text

_MAX_BYTES = 1 << 20
_NAMES = {
    **{(2208, 1242): "2K", (1920, 1080): "FHD", (1280, 720): "HD", (672, 376): "VGA"},
    **{(1920, 1200): "FHD1200", (960, 600): "SVGA", (3840, 2160): "4K", (3200, 1800): "QHDPLUS"},
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
    for side in ("LEFT", "RIGHT"):
        K = pinhole_matrix(*numbers(f"{side}_CAM_{name}", "FX FY CX CY"))
        if f"[{side}_DISTO] K1" in values:
            lens = numbers(f"{side}_DISTO", "K1 K2 P1 P2 K3 K4 K5 K6")
        else:
            lens = numbers(f"{side}_CAM_{name}", "K1 K2 P1 P2 K3", K3="0")
        cameras.append(Entries({"K": K, "D": lens}, path, size_px))
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(numbers("STEREO", f"RX_{name} CV_{name} RZ_{name}"))[0]
    # The sign of the baseline alone is turned round, as the maker's calibration writes it.
    T[:3, 3] = numbers("STEREO", "BASELINE TY TZ", TY="0", TZ="0") * (-1e-3, 1e-3, 1e-3)
    return raw_pair(path, cameras[0], cameras[1], T, is_factory=True)
