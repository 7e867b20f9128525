"""What moves on /tf: the same drive told by odometry and by transforms gives the same poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, Trajectory
from fieldgrid.pipeline import estimate_drive
from fieldgrid.recordings import Drive, open_drive
from fieldgrid.recordings.bag.transforms import forward_speeds
from tests.recordings import bags
from tests.recordings.bags import CONTAINERS, Container, Maker, Said
from tests.simulated import K_TURN, fixes_of, simulate, time_ns

DRIVEN = simulate(K_TURN, 20.0)
"""Forward, back round a corner, and forward again."""
SAMPLED = DRIVEN.every(0.02)
TIMES_NS = time_ns(SAMPLED.time_s).tolist()
Open = Callable[..., Drive]


def fixes_said(maker: Maker) -> Iterator[Said]:
    for fix in fixes_of(DRIVEN, noise_m=0.3, seed=4).in_order():
        message = maker.fix(fix.time_ns, fix.lat_deg, fix.lon_deg, fix.height_m, sigma_m=0.3)
        yield Said(fix.time_ns, "/fix", message)


def odometry_said(maker: Maker) -> Iterator[Said]:
    for at_ns, speed in zip(TIMES_NS, SAMPLED.speed_mps.tolist(), strict=True):
        yield Said(at_ns, "/wheels/odom", maker.odometry(at_ns, speed))


def moved_said(
    maker: Maker,
    parent: str = "odom",
    child: str = "base_link",
    *,
    offset_m: float = 0.0,
    topic: str = "/tf",
    stamped: bool = True,
) -> Iterator[Said]:
    """The drive as transforms in a frame that lies and is turned anyhow, with wheels that turn in
    the same messages."""
    turn = math.radians(137.0)
    cos, sin = math.cos(turn), math.sin(turn)
    yaw = math.pi / 2.0 - SAMPLED.heading_rad + turn
    x = SAMPLED.east_m * cos - SAMPLED.north_m * sin + 40.0 + offset_m
    y = SAMPLED.east_m * sin + SAMPLED.north_m * cos - 7.0
    for at_ns, *at, half in zip(
        TIMES_NS, x.tolist(), y.tolist(), (yaw / 2.0).tolist(), strict=True
    ):
        placed = maker.transform(
            parent, child, (at[0], at[1], 0.3), (0.0, 0.0, math.sin(half), math.cos(half))
        )
        placed.header.stamp = maker.time(at_ns if stamped else at_ns % 10**12)
        turned = (0.0, math.sin(half), 0.0, math.cos(half))
        wheel = maker.transform("base_link", "wheel", (0.0, 0.5, 0.0), turned)
        yield Said(at_ns, topic, maker.transforms(wheel, placed))


@pytest.fixture
def opened(tmp_path: Path) -> Open:
    def do(*said: Callable[[Maker], Any], container: Container = "mcap") -> Drive:
        maker = Maker(container)
        messages = [one for part in (fixes_said, *said) for one in part(maker)]
        name = f"bag{len(list(tmp_path.iterdir()))}"
        return open_drive(bags.write_bag(tmp_path / name, container, maker, messages))

    return do


def trajectory(drive: Drive) -> Trajectory:
    return estimate_drive(drive, carrier=Carrier(0.0)).trajectory


@pytest.mark.parametrize("container", CONTAINERS)
def test_transforms_that_move_tell_what_odometry_tells(container: Container, opened: Open) -> None:
    with opened(moved_said, container=container) as drive:
        wheels = drive.motion().wheels
        (note,) = [note for note in drive.notes if "odometry" in note and "Topics" not in note]
        used = {stream.name: stream.role for stream in drive.streams()}
    assert note == "/tf: no topic has odometry, so the speed is that of base_link in odom."
    assert used["/tf"] == "odometry"
    assert wheels is not None
    true_mps = DRIVEN.at((wheels.time_ns - TIMES_NS[0]) / 1e9).speed_mps
    np.testing.assert_allclose(wheels.speed_mps, true_mps, atol=0.02)
    assert wheels.speed_mps.min() < -0.9  # in reverse


def test_the_trajectory_is_the_same(opened: Open) -> None:
    with opened(odometry_said) as drive:
        told = trajectory(drive)
    with opened(moved_said) as drive:
        moved = trajectory(drive)
    with opened() as drive:
        assert drive.motion().wheels is None
        alone = trajectory(drive)

    def apart_m(other: Trajectory) -> float:
        return float(np.hypot(other.east_m - told.east_m, other.north_m - told.north_m).max())

    assert apart_m(moved) < 0.03
    assert apart_m(alone) > 0.2
    both = told.gear * moved.gear != 0
    assert np.array_equal(told.gear[both], moved.gear[both])
    assert (told.gear < 0).sum() > 10


def test_odometry_goes_before_transforms(opened: Open) -> None:
    with opened(moved_said, odometry_said) as drive:
        assert drive.motion().wheels is not None
        assert len(drive.motion().wheels.time_ns) == len(TIMES_NS)  # type: ignore[union-attr]
        assert not any("/tf: no topic" in note for note in drive.notes)


def test_the_frame_without_jumps_goes_first(opened: Open) -> None:
    def robot(maker: Maker) -> Iterator[Said]:
        yield from moved_said(maker, "robot/map", "robot/base_link")
        yield from moved_said(maker, "robot/odom", "robot/base_footprint")

    with opened(robot) as drive:
        assert any("robot/base_footprint in robot/odom" in note for note in drive.notes)
        assert drive.motion().wheels is not None


@pytest.mark.parametrize(
    "said",
    [
        lambda maker: moved_said(maker, "odom", "camera_link"),
        lambda maker: moved_said(maker, "base_footprint", "base_link"),
        lambda maker: [*moved_said(maker, child="a/base_link"),
                       *moved_said(maker, child="b/base_link")],
        # As `fieldgrid convert` writes it: found by the fixes that lie beside it.
        lambda maker: [*moved_said(maker, "map"),
                       Said(TIMES_NS[0], "/datum", maker.fix(TIMES_NS[0], 39.5, -1.1, 700.0))],
    ],
)  # fmt: skip
def test_what_is_no_way_of_the_vehicle_is_not_used(said: Any, opened: Open) -> None:
    with opened(said) as drive:
        assert drive.motion().wheels is None


def test_stamps_that_are_no_utc_are_replaced(opened: Open) -> None:
    with opened(lambda maker: moved_said(maker, stamped=False)) as drive:
        wheels = drive.motion().wheels
        assert wheels is not None
        assert TIMES_NS[0] < wheels.time_ns[0] < TIMES_NS[0] + 10**8


def test_gaps_and_jumps_tell_no_speed() -> None:
    """20 Hz at 2 m/s backwards; 3 s are missing, and the map moves by 8 m once."""
    seconds = np.r_[np.arange(0.0, 5.0, 0.05), np.arange(8.0, 12.0, 0.05)]
    at_m = np.zeros((len(seconds), 3))
    at_m[:, 1] = -2.0 * seconds
    at_m[seconds > 10.02] += [8.0, 0.0, 0.0]
    forward = np.tile([0.0, 1.0, 0.0], (len(seconds), 1))
    at_m[seconds > 10.02, 1] += 8.0
    repeated = np.r_[0, np.arange(len(seconds))]
    time_ns = np.rint(seconds * 1e9).astype(np.int64)
    told_ns, speed_mps = forward_speeds(time_ns[repeated], at_m[repeated], forward[repeated])
    np.testing.assert_allclose(speed_mps, -2.0, atol=1e-6)
    gap = (told_ns > 5.0e9) & (told_ns < 8.0e9)
    assert not gap.any()
    assert len(told_ns) == pytest.approx(90, abs=3)
    assert (np.diff(told_ns) > 0).all()
