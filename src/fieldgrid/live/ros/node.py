"""A node of ROS 2 that takes and gives messages as bytes: what they mean is the work of the readers
of bags, so that of rclpy only the transport is used."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

from fieldgrid.core import Closing, ConfigError, FieldgridError
from fieldgrid.recordings import Connection, Message, encoded

_QUIET = ("--ros-args", "--disable-stdout-logs")
_DEPTH = 100
"""Messages of a topic that wait until they are taken."""


class RosNode(Closing):
    """The node `fieldgrid`, whose callbacks run in a thread of its own until it is closed. What
    follows --ros-args on the command line is for ROS: names, remappings, parameters.

    ConfigError where rclpy is not installed.
    """

    def __init__(self, arguments: list[str] | None = None) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            raise ConfigError(
                "ROS 2 needs rclpy, which this Python does not have; source the setup file of ROS "
                "2 with its own Python, or with Python 3.12 run: pip install 'fieldgrid[ros]'."
            ) from error
        self._context = rclpy.Context()
        given = sys.argv if arguments is None else arguments
        # What it says goes to /rosout; the program has another way to stderr.
        rclpy.init(args=[*given, *_QUIET], context=self._context)
        self.node = rclpy.create_node("fieldgrid", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._executor.spin, name="fieldgrid-ros")
        self._thread.start()

    def close(self) -> None:
        """Leave the graph, once what was published has arrived or a second has passed."""
        if self._context.ok():
            from rclpy.duration import Duration

            for publisher in filter(None, self._publishers.values()):
                publisher.wait_for_all_acked(Duration(seconds=1))
            self._executor.shutdown()
            self._thread.join()
            self.node.destroy_node()
            self._context.shutdown()

    def say(self, text: str) -> None:
        """Tell something on /rosout."""
        self.node.get_logger().warning(text)

    def remapped(self, names: tuple[str, ...]) -> dict[str, str]:
        """The topics to which names were remapped."""
        above = self.node.get_namespace().rstrip("/")
        topics = {name: self.node.resolve_topic_name(name) for name in names}
        return {name: topic for name, topic in topics.items() if topic != f"{above}/{name}"}

    def topics(self) -> dict[str, str]:
        """The types of all topics."""
        found = self.node.get_topic_names_and_types()
        return {name: types[0] for name, types in found if len(types) == 1}

    def subscribe(self, topic: str, type_: str, take: Callable[[Message], None]) -> Any:
        """Take the messages of a topic, as reliably and from as far back as all of its publishers
        offer them; None where its type is not installed."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        kind, connection = _type(type_), Connection(topic, type_, "cdr", None)
        if kind is None:
            return None
        offers = [one.qos_profile for one in self.node.get_publishers_info_by_topic(topic)]
        reliable = bool(offers) and all(
            one.reliability == ReliabilityPolicy.RELIABLE for one in offers
        )
        lasting = bool(offers) and all(
            one.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in offers
        )
        qos = QoSProfile(
            depth=_DEPTH,
            reliability=ReliabilityPolicy(1 if reliable else 2),
            durability=DurabilityPolicy(1 if lasting else 2),
        )
        return self.node.create_subscription(
            *(kind, topic, lambda data: take(Message(connection, time.time_ns(), data)), qos),
            raw=True,
        )

    def serve(self, name: str, answer: Callable[[], str]) -> None:
        """Offer a service without arguments (std_srvs/Trigger), whose answer is a text, or the
        sentence of a FieldgridError."""
        from std_srvs.srv import Trigger

        def called(_: Any, response: Any) -> Any:
            try:
                response.message, response.success = answer(), True
            except FieldgridError as error:
                response.message = str(error)
            return response

        self.node.create_service(Trigger, name, called)

    def publish(self, topic: str, message: Any, *, latched: bool = False) -> bool:
        """Send a message of ours; whoever comes later gets the last one that was `latched`. False
        where its type is not installed."""
        if topic not in self._publishers:
            from rclpy.qos import DurabilityPolicy, QoSProfile

            kind = _type(message.__msgtype__)
            qos = QoSProfile(depth=1 if latched else 10, durability=DurabilityPolicy(2 - latched))
            made = None if kind is None else self.node.create_publisher(kind, topic, qos)
            self._publishers[topic] = made
        publisher = self._publishers[topic]
        if publisher is not None:
            publisher.publish(encoded(message))
        return publisher is not None

    def listeners(self, topic: str) -> int:
        """How many subscribe to what is published on a topic."""
        publisher = self._publishers.get(topic)
        return 0 if publisher is None else int(publisher.get_subscription_count())


def _type(name: str) -> Any:
    """The class of a type such as std_msgs/msg/String; None where it is not installed."""
    package, _, short = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), short, None)
    except ImportError:
        return None
