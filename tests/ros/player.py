"""Plays a bag on real topics, as `ros2 bag play` does."""

from __future__ import annotations

import time
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

AHEAD_S = 3.0
"""What is latched, and a camera's calibrations, are sent so long before the rest, so that all
subscribers are there."""


def type_of(name: str) -> Any:
    package, _, short = name.split("/")
    return getattr(import_module(f"{package}.msg"), short)


def play(node: Node, bag: Path, rate: float, without: Collection[str] = ()) -> None:
    """Send all messages but those of some topics, `rate` times as fast as they were recorded."""
    with bag.open("rb") as file:
        messages = [
            (message.log_time, channel.topic, message.data, schema.name, dict(channel.metadata))
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=True)
            if schema is not None and channel.topic not in without
        ]
    publishers = {}
    for _, topic, _, type_, about in messages:
        if topic not in publishers:
            latched = "offered_qos_profiles" in about
            qos = QoSProfile(depth=1000, durability=DurabilityPolicy(1 if latched else 2))
            publishers[topic] = node.create_publisher(type_of(type_), topic, qos)
    time.sleep(AHEAD_S)
    began_s, began_ns = time.monotonic(), messages[0][0]
    for time_ns, topic, data, _, _ in messages:
        due_s = began_s + (time_ns - began_ns) / 1e9 / rate
        time.sleep(max(0.0, due_s - time.monotonic()))
        publishers[topic].publish(data)
