"""Plays a bag on real topics, as `ros2 bag play` does, and hears what others publish."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from mcap.reader import make_reader
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

PATIENCE_S = 120.0


def type_of(name: str) -> Any:
    package, kind, short = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), short)


class OtherNode:
    """Another node of the graph; a context manager."""

    def __init__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("other", context=self._context)
        self.heard: dict[str, list[Any]] = defaultdict(list)
        self.order: list[tuple[str, Any]] = []
        """What was heard with its topic, in the order in which it came."""
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin)

    def __enter__(self) -> OtherNode:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()
        self._context.shutdown()

    def hear(self, topic: str, type_: str, *, latched: bool = False) -> None:
        """Subscribe as displays of RViz do: reliably, to a map as to something that is latched."""
        qos = QoSProfile(
            depth=5,
            durability=DurabilityPolicy(1 if latched else 2),
            reliability=ReliabilityPolicy.RELIABLE,
        )

        def take(message: Any) -> None:
            self.heard[topic].append(message)
            self.order.append((topic, message))

        self.node.create_subscription(type_of(type_), topic, take, qos)

    def publisher(self, topic: str, type_: str, *, latched: bool = False) -> Any:
        qos = QoSProfile(depth=1000, durability=DurabilityPolicy(1 if latched else 2))
        return self.node.create_publisher(type_of(type_), topic, qos)

    def wait(self, until: Callable[[], object]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not until():
            assert time.monotonic() < end_s, "it does not come"
            time.sleep(0.05)

    def call(self, service: str) -> Any:
        client = self.node.create_client(type_of("std_srvs/srv/Trigger"), service)
        assert client.wait_for_service(timeout_sec=PATIENCE_S)
        answer = client.call_async(type_of("std_srvs/srv/Trigger").Request())
        self.wait(answer.done)
        return answer.result()

    def play(self, bag: Path, rate: float, sent: Callable[[int], None] = lambda _: None) -> None:
        """Send all messages, `rate` times as fast as they were recorded, once somebody listens;
        `sent` is told the time of each."""
        with bag.open("rb") as file:
            messages = [
                (message.log_time, channel.topic, message.data, schema.name, channel.metadata)
                for schema, channel, message in make_reader(file).iter_messages()
                if schema is not None
            ]
        publishers: dict[str, Any] = {}
        for _, topic, _, type_, about in messages:
            if topic not in publishers:
                latched = "offered_qos_profiles" in about
                publishers[topic] = self.publisher(topic, type_, latched=latched)
        images = [one for topic, one in publishers.items() if "image" in topic]
        self.wait(lambda: all(one.get_subscription_count() for one in images))
        began_s, began_ns = time.monotonic(), messages[0][0]
        for time_ns, topic, data, _, _ in messages:
            due_s = began_s + (time_ns - began_ns) / 1e9 / rate
            time.sleep(max(0.0, due_s - time.monotonic()))
            publishers[topic].publish(data)
            sent(time_ns)
