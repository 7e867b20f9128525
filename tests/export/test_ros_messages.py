from __future__ import annotations

import dataclasses

import numpy as np

from fieldgrid.export import ros_messages
from tests.mapfile.maps import track


def test_a_fix_is_what_a_receiver_gave_and_a_path_has_what_has_a_heading() -> None:
    # Rows 0, 2, 3, 5, ... are accepted; the third of four headings is not known.
    driven = dataclasses.replace(
        track(8),
        quality=np.array([4, 5, 6, 1, 2, 9, 3, 8]),
        position_sigma_m=np.array([0.02, 0.02, 0.02, np.nan, 0.02, 0.02, 0.02, 0.02]),
    )
    fixes = [fix for _, fix in ros_messages.fixes(driven, driven.accepted, "base_footprint", None)]
    rows = [0, 3, 5, 6]
    assert [stamp(fix.header) for fix in fixes] == driven.time_ns[rows].tolist()
    # RTK, plain, with a satellite's corrections, PPS.
    assert [fix.status.status for fix in fixes] == [2, 0, 1, 0]
    # The sigma of row 3 is not known, so its covariance is not.
    assert [fix.position_covariance_type for fix in fixes] == [2, 0, 2, 2]
    assert not fixes[1].position_covariance.any()
    headed = np.array([0, 3, 5])
    poses = ros_messages.path(driven, headed, 0).poses
    assert [stamp(pose.header) for pose in poses] == driven.time_ns[headed].tolist()


def stamp(header: object) -> int:
    time = header.stamp  # type: ignore[attr-defined]
    return int(time.sec) * 10**9 + int(time.nanosec)
