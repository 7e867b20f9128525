from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.export import Selection
from fieldgrid.export.robots import ros_messages
from fieldgrid.export.robots.bag_content import BagContent, messages
from fieldgrid.maps import AlignmentRecord, CostCurve, HeightCorrection, Transform, open_map
from tests.export.asymmetric import SPRING, write_asymmetric_map
from tests.maps.file.maps import track


def test_a_fix_is_what_a_receiver_gave_and_a_path_has_what_has_a_heading() -> None:
    # Rows 0, 2, 3, 5, ... are accepted; the third of four headings is not known.
    driven = dataclasses.replace(
        track(8),
        quality=np.array([4, 5, 6, 1, 2, 9, 3, 8]),
        position_sigma_m=np.array([0.02, 0.02, 0.02, np.nan, 0.02, 0.02, 0.02, 0.02]),
    )
    up_sigma_m = np.array([0.3, *np.full(5, 0.04), np.nan, 0.04])
    given = ros_messages.fixes(driven, driven.accepted, "base_footprint", None, up_sigma_m)
    fixes = [fix for _, fix in given]
    rows = [0, 3, 5, 6]
    assert [stamp(fix.header) for fix in fixes] == driven.time_ns[rows].tolist()
    # RTK, plain, with a satellite's corrections, PPS.
    assert [fix.status.status for fix in fixes] == [2, 0, 1, 0]
    # The sigma of row 3 is not known, so its covariance is not.
    assert [fix.position_covariance_type for fix in fixes] == [2, 0, 2, 2]
    assert not fixes[1].position_covariance.any()
    variances = [np.diag(fix.position_covariance.reshape(3, 3)) for fix in fixes]
    np.testing.assert_allclose(variances[0], [4e-4, 4e-4, 0.09])
    np.testing.assert_allclose(variances[2], [4e-4, 4e-4, 16e-4])
    assert variances[3][2] == 1e6
    headed = np.array([0, 3, 5])
    poses = ros_messages.path(driven, headed, 0).poses
    assert [stamp(pose.header) for pose in poses] == driven.time_ns[headed].tolist()


@pytest.mark.parametrize(
    ("heights", "up_sigma_m"),
    [
        (None, 0.04),
        (HeightCorrection((5,), (0.0,)), 0.04),
        (HeightCorrection((5,), (0.0,), 0.07), 0.07),
    ],
)
def test_heights_are_no_surer_than_driven_after_an_alignment(
    heights: HeightCorrection | None, up_sigma_m: float, tmp_path: Path
) -> None:
    path = write_asymmetric_map(tmp_path / "f.gpkg")
    to = Transform(0.01, aligned=AlignmentRecord(0.005, None, ()), heights=heights)
    with open_map(path, writable=True) as universal:
        universal.set_transforms({SPRING: to})
    with open_map(path) as universal:
        content = BagContent.of(universal, Selection(), CostCurve())
        topic = f"/{SPRING}/fix"
        fixes = [one.message for one in messages(content) if one.topic == topic]
    assert fixes
    for fix in fixes:
        variances = np.diag(fix.position_covariance.reshape(3, 3))
        np.testing.assert_allclose(np.sqrt(variances), [0.005, 0.005, up_sigma_m])


def stamp(header: object) -> int:
    time = header.stamp  # type: ignore[attr-defined]
    return int(time.sec) * 10**9 + int(time.nanosec)
