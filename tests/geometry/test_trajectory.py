"""The pose at an instant: between fixes, at them, and where there are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import GnssError
from fieldgrid.geometry import MAX_GAP_NS, Datum, Status, Trajectory

SECOND = 1_000_000_000
START = 1_308_139_200 * SECOND
DATUM = Datum(39.5, -1.1, 700.0)


def trajectory(
    seconds: Sequence[float],
    headings: Sequence[float] | None = None,
    reasons: dict[int, str] | None = None,
    held: Sequence[int] = (),
) -> Trajectory:
    """Row k is at east 10k, north -k, up k/10; rows that have a reason are rejected."""
    n = len(seconds)
    k = np.arange(n, dtype=np.float64)
    reasons = reasons or {}
    return Trajectory(
        datum=DATUM,
        time_ns=START + np.array([round(s * SECOND) for s in seconds], dtype=np.int64),
        east_m=10.0 * k,
        north_m=-k,
        up_m=0.1 * k,
        heading_deg=np.array(headings if headings is not None else 5.0 * k),
        position_sigma_m=0.01 * (k + 1.0),
        heading_sigma_deg=0.1 * (k + 1.0),
        speed_mps=k,
        gear=np.ones(n, dtype=np.int64),
        quality=np.full(n, 4),
        status=tuple(
            Status.REJECTED if i in reasons else Status.HELD if i in held else Status.OK
            for i in range(n)
        ),
        reason=tuple(reasons.get(i, "") for i in range(n)),
        heading_source="recorded",
    )


def at(seconds: float) -> int:
    return START + round(seconds * SECOND)


def test_a_pose_between_fixes_lies_on_the_line() -> None:
    pose = trajectory([0.0, 0.2, 0.4]).at(at(0.25))
    assert pose.time_ns == at(0.25)
    assert pose.status is Status.OK
    assert (pose.east_m, pose.north_m, pose.up_m) == pytest.approx((12.5, -1.25, 0.125))
    assert pose.heading_deg == pytest.approx(6.25)
    assert pose.speed_mps == pytest.approx(1.25)


def test_a_pose_between_fixes_is_as_bad_as_the_worse() -> None:
    pose = trajectory([0.0, 0.2, 0.4]).at(at(0.21))
    assert pose.position_sigma_m == pytest.approx(0.03)
    assert pose.heading_sigma_deg == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("headings", "expected"), [((170.0, -170.0), 175.0), ((-170.0, 170.0), -175.0)]
)
def test_headings_cross_south_the_shorter_way(
    headings: tuple[float, float], expected: float
) -> None:
    assert trajectory([0.0, 1.0], headings).at(at(0.25)).heading_deg == pytest.approx(expected)


@given(
    st.lists(st.integers(1, 3 * SECOND), min_size=1, max_size=8),
    st.data(),
)
def test_the_pose_at_the_time_of_a_row_is_the_row(gaps: list[int], data: st.DataObject) -> None:
    times = np.cumsum([0, *gaps]) / SECOND
    headings = data.draw(
        st.lists(st.floats(-179.0, 180.0), min_size=len(times), max_size=len(times))
    )
    found = trajectory(times.tolist(), headings)
    k = data.draw(st.integers(0, len(times) - 1))
    pose = found.at(int(found.time_ns[k]))
    assert pose.status is Status.OK
    assert pose.reason == ""
    assert pose.time_ns == found.time_ns[k]
    assert (pose.east_m, pose.north_m, pose.up_m) == (10.0 * k, -k, 0.1 * k)
    assert pose.heading_deg == headings[k]
    assert pose.position_sigma_m == found.position_sigma_m[k]
    assert pose.heading_sigma_deg == found.heading_sigma_deg[k]
    assert pose.speed_mps == k


def test_a_gap_up_to_the_limit_is_bridged() -> None:
    limit_s = MAX_GAP_NS / SECOND
    assert trajectory([0.0, limit_s]).at(at(limit_s / 2)).status is Status.OK
    pose = trajectory([0.0, limit_s + 0.01]).at(at(limit_s / 2))
    assert pose.status is Status.REJECTED


def test_a_gap_is_rejected_with_its_length_and_the_nearest_fix() -> None:
    drive = trajectory([0.0, 0.2, 3.2, 3.4])
    early, late = drive.at(at(1.0)), drive.at(at(3.0))
    for pose in (early, late):
        assert pose.status is Status.REJECTED
        assert "3.00 s" in pose.reason
        assert "nothing tells where the vehicle was" in pose.reason
    assert (early.east_m, late.east_m) == (10.0, 20.0)
    assert early.time_ns == at(1.0)


def test_before_and_after_are_rejected_with_the_nearest_end() -> None:
    drive = trajectory([0.0, 0.2])
    before, after = drive.at(at(-0.5)), drive.at(at(1.0))
    assert (before.status, after.status) == (Status.REJECTED, Status.REJECTED)
    assert "0.50 s before the first" in before.reason
    assert "0.80 s after the last" in after.reason
    assert (before.east_m, after.east_m) == (0.0, 10.0)


def test_a_rejected_fix_lends_its_reason_and_not_its_position() -> None:
    short = trajectory([0.0, 0.2, 0.4], reasons={1: "HDOP 9"})
    pose = short.at(at(0.2))
    assert pose.status is Status.OK
    assert pose.east_m == pytest.approx(10.0)  # the middle of rows 0 and 2
    assert pose.heading_sigma_deg == pytest.approx(0.3)

    long = trajectory([0.0, 1.0, 2.0], reasons={1: "HDOP 9"})
    assert long.at(at(1.1)).status is Status.REJECTED
    assert "HDOP 9" in long.at(at(1.1)).reason

    ends = trajectory([0.0, 1.0, 2.0], reasons={0: "2 satellites < 5", 2: "HDOP 9"})
    assert "2 satellites" in ends.at(at(0.1)).reason
    assert "HDOP 9" in ends.at(at(1.9)).reason


def test_a_drive_without_an_accepted_fix_places_nothing() -> None:
    with pytest.raises(GnssError, match="no usable pose"):
        trajectory([0.0, 0.2], reasons={0: "a", 1: "b"}).at(at(0.1))


def test_length_counts_the_accepted_path() -> None:
    assert trajectory([0.0, 0.2, 0.4]).length_m() == pytest.approx(2 * np.hypot(10.0, 1.0))
    skipping = trajectory([0.0, 0.2, 0.4], reasons={2: "HDOP 9"})
    assert skipping.length_m() == pytest.approx(np.hypot(10.0, 1.0))
    assert len(skipping) == 3
    assert skipping.accepted.tolist() == [True, True, False]


def test_times_must_increase() -> None:
    with pytest.raises(GnssError, match="increase"):
        trajectory([0.0, 0.4, 0.2])
    with pytest.raises(GnssError, match="increase"):
        trajectory([0.0, 0.2, 0.2])
    assert len(trajectory([0.0, 0.2, 0.2], reasons={2: "time is not after"})) == 3


@pytest.mark.parametrize("column", ["up_m", "gear", "status", "reason"])
def test_columns_must_agree(column: str) -> None:
    found = trajectory([0.0, 0.2])
    with pytest.raises(GnssError, match="length"):
        replace(found, **{column: getattr(found, column)[:1]})


def test_held_poses_are_as_good_as_driven_ones() -> None:
    found = trajectory([0.0, 0.2, 0.4], reasons={2: "HDOP 9"}, held=[1])
    assert found.accepted.tolist() == [True, True, False]
    assert found.at(at(0.1)).status is Status.OK
    assert found.at(at(0.2)).status is not Status.REJECTED
    assert found.length_m() == pytest.approx(np.hypot(10.0, 1.0))
