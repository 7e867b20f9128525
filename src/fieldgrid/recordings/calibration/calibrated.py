"""What the files of a calibration come to, whichever they are."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fieldgrid.geometry import StereoCamera
from fieldgrid.perception import Rectification, Rectifier


class Calibration(NamedTuple):
    """The rectified camera that calibration files describe, remarks on them, and how raw images
    are rectified: None where they are taken as they are."""

    camera: StereoCamera
    notes: tuple[str, ...] = ()
    rectifier: Rectifier | None = None


def rectified_here(found: Rectification, path: Path) -> Calibration:
    """The calibration of raw images."""
    if found.rectifier is None:
        return Calibration(found.camera)
    return Calibration(
        found.camera, (f"The images are raw, and rectified by {path.name}.",), found.rectifier
    )


def taken_as_rectified(path: Path) -> str:
    """A remark on images of which nobody says whether they are raw."""
    return (
        f"{path.name} describes how to rectify; the images are taken as rectified already; if they "
        "are raw, say so in recording.toml: [images] rectified = false."
    )
