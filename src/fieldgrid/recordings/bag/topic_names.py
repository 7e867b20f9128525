"""The types of topics, and what the name of one says of it: which side of a pair, how good a source
for a role.

The recorder of RealSense's tools names topics `/device_0/sensor_0/Infrared_1/image/data`, with
`info/camera_info` and `tf/0` beside `image`, and options such as `option/Depth_Units/value` beside
the streams of a sensor; a message names no frame. That is `src/media/ros/ros_file_format.h` and
`ros_writer.cpp` in github.com/IntelRealSense/librealsense; by `doc/d435i.md` there, x points to the
right, y down and z forward in all streams, gyro and accelerometer too.
"""

from __future__ import annotations

import re

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, DISPARITY = "sensor_msgs/msg/CameraInfo", "stereo_msgs/msg/DisparityImage"
CLOUD, FIX, NMEA = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/NavSatFix",
    "nmea_msgs/msg/Sentence",
)
IMU, ODOMETRY = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
POSE, SURE_POSE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TF_STATIC, TF = "/tf_static", ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
PLACE = "geometry_msgs/msg/Transform"
TEXT, NUMBER = "std_msgs/msg/String", "std_msgs/msg/Float32"

# How names tell the two sides apart: what stands in a left topic, and in its right partner.
_SIDES = (
    *(("", "left", "right"), ("", "l", "r")),
    *(("cam_?|camera_?|image_", "0", "1"), ("infra_?|infrared_", "1", "2")),
)
_LEFT, _RIGHT = (
    [re.compile(rf"(?<![a-z])({row[0]}){row[k]}(?![a-z0-9])", re.IGNORECASE) for row in _SIDES]
    for k in (1, 2)
)
_STREAM = re.compile(r"((?:/device_\d+)/sensor_\d+)(/[A-Z][A-Za-z]*_\d+)/")


_RECTIFIED = re.compile(r"(?<![a-z])rect")
MADE = re.compile(r"filter|ground|obstacle|cluster|map|accumul|global|segment|debug")

_DRIVEN = (
    re.compile(r"gps|gnss|navsat|global|map"),
    re.compile(r"ekf|visual|vio|vo\b"),
    re.compile(r"wheel|controller|drive|encoder"),
)


def is_made(name: str) -> bool:
    """Whether a topic is made of others."""
    return MADE.search(name.lower()) is not None


def driven_rank(name: str) -> tuple[bool, bool, bool]:
    """Wheels before whatever else estimates a speed; estimates that contain the fixes last."""
    of_fixes, made, wheels = (pattern.search(name.lower()) is not None for pattern in _DRIVEN)
    return of_fixes, made or is_made(name), not wheels


def imu_rank(name: str) -> tuple[bool, bool, bool, bool]:
    """With a gyro before without, the vehicle's own before one inside a camera, calibrated before
    raw."""
    inside = re.search(r"camera|zed|oak|realsense|d4\d\d|ouster|livox|velodyne", name.lower())
    is_raw = "raw" in name.lower()
    return "accel" in name.lower(), inside is not None, is_raw, not name.endswith("data")


def pair_rank(left: str, type_: str) -> tuple[bool, bool, bool]:
    """Rectified before raw, grey before colour, plain before compressed."""
    is_coloured = re.search(r"colou?r|rgb", left.lower()) is not None
    return not is_rectified(left), is_coloured, type_ == COMPRESSED


def accelerometer(gyro: str) -> str:
    """The topic of the accelerometer that goes with a gyro on a topic of its own; the topic itself
    where the name is of no gyro."""
    return re.sub(
        "gyro", lambda found: "Accel" if found[0][0] == "G" else "accel", gyro, flags=re.I
    )


def is_rectified(topic: str) -> bool:
    """Whether an image topic is named as a rectified one, like `image_rect` or `rect/image`."""
    return any(_RECTIFIED.search(word) for word in base_name(topic).lower().split("/")[-2:])


def base_name(name: str) -> str:
    """An image topic without what its transport appends."""
    return name.removesuffix("/compressed").removesuffix("/compressedDepth")


def namespace(name: str) -> str:
    """The part of an image topic that it shares with its calibration."""
    return base_name(name).rpartition("/")[0]


def right_partners(left: str) -> list[str]:
    """Names that the right partner of a left topic may have."""
    named = (
        pattern.sub(rf"\g<1>{row[2]}", left) for pattern, row in zip(_LEFT, _SIDES, strict=True)
    )
    return [name for name in named if name != left]


def side_of(name: str) -> str:
    """ "left", "right", or "" where a name says neither."""
    if right_partners(name):
        return "left"
    return "right" if any(pattern.search(name) for pattern in _RIGHT) else ""


def stream_frame(name: str) -> str:
    """The frame of a stream by a topic of RealSense's recorder; empty for other topics."""
    found = _STREAM.match(name)
    return f"{found[1]}{found[2]}/optical".lstrip("/") if found else ""


def unit_topic(name: str) -> str:
    """The topic of the unit of depths in metres, of the sensor that an image is of."""
    found = _STREAM.match(name)
    return f"{found[1]}/option/Depth_Units/value" if found else ""
