"""A pose that is carried on by the camera's steps, as far as it may be."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Pose
from fieldgrid.live.pose.propagation import CARRIED_S, PropagatedPose, pose_now
from fieldgrid.perception import CameraStep
from fieldgrid.poses import ErrorBudget
from tests.geometry.test_trajectory import at, trajectory

START = PropagatedPose(Pose(10**18, 5.0, 7.0, 0.5, 90.0, 0.03, 0.4, 1.0), 1)
AHEAD = CameraStep(1.0, 0.2, -10.0, 0.02, 0.1, 0.0, 0.0, 0.0, 0.1, 50)
BUDGET = ErrorBudget(0.25, 10.0)


def test_a_step_goes_along_the_heading_and_turns_it() -> None:
    on = START.on(10**18 + 500_000_000, AHEAD)
    # To the east, and so to the right is to the south.
    assert (on.pose.east_m, on.pose.north_m) == pytest.approx((6.0, 6.8))
    assert (on.pose.heading_deg, on.pose.speed_mps, on.gear) == pytest.approx((80.0, 2.0, 1))
    assert on.pose.position_sigma_m > START.pose.position_sigma_m
    assert on.pose.heading_sigma_deg == pytest.approx(0.17**0.5)
    back = on.on(10**18 + 1_000_000_000, AHEAD._replace(forward_m=-1.0))
    assert back.gear == -1
    assert back.since_s == pytest.approx(1.0)
    assert back.added_m > on.added_m


def test_it_is_carried_no_further_than_is_good_enough() -> None:
    step_ns, settings = 200_000_000, PoseSettings()
    one = START
    for k in range(1, 11):
        one = one.on(START.pose.time_ns + k * step_ns, AHEAD)
        assert one.is_good(settings, BUDGET)
    assert one.since_s == pytest.approx(CARRIED_S)
    last = one.on(START.pose.time_ns + 11 * step_ns, AHEAD)
    assert last.is_good(settings, BUDGET)
    late = last.on(START.pose.time_ns + 12 * step_ns, AHEAD)
    assert not late.is_good(settings, BUDGET)
    # Of a camera that takes a pair each five seconds, one step is as good as its error.
    long = START.on(START.pose.time_ns + 25 * step_ns, AHEAD)
    assert long.is_good(settings, BUDGET)
    assert not long.on(START.pose.time_ns + 26 * step_ns, AHEAD).is_good(settings, BUDGET)
    unsure = START.on(START.pose.time_ns + step_ns, AHEAD._replace(sigma_deg=1.0))
    assert not unsure.is_good(settings, BUDGET)
    lost = replace(START.pose, position_sigma_m=settings.max_position_sigma_m + 0.1)
    assert not PropagatedPose(lost, 1).on(lost.time_ns + step_ns, AHEAD).is_good(settings, BUDGET)


@pytest.mark.parametrize(
    ("newest_s", "told_s", "told"),
    [
        (3.4, 3.4, ""),
        (4.2, 4.1, "no pose that can be used for 2.2 s: the estimate is behind what has arrived"),
        (4.2, 2.0, "no pose that can be used for 2.2 s: nothing arrived that tells where "),
        (4.2, None, "no pose that can be used for 2.2 s: nothing arrived that tells where "),
    ],
)
def test_a_pose_is_missing_since_nothing_arrived_or_the_estimate_is_behind(
    newest_s: float, told_s: float | None, told: str
) -> None:
    track = trajectory([0.0, 1.0, 2.0])
    told_ns = None if told_s is None else at(told_s)
    _, _, doubt = pose_now(track, None, at(newest_s), told_ns)
    assert doubt.startswith(told)
    assert bool(doubt) is bool(told)
    refused = trajectory([0.0, 1.0, 2.0, 4.0], reasons={3: "hdop 9 > 4"})
    _, _, doubt = pose_now(refused, None, at(newest_s), told_ns)
    assert doubt.endswith(": hdop 9 > 4") is bool(told)
