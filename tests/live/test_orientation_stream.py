"""Orientations of a stream: which source tells roll and pitch, as of a bag."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldgrid.live.pose.sensor_rows import Rows
from fieldgrid.live.sources.imu_stream import ImuStream
from fieldgrid.live.sources.orientation_stream import IMU_FIRST_NS, SETTLED_NS, OrientationStream
from fieldgrid.recordings import LEAST_STEP_NS, ODOMETRY_FRAME_SIGMA_DEG, Transforms

EVERY_NS = LEAST_STEP_NS // 2
G = 9.81


def turn(roll_deg: float, *, flipped: bool = False) -> Any:
    """A body forward, left, up that rolls to its right; flipped, its z axis points down."""
    turned = Rotation.from_euler("x", roll_deg + (180.0 if flipped else 0.0), degrees=True)
    return SimpleNamespace(**dict(zip("xyzw", turned.as_quat().tolist(), strict=True)))


def imu(orientation: Any, *, felt: bool) -> Any:
    return SimpleNamespace(
        header=SimpleNamespace(frame_id="imu"),
        angular_velocity=SimpleNamespace(x=0.1, y=0.2, z=0.3),
        linear_acceleration=SimpleNamespace(x=0.0, y=0.0, z=G),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration_covariance=np.full(9, 0.0 if felt else -1.0),
        orientation=orientation,
        orientation_covariance=np.full(9, 1e-4),
    )


def odometry(orientation: Any) -> Any:
    held = SimpleNamespace(pose=SimpleNamespace(orientation=orientation), covariance=np.zeros(36))
    return SimpleNamespace(pose=held)


class Fed:
    """What comes of an IMU and odometry that roll by some degrees to and fro, None for none."""

    def __init__(
        self,
        imu_deg: float | None,
        odometry_deg: float | None,
        *,
        felt: bool = False,
        flipped: bool = False,
        until_ns: int = 2 * SETTLED_NS,
    ) -> None:
        sensed, transforms = ImuStream("flu"), Transforms()
        stream = OrientationStream("flu", sensed, transforms)
        self.first_ns: int | None = None
        made: list[Rows] = []
        for time_ns in range(EVERY_NS, until_ns, EVERY_NS):
            sway = np.sin(time_ns / 1e9)
            given: list[tuple[str, Any]] = []
            if odometry_deg is not None:
                given.append(("odometry", odometry(turn(odometry_deg * sway))))
            if imu_deg is not None:
                given.append(("imu", imu(turn(imu_deg * sway, flipped=flipped), felt=felt)))
            for role, message in given:
                if role == "imu":
                    sensed.take(message, time_ns)
                for part, rows in stream.take(role, message, time_ns, role):
                    assert part == "orientation"
                    self.first_ns = self.first_ns or time_ns
                    made.append(rows)
        made += [rows for _, rows in stream.finish()]
        self.notes = stream.notes
        self.time_ns = np.concatenate([r.time_ns for r in made]) if made else np.zeros(0, np.int64)
        self.columns = [np.concatenate(c) for c in zip(*(r.columns for r in made), strict=True)]


@pytest.mark.parametrize(("imu_deg", "most_deg", "frame_deg"), [(5.0, 5.0, 0.0), (None, 3.0, 2.0)])
def test_the_orientation_of_the_imu_goes_before_that_of_odometry(
    imu_deg: float | None, most_deg: float, frame_deg: float
) -> None:
    fed = Fed(imu_deg, 3.0)
    roll_deg, pitch_deg, _, frame_sigma_deg = fed.columns
    assert roll_deg == pytest.approx(most_deg * np.sin(fed.time_ns / 1e9), abs=1e-4)
    assert pitch_deg == pytest.approx(0.0, abs=1e-4)
    assert set(frame_sigma_deg.tolist()) == {frame_deg}
    # Held first, and then as they come, as far apart as in a bag.
    assert fed.first_ns is not None
    assert SETTLED_NS <= fed.first_ns < 2 * SETTLED_NS
    assert set(np.diff(fed.time_ns).tolist()) == {LEAST_STEP_NS}
    assert fed.time_ns[0] == EVERY_NS


def test_an_accelerometer_goes_before_all_orientations() -> None:
    assert not len(Fed(5.0, 3.0, felt=True).time_ns)


def test_an_imu_that_never_leans_gives_way_to_odometry() -> None:
    fed = Fed(0.0, 3.0, until_ns=3 * IMU_FIRST_NS)
    assert set(fed.columns[3].tolist()) == {ODOMETRY_FRAME_SIGMA_DEG}
    assert fed.first_ns is not None
    assert fed.first_ns >= IMU_FIRST_NS


def test_a_short_stream_is_decided_at_its_end() -> None:
    fed = Fed(5.0, None, until_ns=SETTLED_NS // 2)
    assert fed.first_ns is None
    assert len(fed.time_ns) > 10


def test_an_imu_upside_down_of_unknown_axes_is_reported() -> None:
    fed = Fed(5.0, None, flipped=True)
    assert not len(fed.time_ns)
    (note,) = fed.notes
    assert "upside down" in note
    assert "imu_axes" in note
