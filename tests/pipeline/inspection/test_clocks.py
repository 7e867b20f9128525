"""What an inspection says of frames where no pose of the drive can be used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Status
from fieldgrid.pipeline import estimate_drive
from fieldgrid.pipeline.inspection.fixes import rejections
from fieldgrid.recordings import DriveOptions, open_drive
from tests.conftest import TWO_LANES


def test_without_a_usable_pose_no_frame_counts() -> None:
    with open_drive(TWO_LANES, DriveOptions(gnss="gnss_rtk.nmea")) as drive:
        track = estimate_drive(drive.recording(), BuildSettings()).trajectory
    n = len(track)
    lost = replace(track, status=(Status.REJECTED,) * n, reason=("heading sigma 7° > 3°",) * n)
    assert rejections(track.time_ns[:7], lost) == {"heading sigma 7° > 3°": 7}
    assert not rejections(track.time_ns[np.flatnonzero(track.accepted)[:7]], track)
