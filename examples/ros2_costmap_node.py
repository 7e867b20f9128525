#!/usr/bin/env python3
"""A node of ROS 2 that asks a map: is the path that a planner has made clear?

    python3 ros2_costmap_node.py --ros-args -p map:=field.gpkg -p robot_radius_m:=0.6

Paths are in the frame `map`: x metres east, y metres north of the map's datum. The map is read
once, at the start; no map server is needed. `fieldgrid` must be importable by the Python of ROS.

Subscribed:  plan (nav_msgs/Path)
Published:   plan_clear (std_msgs/Bool, true only where all of the path is known and far enough from
             obstacles), plan_clearance (std_msgs/Float32, metres from the path's middle line to the
             nearest obstacle), plan_blocked_at (geometry_msgs/PointStamped, the first bad place)
"""

from itertools import pairwise

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Bool, Float32

import fieldgrid as fg

TOO_NEAR = 253
"""Costs from here on: within the robot's radius of an obstacle, an obstacle, unknown."""

MOST_STEPS = 1_000_000
"""A path of more of them is no path of this map: 50 km for cells of 0.1 m."""

WORDS = {253: "too near an obstacle", 254: "in an obstacle", 255: "on ground that was never seen"}


class PathCheck(Node):
    """Compares each path with the map."""

    def __init__(self):
        super().__init__("fieldgrid_path_check")
        path = self._parameter("map", "field.gpkg")
        cell_m = self._parameter("cell_m", 0.1)
        radius_m = self._parameter("robot_radius_m", 0.5)
        self._frame = self._parameter("map_frame", "map")
        with fg.open_map(path) as universal:
            self.costmap = fg.Costmap.from_map(universal, cell_m=cell_m, robot_radius_m=radius_m)
        self._step_m = cell_m / 2
        self._clear = self.create_publisher(Bool, "plan_clear", 10)
        self._clearance = self.create_publisher(Float32, "plan_clearance", 10)
        self._blocked_at = self.create_publisher(PointStamped, "plan_blocked_at", 10)
        self.create_subscription(Path, "plan", self._take_plan, 10)
        self.get_logger().info(f"{path}: {self.costmap.bounds}")

    def _parameter(self, name, usual):
        return self.declare_parameter(name, usual).value

    def _take_plan(self, plan):
        """Publish whether a path is clear. A path in another frame, without poses, with one that is
        not finite, or of no sensible length is not."""
        if plan.header.frame_id != self._frame or not plan.poses:
            self.get_logger().warning(
                f"A path of {len(plan.poses)} poses in the frame {plan.header.frame_id!r}; "
                f"the map is in {self._frame!r}."
            )
            self._clear.publish(Bool(data=False))
            return
        points_m = np.array([(p.pose.position.x, p.pose.position.y) for p in plan.poses])
        steps = steps_between(points_m, self._step_m)
        if not steps.sum() <= MOST_STEPS:
            odd = np.count_nonzero(~np.isfinite(points_m).all(axis=1))
            self.get_logger().warning(
                f"A path of {len(points_m)} poses, {odd} of them not finite, which takes "
                f"{steps.sum():.0f} steps of {self._step_m:g} m; up to {MOST_STEPS} are compared."
            )
            self._clear.publish(Bool(data=False))
            return
        east_m, north_m = along(points_m, steps).T
        costs = self.costmap.cost(east_m, north_m)
        bad = np.flatnonzero(costs >= TOO_NEAR)
        self._clear.publish(Bool(data=not len(bad)))
        clearances_m = self.costmap.clearance_m(east_m, north_m)
        if np.isfinite(clearances_m).any():
            self._clearance.publish(Float32(data=float(np.nanmin(clearances_m))))
        if len(bad):
            first = bad[0]
            message = PointStamped(header=plan.header)
            message.point.x, message.point.y = float(east_m[first]), float(north_m[first])
            self._blocked_at.publish(message)
            self.get_logger().warning(
                f"The path is {WORDS[int(costs[first])]} at {east_m[first]:.2f} m east, "
                f"{north_m[first]:.2f} m north."
            )


def steps_between(points_m, step_m):
    """How many steps of at most `step_m` lead to each point, none to the first; NaN or infinite
    where a point is not finite or too far away."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths_m = np.hypot(*np.diff(points_m, axis=0, prepend=points_m[:1]).T)
        return np.append(0.0 * lengths_m[:1], np.maximum(1.0, np.ceil(lengths_m[1:] / step_m)))


def along(points_m, steps):
    """The points of a line and those of the steps between them; [n, 2] of metres."""
    parts = [points_m[:1]]
    for (start, end), count in zip(pairwise(points_m), steps[1:].astype(int), strict=True):
        parts.append(start + (end - start) * np.linspace(0.0, 1.0, count + 1)[1:, np.newaxis])
    return np.concatenate(parts)


def main():
    rclpy.init()
    node = PathCheck()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
