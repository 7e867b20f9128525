"""What a drive says of itself besides its images, as messages: fixes, motion, poses, places."""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.angles import yaw_from_heading_rad
from fieldgrid.array_types import Float64
from fieldgrid.convert.messages import (
    ANTENNA,
    AXLE,
    BASE,
    DEPTH,
    IMU,
    LEFT,
    LIDAR,
    MAP,
    RIGHT,
    UP_SHARE,
    header_of,
    imu_message,
    nav_sat_fix,
    new,
    odometry_message,
    quaternion,
    transform,
    vector,
)
from fieldgrid.fixes import FixColumns
from fieldgrid.recording import Recording
from fieldgrid.rig import DepthCamera, Rig, StereoCamera
from fieldgrid.trajectory import Trajectory

_FLU_FROM_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ATTITUDE_RAD2 = math.radians(2.0) ** 2


class Said(NamedTuple):
    """One message. The order decides among messages of one time."""

    time_ns: int
    order: int
    topic: str
    message: Any


def said_once(rig: Rig, trajectory: Trajectory | None, time_ns: int) -> Iterator[tuple[str, Any]]:
    """What is said once, at the start: where things sit, and where the map is."""
    R = _FLU_FROM_VEHICLE @ rig.mount.rotation()
    sensor, above = rig.sensor, np.array([0.0, 0.0, rig.mount.height_m])
    frames: dict[str, Float64] = {}
    if isinstance(sensor, StereoCamera):
        half = R @ np.array([sensor.baseline_m / 2.0, 0.0, 0.0])
        frames = {LEFT: above - half, RIGHT: above + half}
    else:
        frames = {DEPTH if isinstance(sensor, DepthCamera) else LIDAR: above}
    turn, level = quaternion(R), quaternion(np.eye(3))
    antenna = rig.antenna
    at_antenna = np.array([antenna.forward_m, -antenna.right_m, antenna.up_m])
    placed = [transform(time_ns, BASE, name, at, turn) for name, at in frames.items()]
    placed.append(transform(time_ns, BASE, ANTENNA, at_antenna, level))
    placed.append(transform(time_ns, BASE, IMU, above, level))
    if rig.rear_axle_forward_m is not None:
        axle = np.array([rig.rear_axle_forward_m, 0.0, 0.0])
        placed.append(transform(time_ns, BASE, AXLE, axle, level))
    yield "/tf_static", new("tf2_msgs/TFMessage", transforms=placed)
    if trajectory is not None:
        datum = trajectory.datum
        said = {
            "frame": MAP,
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
        }
        yield "/datum", new("std_msgs/String", data=json.dumps(said))


def fixes_said(fixes: FixColumns) -> Iterator[Said]:
    """All fixes, also those that a build would reject."""
    for fix in fixes.in_order():
        yield Said(fix.time_ns, 0, "/gnss/fix", nav_sat_fix(fix))


def motion_said(recording: Recording) -> Iterator[Said]:
    """Gyro and wheels, as far as there are any."""
    motion = recording.motion()
    streams = []
    if motion.gyro is not None:
        times, rates = motion.gyro.time_ns.tolist(), motion.gyro.rate_rad_s.tolist()
        streams.append(
            Said(t, 1, "/imu/data", imu_message(t, rate))
            for t, rate in zip(times, rates, strict=True)
        )
    if motion.wheels is not None:
        times, speeds = motion.wheels.time_ns.tolist(), motion.wheels.speed_mps.tolist()
        streams.append(
            Said(t, 2, "/wheel_odometry", odometry_message(t, speed))
            for t, speed in zip(times, speeds, strict=True)
        )
    return heapq.merge(*streams, key=lambda said: said.time_ns)


def poses_said(trajectory: Trajectory) -> Iterator[Said]:
    """The poses that hold, of the grid origin in the map: three messages each."""
    yaws = yaw_from_heading_rad(trajectory.heading_deg)
    for k in np.flatnonzero(trajectory.accepted).tolist():
        time_ns, yaw = int(trajectory.time_ns[k]), float(yaws[k])
        at_m = np.array([trajectory.east_m[k], trajectory.north_m[k], trajectory.up_m[k]])
        turn = new(
            "geometry_msgs/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0)
        )
        pose = new(
            "geometry_msgs/Pose", position=vector(*at_m.tolist(), name="Point"), orientation=turn
        )
        header = header_of(time_ns, MAP)
        stamped = new("geometry_msgs/PoseStamped", header=header, pose=pose)
        yield Said(time_ns, 3, "/pose", stamped)
        variance_m2 = float(trajectory.position_sigma_m[k]) ** 2
        yaw_rad2 = math.radians(float(trajectory.heading_sigma_deg[k])) ** 2
        variances = [
            *(variance_m2, variance_m2, UP_SHARE**2 * variance_m2),
            *(_ATTITUDE_RAD2, _ATTITUDE_RAD2, yaw_rad2),
        ]
        sure = new(
            "geometry_msgs/PoseWithCovariance",
            pose=pose,
            covariance=np.diag(variances).reshape(-1),
        )
        said = new("geometry_msgs/PoseWithCovarianceStamped", header=header, pose=sure)
        yield Said(time_ns, 4, "/pose_with_covariance", said)
        placed = new("tf2_msgs/TFMessage", transforms=[transform(time_ns, MAP, BASE, at_m, turn)])
        yield Said(time_ns, 5, "/tf", placed)
