"""A part of a drive: fixes, motion and frames are cut alike."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.recordings import DriveOptions, open_drive
from tests.conftest import TWO_LANES

RTK = "gnss_rtk.nmea"
START_NS = 1308133811 * 10**9


@pytest.mark.parametrize("counted_from_ns", [0, START_NS])
def test_fixes_motion_and_frames_are_cut_alike(counted_from_ns: int) -> None:
    """Whether the times are UTC or seconds from the first fix."""
    span_ns = 20 * 10**9, 50 * 10**9
    options = DriveOptions(
        RTK, from_ns=span_ns[0] + counted_from_ns, until_ns=span_ns[1] + counted_from_ns
    )
    with open_drive(TWO_LANES, options) as part, open_drive(TWO_LANES, DriveOptions(RTK)) as whole:
        one, other = part.recording(), whole.recording()
        gyro, all_gyro = one.motion().gyro, other.motion().gyro
        assert gyro is not None
        assert all_gyro is not None
        for cut_ns, whole_ns in (
            (one.fixes().time_ns, other.fixes().time_ns),
            (gyro.time_ns, all_gyro.time_ns),
            (one.frame_times_ns(), other.frame_times_ns()),
        ):
            inside = (whole_ns >= START_NS + span_ns[0]) & (whole_ns < START_NS + span_ns[1])
            assert cut_ns.tolist() == whole_ns[inside].tolist()
            assert 0 < len(cut_ns) < len(whole_ns)
        first = int(np.searchsorted(other.frame_times_ns(), one.frame_times_ns()[0]))
        frames = zip(one.frames(), other.frames(first), strict=False)
        assert all(a.frame_id == b.frame_id for a, b in frames)
