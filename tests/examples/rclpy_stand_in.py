"""Stands for rclpy where ROS is not installed: as much of it as a node of one file needs.

Messages are as strict as those of rclpy: made without arguments, all fields are set to what is
empty; a field takes a value of its own type alone. Types and their bytes are those of rosbags.
"""

from __future__ import annotations

import sys
import threading
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)

_LISTS = {"int8": "b", "uint8": "B", "float64": "d"}


def message_class(name: str) -> type[Any]:
    """The class of the messages of a type, such as nav_msgs/msg/OccupancyGrid."""
    if name not in _classes:
        fields = dict(STORE.get_msgdef(name).fields)
        _classes[name] = type(name.rpartition("/")[2], (_Message,), {"NAME": name, "TYPES": fields})
    return _classes[name]


_classes: dict[str, type[Any]] = {}


class _Message:
    NAME = ""
    TYPES: dict[str, Any] = {}  # noqa: RUF012 - each class has its own

    def __init__(self, **values: Any) -> None:
        for name, kind in self.TYPES.items():
            setattr(self, name, values.pop(name) if name in values else _empty(kind))
        assert not values, f"{self.NAME} has no {list(values)}"

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in self.TYPES, f"{self.NAME} has no field {name}"
        assert _fits(self.TYPES[name], value), f"{self.NAME}.{name} does not take {value!r:.60}"
        super().__setattr__(name, value)

    def of_rosbags(self) -> Any:
        """The same message as rosbags has it."""
        values = {name: _of_rosbags(kind, getattr(self, name)) for name, kind in self.TYPES.items()}
        return STORE.types[self.NAME](**values)


def _empty(kind: Any) -> Any:
    node, what = kind
    if node == Nodetype.NAME:
        return message_class(what)()
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(what[0], 0.0 if "float" in what[0] else 0)
    (_, (base, _)), count = what if what[0][0] == Nodetype.BASE else ((0, ("", 0)), 0)
    if node == Nodetype.ARRAY:
        return [0.0] * count
    return array(_LISTS[base]) if base in _LISTS else []


def _fits(kind: Any, value: Any) -> bool:
    node, what = kind
    if node == Nodetype.NAME:
        return isinstance(value, message_class(what))
    if node == Nodetype.BASE:
        wanted = {"string": str, "bool": bool}.get(what[0], float if "float" in what[0] else int)
        if not isinstance(value, wanted):
            return False
        return not what[0].startswith("uint") or 0 <= value < 1 << int(what[0].removeprefix("uint"))
    if node == Nodetype.ARRAY:
        return isinstance(value, Sequence) and len(value) == what[1]
    base = what[0][1][0] if what[0][0] == Nodetype.BASE else ""
    if base in _LISTS:
        return isinstance(value, array) and value.typecode == _LISTS[base]
    return isinstance(value, list)


def _of_rosbags(kind: Any, value: Any) -> Any:
    node, what = kind
    if node == Nodetype.NAME:
        return value.of_rosbags()
    if node == Nodetype.BASE:
        return value
    return np.array(value, dtype=what[0][1][0])


class Logger:
    """Keeps what is said, by its level."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str]] = []

    def info(self, text: str) -> None:
        self.said.append(("info", text))

    def warning(self, text: str) -> None:
        self.said.append(("warning", text))

    def error(self, text: str, *, throttle_duration_sec: float) -> None:
        self.said.append(("error", text))


class Publisher:
    """Keeps the bytes of what is published, as they would go out."""

    def __init__(self, kind: type[Any]) -> None:
        self._kind, self._changed = kind, threading.Condition()
        self.sent: list[Any] = []

    def publish(self, message: Any) -> None:
        assert isinstance(message, self._kind)
        name = message.NAME
        data = STORE.serialize_cdr(message.of_rosbags(), name)
        with self._changed:
            self.sent.append(STORE.deserialize_cdr(data, name))
            self._changed.notify_all()

    def wait(self, is_so: Callable[[list[Any]], bool], timeout_s: float) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: is_so(self.sent), timeout_s), self.sent[-1:]


class Node:
    """A node: what it publishes and what it listens to, by topic."""

    parameters: dict[str, Any] = {}  # noqa: RUF012 - what a launch file would set

    def __init__(self, name: str) -> None:
        self.name, self.logger = name, Logger()
        self.published: dict[str, Publisher] = {}
        self.heard: dict[str, tuple[type[Any], Callable[[Any], None]]] = {}

    def declare_parameter(self, name: str, usual: Any) -> Any:
        value = self.parameters.get(name, usual)
        assert type(value) is type(usual), name
        return SimpleNamespace(value=value)

    def create_publisher(self, kind: type[Any], topic: str, qos: Any) -> Publisher:
        self.published[topic] = Publisher(kind)
        return self.published[topic]

    def create_subscription(
        self, kind: type[Any], topic: str, take: Callable[[Any], None], qos: Any
    ) -> None:
        self.heard[topic] = kind, take

    def get_logger(self) -> Logger:
        return self.logger

    def destroy_node(self) -> None:
        pass


@contextmanager
def instead_of_ros(spin: Callable[[Any], None]) -> Iterator[None]:
    """In the block rclpy and the packages of messages can be imported; spinning calls a
    function."""
    modules = {
        "rclpy": {"init": lambda: None, "spin": spin, "try_shutdown": lambda: None},
        "rclpy.executors": {"ExternalShutdownException": type("Gone", (Exception,), {})},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {
            "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1),
            "QoSProfile": SimpleNamespace,
            "qos_profile_sensor_data": SimpleNamespace(),
        },
    }
    for package in ("geometry_msgs", "nav_msgs", "sensor_msgs", "std_msgs"):
        names = [name for name in STORE.types if name.startswith(f"{package}/msg/")]
        modules[f"{package}.msg"] = {name.rpartition("/")[2]: message_class(name) for name in names}
        modules[package] = {}
    before = {name: sys.modules.get(name) for name in modules}
    for name, values in modules.items():
        made = ModuleType(name)
        vars(made).update(values)
        sys.modules[name] = made
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
