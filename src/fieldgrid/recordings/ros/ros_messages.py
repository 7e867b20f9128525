"""Messages of ROS 2: what they are made of, and those of sensors.

Frames by REP-103 and REP-105: `map` is the Local Tangent Plane (east, north, up), a vehicle's frame
is forward, left, up. Times are UTC in nanoseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray, Float64
from fieldgrid.geometry import DepthCamera, StereoCamera
from fieldgrid.perception import Sweep
from fieldgrid.recordings.ros.definitions import types

MAP, EARTH, BASE, ANTENNA = "map", "earth", "base_footprint", "gnss_antenna"

_SECOND = 1_000_000_000
NOT_SAID = 1e6
"""The variance of what is not known."""


def new(name: str, /, **fields: Any) -> Any:
    """A message of a type, which ROS calls package/msg/Name, by package/Name."""
    package, short = name.split("/")
    return types().types[f"{package}/msg/{short}"](**fields)


def time_of(time_ns: int) -> Any:
    """A builtin_interfaces/Time."""
    return new("builtin_interfaces/Time", sec=time_ns // _SECOND, nanosec=time_ns % _SECOND)


def header_of(time_ns: int, frame: str) -> Any:
    """A std_msgs/Header."""
    return new("std_msgs/Header", stamp=time_of(time_ns), frame_id=frame)


def text(content: str) -> Any:
    """A std_msgs/String."""
    return new("std_msgs/String", data=content)


def vector(x: float, y: float, z: float, *, name: str = "Vector3") -> Any:
    """Three numbers as a message: a Vector3 or a Point."""
    return new(f"geometry_msgs/{name}", x=float(x), y=float(y), z=float(z))


def quaternion(R: Float64) -> Any:
    """A rotation [3, 3] as a geometry_msgs/Quaternion."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat(canonical=True).tolist()
    return new("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def turn_left(yaw_rad: float) -> Any:
    """A turn about the vertical, counter-clockwise, as a geometry_msgs/Quaternion."""
    half = yaw_rad / 2.0
    return new("geometry_msgs/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))


def pose(x: float, y: float, z: float = 0.0, yaw_rad: float = 0.0) -> Any:
    """A geometry_msgs/Pose of a level body; its yaw is counter-clockwise from x."""
    position = vector(x, y, z, name="Point")
    return new("geometry_msgs/Pose", position=position, orientation=turn_left(yaw_rad))


def pose_stamped(time_ns: int, frame: str, placed: Any) -> Any:
    """A geometry_msgs/PoseStamped."""
    return new("geometry_msgs/PoseStamped", header=header_of(time_ns, frame), pose=placed)


def path_message(
    time_ns: int, frame: str, stamps_ns: Sequence[int], places_m: Float64, yaw_rad: Float64
) -> Any:
    """A nav_msgs/Path through places [n, 3] with a stamp and a yaw each."""
    poses = [
        pose_stamped(int(stamp), frame, pose(x, y, z, yaw))
        for stamp, (x, y, z), yaw in zip(
            stamps_ns, places_m.tolist(), yaw_rad.tolist(), strict=True
        )
    ]
    return new("nav_msgs/Path", header=header_of(time_ns, frame), poses=poses)


def transform(time_ns: int, parent: str, child: str, at_m: Float64, turn: Any) -> Any:
    """A geometry_msgs/TransformStamped: where the child is, and its turn, seen from the parent."""
    placed = new("geometry_msgs/Transform", translation=vector(*at_m.tolist()), rotation=turn)
    return new(
        "geometry_msgs/TransformStamped",
        header=header_of(time_ns, parent),
        child_frame_id=child,
        transform=placed,
    )


def transforms(*placed: Any) -> Any:
    """A tf2_msgs/TFMessage."""
    return new("tf2_msgs/TFMessage", transforms=list(placed))


def imu_message(
    time_ns: int,
    frame: str,
    rates_rad_s: tuple[float, float, float],
    force_mps2: tuple[float, float, float] | None = None,
) -> Any:
    """A sensor_msgs/Imu of rates and forces along forward, left, up; the message says what it has
    not."""
    missing = np.array([-1.0, *[0.0] * 8])
    return new(
        "sensor_msgs/Imu",
        header=header_of(time_ns, frame),
        orientation=turn_left(0.0),
        orientation_covariance=missing,
        angular_velocity=vector(*rates_rad_s),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*(force_mps2 or (0.0, 0.0, 0.0))),
        linear_acceleration_covariance=missing if force_mps2 is None else np.zeros(9),
    )


def odometry_message(time_ns: int, speed_mps: float) -> Any:
    """A nav_msgs/Odometry of the speed alone: its pose is said to be unknown."""
    twist = new(
        "geometry_msgs/Twist", linear=vector(speed_mps, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)
    )
    return new(
        "nav_msgs/Odometry",
        header=header_of(time_ns, "odom"),
        child_frame_id=BASE,
        pose=new(
            "geometry_msgs/PoseWithCovariance",
            pose=pose(0.0, 0.0),
            covariance=np.diag([NOT_SAID] * 6).reshape(-1),
        ),
        twist=new("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def image_message(pixels: AnyArray, encoding: str, header: Any) -> Any:
    """A sensor_msgs/Image of pixels [row, column]."""
    height, width = pixels.shape
    return new(
        "sensor_msgs/Image",
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=np.ascontiguousarray(pixels).view(np.uint8).reshape(-1),
    )


def compressed_image(data: bytes, header: Any) -> Any:
    """A sensor_msgs/CompressedImage of a JPEG or a PNG."""
    return new(
        "sensor_msgs/CompressedImage",
        header=header,
        format="png" if data.startswith(b"\x89PNG") else "jpeg",
        data=np.frombuffer(data, dtype=np.uint8),
    )


def camera_info(
    camera: StereoCamera | DepthCamera, cx_px: float, shift_px_m: float, header: Any
) -> Any:
    """A sensor_msgs/CameraInfo of one side of a rectified pair, or of depth images; `shift_px_m` is
    P[3]."""
    if isinstance(camera, StereoCamera):
        fx, fy = camera.focal_px, camera.focal_px
    else:
        fx, fy = camera.fx_px, camera.fy_px
    cx, cy = cx_px, camera.cy_px
    whole = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return new(
        "sensor_msgs/CameraInfo",
        header=header,
        height=camera.height_px,
        width=camera.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        r=np.eye(3).reshape(-1),
        p=np.array([fx, 0.0, cx, shift_px_m, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
        binning_x=0,
        binning_y=0,
        roi=new("sensor_msgs/RegionOfInterest", **whole),
    )


def cloud_message(sweep: Sweep, header: Any) -> Any:
    """A sensor_msgs/PointCloud2 of points, metres, with their times after the stamp, seconds,
    where they have any."""
    data, names = np.ascontiguousarray(sweep.points_m, dtype="<f4"), ["x", "y", "z"]
    if sweep.after_s is not None:
        data, names = np.column_stack([data, sweep.after_s]).astype("<f4"), [*names, "time"]
    fields = [
        new("sensor_msgs/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate(names)
    ]
    return new(
        "sensor_msgs/PointCloud2",
        header=header,
        height=1,
        width=len(data),
        fields=fields,
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * data.size,
        data=data.view(np.uint8).reshape(-1),
        is_dense=True,
    )
