"""What the bits of a result depend on beside its inputs."""

from __future__ import annotations

from importlib.metadata import version

import cv2
import numpy as np

from fieldgrid.version import software_version


def versions() -> dict[str, str]:
    """The versions of this package and of those that it computes with, by name."""
    return {
        "fieldgrid": software_version(),
        "NumPy": np.__version__,
        "OpenCV": cv2.__version__,
        "Numba": version("numba"),
        "SciPy": version("scipy"),
    }
