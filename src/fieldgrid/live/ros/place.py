"""Where a robot is in the map, told as its own frames have it: REP 105."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np

from fieldgrid.geometry import LeverArm, Pose, yaw_from_heading_rad
from fieldgrid.recordings import MAP, FrameTransform, Transforms, ros_messages, told

ORIGIN = "fieldgrid_origin"
"""The frame of poses: on the ground below the sensor."""

_BASES = ("base_footprint", "base_link")
_MOST = 2_000
"""Transforms of the vehicle that are kept: what poses are told of is a second ago."""


class RobotFrames:
    """The tree of a robot's frames, above whose top the frame `map` is put: that is `odom` where
    something publishes where the vehicle is in it, else the vehicle's own frame.

    The origin of poses is where it is by the place of the antenna, whose frame is `antenna_frame`
    and which is `arm` from the origin; where nothing tells that place, in the frame `base_link`.
    """

    def __init__(self, static: Transforms, antenna_frame: str, arm: LeverArm) -> None:
        self._tree, self._lock = static, threading.Lock()
        self._moved = deque[tuple[int, str, FrameTransform]](maxlen=_MOST)
        arm_m = np.array([arm.forward_m, -arm.right_m, arm.up_m])
        base, at_m = _BASES[1], arm_m
        for frame in _BASES:
            placed = static.place(antenna_frame, frame)
            if placed is not None:
                base, at_m = frame, placed.at_m
                break
        static.put(ORIGIN, base, FrameTransform(np.eye(3), at_m - arm_m))
        self._top = static.top(ORIGIN)

    def moved(self, message: Any) -> None:
        """Take what a message says of where the vehicle is in a frame above it."""
        for one, child, parent, place in told(message):
            if child == self._top and parent != MAP:
                stamp = one.header.stamp
                with self._lock:
                    at_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
                    self._moved.append((at_ns, parent, place))

    def message(self, pose: Pose) -> Any:
        """The tf2_msgs/TFMessage of a pose."""
        yaw = float(yaw_from_heading_rad(pose.heading_deg))
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        with self._lock:
            moved = list(self._moved)
        if moved:
            _, parent, place = min(moved, key=lambda one: abs(one[0] - pose.time_ns))
            self._tree.put(self._top, parent, place)
        top = self._tree.top(ORIGIN)
        at = self._tree.place(top, ORIGIN)
        assert at is not None
        at_m = np.array([pose.east_m, pose.north_m, pose.up_m]) + turn @ at.at_m
        turned = ros_messages.quaternion(turn @ at.R)
        return ros_messages.transforms(ros_messages.transform(pose.time_ns, MAP, top, at_m, turned))
