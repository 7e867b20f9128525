"""What a drive says of itself besides its images, as messages: fixes, motion, poses, places."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import (
    DepthCamera,
    FixColumns,
    Gyro,
    Inertial,
    Motion,
    Orientation,
    RecordedTilt,
    Rig,
    StereoCamera,
    Trajectory,
    yaw_from_heading_rad,
)
from fieldgrid.recordings import ANTENNA, BASE, MAP, gnss_messages as gnss, ros_messages as messages

LEFT, RIGHT, DEPTH, LIDAR = "left_optical", "right_optical", "depth_optical", "lidar_optical"
IMU, AXLE = "imu", "rear_axle"
FIX, IMU_DATA = "/gnss/fix", "/imu/data"

_FLU_FROM_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ATTITUDE_RAD2 = math.radians(2.0) ** 2


class StampedMessage(NamedTuple):
    """One message."""

    time_ns: int
    topic: str
    message: Any


def messages_once(
    rig: Rig | None, trajectory: Trajectory | None, time_ns: int
) -> Iterator[tuple[str, Any]]:
    """What is said once, at the start: where things sit, and where the map is."""
    if rig is not None:
        yield "/tf_static", messages.transforms(*_transforms(rig, time_ns))
        yield gnss.RIG, gnss.rig_message(rig)
    if trajectory is not None:
        yield gnss.DATUM, gnss.datum_message(trajectory.datum, time_ns)


def _transforms(rig: Rig, time_ns: int) -> Iterator[Any]:
    R = _FLU_FROM_VEHICLE @ rig.mount.rotation()
    sensor, above = rig.sensor, np.array([0.0, 0.0, rig.mount.height_m])
    frames: dict[str, Float64] = {}
    if isinstance(sensor, StereoCamera):
        half = R @ np.array([sensor.baseline_m / 2.0, 0.0, 0.0])
        frames = {LEFT: above - half, RIGHT: above + half}
    else:
        frames = {DEPTH if isinstance(sensor, DepthCamera) else LIDAR: above}
    turn, level = messages.quaternion(R), messages.quaternion(np.eye(3))
    antenna, axle_m = rig.antenna, rig.rear_axle_forward_m
    at_antenna = np.array([antenna.forward_m, -antenna.right_m, antenna.up_m])
    for name, at in frames.items():
        yield messages.transform(time_ns, BASE, name, at, turn)
    yield messages.transform(time_ns, BASE, ANTENNA, at_antenna, level)
    yield messages.transform(time_ns, BASE, IMU, above, level)
    if axle_m is not None:
        yield messages.transform(time_ns, BASE, AXLE, np.array([axle_m, 0.0, 0.0]), level)


def fix_messages(fixes: FixColumns) -> Iterator[StampedMessage]:
    """All fixes, also those that a build would reject, each followed by what it cannot say."""
    for fix in fixes.in_order():
        yield StampedMessage(fix.time_ns, FIX, gnss.nav_sat_fix(fix, ANTENNA))
        yield StampedMessage(fix.time_ns, FIX + gnss.DETAILS, gnss.details_message(fix))


def motion_messages(motion: Motion, notes: list[str]) -> Iterator[StampedMessage]:
    """IMU, wheels and recorded tilts, as far as there are any; notes tell which rates are not
    known."""
    streams = []
    if motion.gyro is not None:
        sensed = _sensed(motion.gyro, motion.inertial)
        unknown = int(np.isnan(sensed[:, 0]).sum())
        if unknown:
            notes.append(
                f"Rates about the axes forward and left are not known in {unknown} of "
                f"{len(sensed)} messages of {IMU_DATA} and are written as NaN."
            )
        streams.append(_imu_messages(motion.gyro.time_ns, sensed))
    if motion.wheels is not None:
        times, speeds = motion.wheels.time_ns.tolist(), motion.wheels.speed_mps.tolist()
        streams.append(
            StampedMessage(t, "/wheel_odometry", messages.odometry_message(t, speed))
            for t, speed in zip(times, speeds, strict=True)
        )
    for topic, tilt in ((gnss.TILT, motion.tilt), (gnss.ORIENTATION, motion.orientation)):
        if tilt is not None:
            streams.append(_tilt_messages(topic, tilt))
    return heapq.merge(*streams, key=lambda one: one.time_ns)


def _tilt_messages(topic: str, tilt: RecordedTilt | Orientation) -> Iterator[StampedMessage]:
    for time_ns, message in gnss.tilt_messages(tilt):
        yield StampedMessage(time_ns, topic, message)


def _sensed(gyro: Gyro, inertial: Inertial | None) -> Float64:
    """Rates and forces along forward, left, up at the instants of the gyro, [n, 6]; NaN where the
    IMU does not tell them."""
    sensed = np.full((len(gyro.time_ns), 6), np.nan)
    if inertial is not None:
        _, at, of = np.intersect1d(gyro.time_ns, inertial.time_ns, return_indices=True)
        for first, told in ((0, inertial.rate_rad_s), (3, inertial.force_mps2)):
            right, forward, up = told[of].T
            sensed[at, first : first + 3] = np.stack([forward, -right, up], axis=1)
    sensed[:, 2] = -gyro.rate_rad_s
    return sensed


def _imu_messages(times_ns: Int64, sensed: Float64) -> Iterator[StampedMessage]:
    for time_ns, (x, y, z, *felt) in zip(times_ns.tolist(), sensed.tolist(), strict=True):
        known = None if math.isnan(felt[0]) else (felt[0], felt[1], felt[2])
        message = messages.imu_message(time_ns, IMU, (x, y, z), known)
        yield StampedMessage(time_ns, IMU_DATA, message)


def pose_messages(trajectory: Trajectory) -> Iterator[StampedMessage]:
    """The poses that hold, of the grid origin in the map: three messages each."""
    yaws = yaw_from_heading_rad(trajectory.heading_deg)
    for k in np.flatnonzero(trajectory.accepted).tolist():
        time_ns, yaw = int(trajectory.time_ns[k]), float(yaws[k])
        at_m = np.array([trajectory.east_m[k], trajectory.north_m[k], trajectory.up_m[k]])
        pose = messages.pose(at_m[0], at_m[1], at_m[2], yaw)
        yield StampedMessage(time_ns, "/pose", messages.pose_stamped(time_ns, MAP, pose))
        variance_m2 = float(trajectory.position_sigma_m[k]) ** 2
        yaw_rad2 = math.radians(float(trajectory.heading_sigma_deg[k])) ** 2
        variances = [
            *(variance_m2, variance_m2, gnss.UP_SHARE**2 * variance_m2),
            *(_ATTITUDE_RAD2, _ATTITUDE_RAD2, yaw_rad2),
        ]
        sure = messages.new(
            "geometry_msgs/PoseWithCovariance",
            pose=pose,
            covariance=np.diag(variances).reshape(-1),
        )
        header = messages.header_of(time_ns, MAP)
        stamped = messages.new("geometry_msgs/PoseWithCovarianceStamped", header=header, pose=sure)
        yield StampedMessage(time_ns, "/pose_with_covariance", stamped)
        placed = messages.transform(time_ns, MAP, BASE, at_m, pose.orientation)
        yield StampedMessage(time_ns, "/tf", messages.transforms(placed))
