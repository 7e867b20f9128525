"""A map for Nav2 and RViz: what a bag of it has latched, the masks of Nav2's filters, keep-outs
that are clicked, and whether the paths of a planner are clear in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import ConfigError
from fieldgrid.export import (
    SPEED_FILTER,
    BagContent,
    SpeedOptions,
    occupancy_grid,
    speed_mask,
    standing_messages,
)
from fieldgrid.geometry import Datum, resampled
from fieldgrid.live.ros.node import RosNode
from fieldgrid.maps import (
    INSCRIBED,
    OCCUPIED,
    Costmap,
    MapFile,
    Mark,
    MarkKind,
    Selection,
    open_map,
)
from fieldgrid.recordings import MAP, Message, datum_message, decode, ros_messages

_KEEPOUT_FILTER = 0, 0.0, 1.0
"""Type, base and multiplier of the filter of keep-outs, which takes no others."""

MOST_M = 50_000.0
"""A longer path is none of this map."""


class MapServer:
    """Publishes a part of a map, and again when that has changed; the speed mask where `speed` has
    a limit.

    Each nav_msgs/Path on `plan` is answered: whether all of it is known and far enough from
    obstacles for the robot (`plan_clear`), metres to the nearest one (`plan_clearance`), and the
    first bad place (`plan_blocked_at`). A path in another frame than `map`, or of places that are
    none, is not clear.

    Points on `clicked_point` are the corners of a keep-out, which the service `mark_keepout` puts
    into the map as a mark: one is a mark of its cell, three or more a polygon. Those that count
    until now are told on `clicked_polygon`.

    ConfigError for a part that is too large for one message.
    """

    def __init__(
        self,
        ros: RosNode,
        path: Path,
        selection: Selection,
        robot_radius_m: float = 0.5,
        speed: SpeedOptions | None = None,
    ) -> None:
        self._ros, self._path, self._selection = ros, path, selection
        self._robot_radius_m, self._speed = robot_radius_m, speed or SpeedOptions()
        self._corners: list[tuple[float, float]] = []
        self.publish()
        for topic, type_, take in (
            ("plan", "nav_msgs/msg/Path", self._check),
            ("clicked_point", "geometry_msgs/msg/PointStamped", self._click),
        ):
            ros.subscribe(ros.node.resolve_topic_name(topic), type_, take)
        ros.serve("mark_keepout", self._mark)

    def publish(self) -> str:
        """Publish the map as it is now, and say which."""
        with open_map(self._path) as universal:
            self._publish(universal)
        return f"the map is {self._path}"

    def _publish(self, universal: MapFile) -> None:
        curve, part = self._speed.curve(), self._selection
        view = part.view(universal, decide=part.layer)
        content = BagContent.of(universal, part, curve)
        self._costmap = Costmap.from_map(
            *(universal, part.bounds, part.cell_m),
            at=part.at,
            robot_radius_m=self._robot_radius_m,
        )
        for one in standing_messages(content):
            topic = one.topic
            if topic == "/tf_static":
                del one.message.transforms[1:]  # the robot says itself where its antenna is
            else:
                topic = topic.lstrip("/")  # in the namespace of the node
            self._ros.publish(topic, one.message, latched=True)
        publish_datum(self._ros, view.datum, content.start_ns)
        decision = view.decision(curve.least_drop_m)
        keepout = np.zeros(view.window.shape, dtype=np.int8)
        if decision.keepout is not None:
            keepout[decision.keepout] = OCCUPIED
        masks = {"keepout": (keepout, _KEEPOUT_FILTER)}
        if self._speed.slow_percent is not None:
            slow = speed_mask(view, curve.occupancy(*decision), keepout, self._speed)
            masks["speed"] = slow, SPEED_FILTER
        for kind, (values, told) in masks.items():
            grid = occupancy_grid(view.lattice, view.window, values, content.start_ns)
            self._publish_mask(kind, grid, told)

    def _publish_mask(self, kind: str, grid: Any, told: tuple[int, float, float]) -> None:
        """Publish a mask, and what Nav2's filter is to be told of it."""
        topic = f"{kind}_filter_mask"
        self._ros.publish(topic, grid, latched=True)
        type_, base, multiplier = told
        info = ros_messages.new(
            "nav2_msgs/CostmapFilterInfo",
            header=grid.header,
            type=type_,
            filter_mask_topic=self._ros.node.resolve_topic_name(topic),
            base=base,
            multiplier=multiplier,
        )
        self._ros.publish(f"{kind}_costmap_filter_info", info, latched=True)

    def _click(self, message: Message) -> None:
        clicked = decode(message)
        frame, at = clicked.header.frame_id, clicked.point
        if frame == MAP:
            self._corners.append((at.x, at.y))
            corners = [ros_messages.vector(x, y, 0.0, name="Point32") for x, y in self._corners]
            polygon = ros_messages.new("geometry_msgs/Polygon", points=corners)
            shown = "geometry_msgs/PolygonStamped"
            clicked = ros_messages.new(shown, header=clicked.header, polygon=polygon)
            self._ros.publish("clicked_polygon", clicked, latched=True)
        else:
            self._ros.say(f"a point was clicked in the frame {frame}; click in the frame {MAP}")

    def _mark(self) -> str:
        """Put what was clicked into the map. FieldgridError where it is no point or polygon."""
        corners, self._corners = tuple(self._corners), []
        if not corners:
            raise ConfigError("No point was clicked; click the corners, and call this again.")
        with open_map(self._path, writable=True) as universal:
            (number,) = universal.add_marks([Mark(MarkKind.KEEPOUT, corners)])
        self.publish()
        return f"keep-out {number} is in the map {self._path}"

    def _check(self, message: Message) -> None:
        plan, new = decode(message), ros_messages.new
        places = [one.pose.position for one in plan.poses]
        line = np.array([(at.x, at.y) for at in places], dtype=np.float64).reshape(-1, 2)
        step_m = self._costmap.lattice.cell_m / 2.0
        with np.errstate(over="ignore", invalid="ignore"):
            is_path = np.hypot(*np.diff(line, axis=0).T).sum() < MOST_M and bool(len(line))
        if plan.header.frame_id != MAP or not (is_path and np.isfinite(line).all()):
            self._ros.publish("plan_clear", new("std_msgs/Bool", data=False))
            return
        line = resampled(line, step_m)
        barred = np.flatnonzero(self._costmap.cost(*line.T) >= INSCRIBED)
        self._ros.publish("plan_clear", new("std_msgs/Bool", data=not len(barred)))
        clearances_m = self._costmap.clearance_m(*line.T)
        if np.isfinite(clearances_m).any():
            clearance = new("std_msgs/Float32", data=float(np.nanmin(clearances_m)))
            self._ros.publish("plan_clearance", clearance)
        if len(barred):
            x, y = line[barred[0]].tolist()
            at = ros_messages.vector(x, y, 0.0, name="Point")
            blocked = new("geometry_msgs/PointStamped", header=plan.header, point=at)
            self._ros.publish("plan_blocked_at", blocked)


def publish_datum(ros: RosNode, datum: Datum, time_ns: int) -> None:
    """Publish where the frame `map` is on Earth."""
    ros.publish("datum", datum_message(datum, time_ns), latched=True)
    point = ros_messages.new(
        "geographic_msgs/GeoPoint",
        latitude=datum.lat_deg,
        longitude=datum.lon_deg,
        altitude=datum.height_m,
    )
    ros.publish("datum/point", point, latched=True)
