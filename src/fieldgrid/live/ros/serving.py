"""A map for Nav2 and RViz: what a bag of it has latched, and the mask of its keep-outs."""

from __future__ import annotations

import numpy as np

from fieldgrid.export import BagContent, occupancy_grid, standing_messages
from fieldgrid.geometry import Datum
from fieldgrid.live.ros.node import RosNode
from fieldgrid.maps import OCCUPIED, CostCurve, MapFile, Selection
from fieldgrid.recordings import MAP, datum_message, ros_messages

MASK, MASK_INFO = "keepout_filter_mask", "keepout_costmap_filter_info"
"""Topics of the mask for Nav2's keepout filter, and of what it is told of it."""


def publish_map(
    ros: RosNode, universal: MapFile, selection: Selection, curve: CostCurve | None = None
) -> None:
    """Publish a part of a map. ConfigError for one that is too large for one message."""
    curve = curve or CostCurve()
    view = selection.view(universal, universal.deciding(selection.cell_m))
    content = BagContent.of(universal, selection, curve)
    for one in standing_messages(content):
        topic = one.topic
        if topic == "/tf_static":
            del one.message.transforms[1:]  # the robot says itself where its antenna is
        else:
            topic = topic.lstrip("/")  # in the namespace of the node
        ros.publish(topic, one.message, latched=True)
    publish_datum(ros, universal.datum, content.start_ns)
    keepout = view.decision(selection.layer, curve.least_drop_m).keepout
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
