"""OpenCV's stereo calibration: K1 D1 K2 D2 R T R1 R2 P1 P2 in `stereo_opencv.yaml`, or in the two
files of its own program, with M1 and M2 for K1 and K2 and without the size of the images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fieldgrid.core import CalibrationError
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Entries
from fieldgrid.recordings.calibration.yaml_text import image_size, load_yaml, numbers

_MOST_ASIDE = 0.2
"""Of a side of an image, how far the middle of a lens may be from that of the image."""


def read_opencv(path: Path, size_px: tuple[int, int] | None = None) -> CalibratedPair:
    """The pair in a file, or in that of the lenses (`intrinsics.yml`) and `extrinsics.yml` beside
    it. `size_px` is the (width, height) of the images, where the file does not say it."""
    document = load_yaml(path)
    lens = "M" if "M1" in document and "K1" not in document else "K"
    places = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    # A file with P2 is whole; without it, what is missing is in the other one.
    apart = places != path and "R" not in document
    if apart and (places.exists() or "P2" not in document):
        document |= load_yaml(places)
        path = path.with_name(f"{path.name} with {places.name}")
    model = str(document["distortion_model"]) if "distortion_model" in document else None
    notes: tuple[str, ...] = ()
    if size_px is None or {"image_width", "image_height"} & document.keys():
        size_px = image_size(document, path)
    else:
        middle_px = numbers(document, f"{lens}1", (3, 3), path)[:2, 2]
        if (np.abs(middle_px / size_px - 0.5) > _MOST_ASIDE).any():
            raise CalibrationError(
                f"{path} does not say the size of its images, and the middle of the lens, "
                f"{middle_px[0]:.0f}, {middle_px[1]:.0f} px, is not that of images of {size_px[0]} "
                f"x {size_px[1]} px; add image_width and image_height, or calibrate with such "
                "images."
            )
        notes = (
            f"{path.name} does not say the size of its images; that of the first one is taken, "
            f"{size_px[0]} x {size_px[1]} px.",
        )
    left, right = (
        Entries(
            document, path, size_px, {key: f"{key}{n}" for key in "DRP"} | {"K": lens + n}, model
        )
        for n in "12"
    )
    return CalibratedPair(path, left, right, Entries(document, path), notes=notes)
