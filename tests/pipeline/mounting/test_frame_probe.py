"""What one frame shows; whole drives are in `test_estimate`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import CalibrationError
from fieldgrid.pipeline.mounting.frame_probe import FrameProbe
from fieldgrid.recordings import DepthFile, DepthFrame
from fieldgrid.recordings.frames.depth_files import DepthFormat
from tests.scenes import depth_rig


def test_depths_of_another_size_are_refused(tmp_path: Path) -> None:
    """Half as large they would show a ground of their own, half as far off the axis."""
    rig = depth_rig()
    size_px = (rig.sensor.width_px, rig.sensor.height_px)
    path = tmp_path / "1.npy"
    np.save(path, np.full((size_px[1] // 2, size_px[0] // 2), 3.0, dtype=np.float32))
    frame = DepthFrame("1", 1, DepthFile(path, DepthFormat("depth")), size_px)
    told = rf"1\.npy has {size_px[0] // 2} x {size_px[1] // 2} px, but the calibration is for"
    with pytest.raises(CalibrationError, match=told):
        FrameProbe(rig)(frame)
