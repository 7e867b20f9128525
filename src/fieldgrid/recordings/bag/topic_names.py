"""What the name of a topic says of it: which side of a pair, how good a source for a role."""

from __future__ import annotations

import re

# How names tell the two sides apart: what stands in a left topic, and in its right partner.
_SIDES = tuple(
    (re.compile(rf"(?<![a-z]){left}(?![a-z0-9])", re.IGNORECASE), right)
    for left, right in (
        *(("left", "right"), ("l", "r"), ("cam0", "cam1"), ("cam_0", "cam_1")),
        *(("camera0", "camera1"), ("camera_0", "camera_1"), ("image_0", "image_1")),
        *(("infra1", "infra2"), ("infra_1", "infra_2")),
    )
)


MADE = re.compile(r"filter|ground|obstacle|cluster|map|accumul|global|segment|debug")


def _driven(name: str) -> int:
    """Wheels before whatever else estimates a speed; estimates that contain the fixes last."""
    if re.search(r"gps|gnss|navsat|global|map", name.lower()):
        return 3
    if MADE.search(name.lower()) or re.search(r"ekf|visual|vio|vo\b", name.lower()):
        return 2
    return 0 if re.search(r"wheel|controller|drive|encoder", name.lower()) else 1


def _imu_rank(name: str) -> tuple[bool, bool, bool, bool]:
    """With a gyro before without, the vehicle's own before one inside a camera, calibrated before
    raw."""
    inside = re.search(r"camera|zed|oak|realsense|d4\d\d|ouster|livox|velodyne", name.lower())
    is_raw = "raw" in name.lower()
    return "accel" in name.lower(), inside is not None, is_raw, not name.endswith("data")


def worth(role: str, name: str) -> tuple[int, ...]:
    """How good a name is for a role, the lowest being the best."""
    if role == "imu":
        return _imu_rank(name)
    if role == "odometry":
        return (_driven(name),)
    return (role == "fix" and MADE.search(name.lower()) is not None,)


def base_name(name: str) -> str:
    """An image topic without what its transport appends."""
    return name.removesuffix("/compressed").removesuffix("/compressedDepth")


def namespace(name: str) -> str:
    """The part of an image topic that it shares with its calibration."""
    return base_name(name).rpartition("/")[0]


def right_partners(left: str) -> list[str]:
    """Names that the right partner of a left topic may have."""
    named = (pattern.sub(right, left) for pattern, right in _SIDES)
    return [name for name in named if name != left]


def side_of(name: str) -> str:
    """ "left", "right", or "" where a name says neither."""
    if right_partners(name):
        return "left"
    rights = (rf"(?<![a-z]){right}(?![a-z0-9])" for _, right in _SIDES)
    return "right" if any(re.search(p, name, re.IGNORECASE) for p in rights) else ""
