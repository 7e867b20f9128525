"""What an inspection says of clocks where no pose of the drive can be used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Status
from fieldgrid.pipeline import estimate_drive
from fieldgrid.pipeline.inspection.drive import clock_findings
from fieldgrid.pipeline.inspection.findings import Severity
from fieldgrid.pipeline.inspection.fixes import rejections
from fieldgrid.poses import ClockOffset
from fieldgrid.recordings import DriveOptions, open_drive
from tests.conftest import TWO_LANES


def test_without_a_usable_pose_no_speed_is_told_and_no_frame_counts() -> None:
    with open_drive(TWO_LANES, DriveOptions(gnss="gnss_rtk.nmea")) as drive:
        recording = drive.recording()
        track = estimate_drive(recording, BuildSettings()).trajectory
        n = len(track)
        lost = replace(track, status=(Status.REJECTED,) * n, reason=("heading sigma 7° > 3°",) * n)
        clock = ClockOffset(-20.0, 0.01, 49, 1.0)
        [told] = clock_findings(clock, recording, lost)
        assert told.severity is Severity.ERROR
        assert told.message.endswith("by 49 steps of the camera.")
        [told] = clock_findings(clock, recording, track)
        assert told.message.endswith("; at 1.4 m/s that is 27.73 m.")
    assert rejections(track.time_ns[:7], lost) == {"heading sigma 7° > 3°": 7}
    assert not rejections(track.time_ns[np.flatnonzero(track.accepted)[:7]], track)
