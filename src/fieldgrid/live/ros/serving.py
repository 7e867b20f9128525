"""A map for Nav2 and RViz: what a bag of it has latched, and the mask of its keep-outs; and whether
the paths of a planner are clear in it."""

from __future__ import annotations

import numpy as np

from fieldgrid.export import BagContent, occupancy_grid, standing_messages
from fieldgrid.geometry import Datum, resampled
from fieldgrid.live.ros.node import RosNode
from fieldgrid.maps import INSCRIBED, OCCUPIED, CostCurve, Costmap, MapFile, Selection
from fieldgrid.recordings import MAP, Message, datum_message, decode, ros_messages

MASK, MASK_INFO = "keepout_filter_mask", "keepout_costmap_filter_info"
"""Topics of the mask for Nav2's keepout filter, and of what it is told of it."""


def publish_map(
    ros: RosNode, universal: MapFile, selection: Selection, curve: CostCurve | None = None
) -> None:
    """Publish a part of a map. ConfigError for one that is too large for one message."""
    curve = curve or CostCurve()
    view = selection.view(universal, decide=selection.layer)
    content = BagContent.of(universal, selection, curve)
    for one in standing_messages(content):
        topic = one.topic
        if topic == "/tf_static":
            del one.message.transforms[1:]  # the robot says itself where its antenna is
        else:
            topic = topic.lstrip("/")  # in the namespace of the node
        ros.publish(topic, one.message, latched=True)
    publish_datum(ros, universal.datum, content.start_ns)
    keepout = view.decision(curve.least_drop_m).keepout
    mask = np.zeros(view.window.shape, dtype=np.int8)
    if keepout is not None:
        mask[keepout] = OCCUPIED
    grid = occupancy_grid(view.lattice, view.window, mask, content.start_ns)
    ros.publish(MASK, grid, latched=True)
    info = ros_messages.new(
        "nav2_msgs/CostmapFilterInfo",
        header=ros_messages.header_of(content.start_ns, MAP),
        type=0,
        filter_mask_topic=ros.node.resolve_topic_name(MASK),
        base=0.0,
        multiplier=1.0,
    )
    ros.publish(MASK_INFO, info, latched=True)


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


MOST_M = 50_000.0
"""A longer path is none of this map."""


class PathCheck:
    """Answers each nav_msgs/Path on `plan`: whether all of it is known and far enough from
    obstacles (`plan_clear`), metres to the nearest one (`plan_clearance`), and the first bad place
    (`plan_blocked_at`). A path in another frame than `map`, or of places that are none, is not
    clear."""

    def __init__(self, ros: RosNode, costmap: Costmap) -> None:
        self._ros, self._costmap = ros, costmap
        ros.subscribe(ros.node.resolve_topic_name("plan"), "nav_msgs/msg/Path", self._take)

    def _take(self, message: Message) -> None:
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
