"""What a live session tells, and the map at its end, on the topics of a node."""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.export import occupancy_grid, variances
from fieldgrid.geometry import Datum, Pose, Status, yaw_from_heading_rad
from fieldgrid.live.results import LiveEvent, LivePose, LiveResult, LiveWindow, What
from fieldgrid.live.ros.node import RosNode
from fieldgrid.live.ros.place import RobotFrames
from fieldgrid.live.ros.serving import publish_datum
from fieldgrid.live.ros.so_far import MapSoFar
from fieldgrid.maps import CostCurve, MapView, Selection, open_map
from fieldgrid.recordings import MAP, ros_messages

EACH_S = 1.0
"""The map so far, the path and the diagnostics are published so often."""

MOST_PATH = 10_000
"""Poses of the path."""

OCCUPANCY = np.zeros(256, dtype=np.int8)
"""What Nav2 publishes for costs: 1..252 as 1..98, then 99 and 100; 255 is unknown."""
OCCUPANCY[1:253] = 1 + 97 * np.arange(252) // 251
OCCUPANCY[253], OCCUPANCY[254], OCCUPANCY[255] = 99, 100, -1


class RosOutputs:
    """Publishes results; not from several threads at once. `robot` is the robot's frames, and
    `curve` makes an occupancy of the density of the map so far."""

    def __init__(self, ros: RosNode, robot: RobotFrames, curve: CostCurve) -> None:
        self._ros, self._robot, self._curve = ros, robot, curve
        self._so_far: MapSoFar | None = None
        self._listeners, self._said_s = 0, 0.0
        self._datum: Datum | None = None
        self._path: deque[Pose] = deque(maxlen=MOST_PATH)

    def begin_with(self, path: Path) -> None:
        """Begin the map so far with a map that the drive is added to."""
        with open_map(path) as universal:
            view = Selection().view(universal, decide="density")
        cells = self._curve.occupancy(*view.decision())
        self._so_far = MapSoFar(view.lattice, view.window, cells)

    def take(self, result: LiveResult) -> None:
        """Publish a result."""
        if isinstance(result, LiveEvent):
            if result.what is not What.FRAME_DROPPED:
                self._ros.say(result.text)
        elif isinstance(result, LivePose):
            if result.is_settled and result.pose.status is not Status.REJECTED:
                self._path.append(result.pose)
        elif isinstance(result, LiveWindow):
            self._window(result)

    def _window(self, window: LiveWindow) -> None:
        costmap, time_ns = window.costmap, window.time_ns
        if costmap.datum != self._datum:
            self._datum = costmap.datum
            publish_datum(self._ros, costmap.datum, time_ns)
        costs = costmap.costs if window.is_trusted else np.full_like(costmap.costs, 255)
        grid = occupancy_grid(costmap.lattice, costmap.window, OCCUPANCY[costs], time_ns)
        self._ros.publish("costmap", grid, latched=True)
        pose = window.pose
        if pose is not None and pose.status is not Status.REJECTED and window.is_trusted:
            self._ros.publish("pose", _pose_message(pose))
            self._ros.publish("/tf", self._robot.message(pose))
        if time.monotonic() >= self._said_s + EACH_S:
            self._said_s = time.monotonic()
            self._ros.publish("/diagnostics", _diagnostics(window))
            self._publish_path(time_ns)
            self._map(window.view, time_ns)

    def _publish_path(self, time_ns: int) -> None:
        poses = list(self._path)
        places_m = np.array([(one.east_m, one.north_m, 0.0) for one in poses]).reshape(-1, 3)
        yaw_rad = yaw_from_heading_rad([one.heading_deg for one in poses])
        stamps_ns = [one.time_ns for one in poses]
        path = ros_messages.path_message(time_ns, MAP, stamps_ns, places_m, yaw_rad)
        self._ros.publish("path", path, latched=True)

    def _map(self, view: MapView, time_ns: int) -> None:
        """Publish the map so far: all of it where it grew or somebody is new, else what changed."""
        cells = self._curve.occupancy(view.density, view.observed)
        whole = self._so_far and self._so_far.window
        if self._so_far is None:
            if not view.observed.any():
                return
            self._so_far = MapSoFar(view.lattice, view.window, np.full_like(cells, -1))
        part = self._so_far.take(view.window, cells)
        listeners = self._ros.listeners("map")
        is_new, self._listeners = listeners > self._listeners, listeners
        grown = is_new or self._so_far.window != whole
        if part is not None and not grown:
            update = self._so_far.update(part, time_ns)
            grown = not self._ros.publish("map_updates", update)
        if grown:
            self._ros.publish("map", self._so_far.grid(time_ns), latched=True)


def _pose_message(pose: Pose) -> Any:
    yaw_rad = float(yaw_from_heading_rad(pose.heading_deg))
    position, turn = pose.position_sigma_m, np.radians(pose.heading_sigma_deg)
    return ros_messages.new(
        "geometry_msgs/PoseWithCovarianceStamped",
        header=ros_messages.header_of(pose.time_ns, MAP),
        pose=ros_messages.new(
            "geometry_msgs/PoseWithCovariance",
            pose=ros_messages.pose(pose.east_m, pose.north_m, pose.up_m, yaw_rad),
            covariance=variances([position, position, np.nan, np.nan, np.nan, turn]),
        ),
    )


def _diagnostics(window: LiveWindow) -> Any:
    about = {name: value for name, value in window.as_dict().items() if name != "bounds_m"}
    status = ros_messages.new(
        "diagnostic_msgs/DiagnosticStatus",
        level=0 if window.is_trusted else 1,
        name="fieldgrid",
        message=window.doubt or "the window can be trusted",
        hardware_id="",
        values=[
            ros_messages.new("diagnostic_msgs/KeyValue", key=key, value=str(value))
            for key, value in about.items()
        ],
    )
    header = ros_messages.header_of(window.time_ns, "")
    return ros_messages.new("diagnostic_msgs/DiagnosticArray", header=header, status=[status])
