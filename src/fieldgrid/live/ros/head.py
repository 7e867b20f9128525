"""The head of a drive: what its topics said first, opened as the bag that it would be in.

So the topics are chosen, and sensor, calibration, mounting and units found, as for any bag, with
what lies beside the map: `mounting.json`, `recording.toml`, `calibration/`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from fieldgrid.core import RecordingError, counted
from fieldgrid.live.ros.node import RosNode
from fieldgrid.recordings import (
    AXES,
    ROLES,
    TF,
    TYPES_OF_ROLES,
    BagFrames,
    DriveOptions,
    McapWriter,
    Message,
    Recording,
    is_of_use,
    mounting_path,
    open_drive,
)

LOOK_S = 0.25
"""How often it is looked for new topics."""

HEAD_S = 2.0
"""A drive begins when this time has passed since its first frame: topics that say nothing until
then are not used."""

MOST_FRAMES, MOST_OTHERS = 16, 5_000
"""Messages of a topic in the head."""

MOST_BYTES = 1 << 28
"""Of images and clouds that wait; while they are more, those that come are left out."""

_FRAME_ROLES = ("left", "right", "disparity", "depth", "cloud")
_FRAMES = frozenset(type_ for role in _FRAME_ROLES for type_ in TYPES_OF_ROLES[role])


class Head:
    """Hears all topics that may be of use, until it is known which are.

    `first` are the first messages of each topic. When it is found, `roles` are the topics in use
    with what they are for, "cloud" for whatever frames are made of; `frames` makes them, and
    `imu_axes` is how an IMU sits. What is heard waits for `take`.
    """

    def __init__(self, ros: RosNode, options: DriveOptions) -> None:
        self._options = replace(options, topics={**ros.remapped(ROLES), **options.topics})
        self._ros = ros
        self._heard: dict[str, tuple[str, Any]] = {}
        self._begun_s = 0.0
        self._waiting = SimpleQueue[Message]()
        self._bytes = self.left_out = 0
        self.is_closed = False
        """Whether nothing more is taken in."""
        self.first: dict[str, list[Message]] = {}
        self.roles: dict[str, str] = {}
        self.frames: BagFrames
        self.imu_axes = AXES

    def _put(self, message: Message) -> None:
        is_frame = message.connection.type in _FRAMES
        first = self.first.setdefault(message.topic, [])
        if len(first) < (MOST_FRAMES if is_frame else MOST_OTHERS):
            first.append(message)
        if is_frame:
            self._begun_s = self._begun_s or time.monotonic()
            if self._bytes > MOST_BYTES:
                self.left_out += 1
                return
        if not self.is_closed:
            self._bytes += len(message.data)
            self._waiting.put(message)

    def take(self, timeout_s: float) -> Message | None:
        """The next message, in the order in which they came; None where none comes in time."""
        try:
            message = self._waiting.get(timeout=timeout_s)
        except Empty:
            return None
        self._bytes -= len(message.data)
        return message

    def __len__(self) -> int:
        return self._waiting.qsize()

    def find(
        self, path: Path, stop: threading.Event, tell: Callable[[str], None]
    ) -> Recording | None:
        """What the drive is, once it has begun; None when it is stopped before. `path` is where the
        bag of its head is written, beside which further files are looked for; nothing of it is
        left. What is missing yet is told once."""
        told = ""
        while not stop.wait(LOOK_S):
            for topic, type_ in self._ros.topics().items():
                if topic not in self._heard and is_of_use(topic, type_):
                    self._heard[topic] = type_, self._ros.subscribe(topic, type_, self._put)
            if not self._begun_s or time.monotonic() < self._begun_s + HEAD_S:
                continue
            try:
                return self._opened(path)
            except RecordingError as problem:
                if str(problem) != told:
                    told = str(problem)
                    tell(f"no drive begins yet: {told}")
                self._begun_s = time.monotonic()
        return None

    def _opened(self, path: Path) -> Recording:
        """The head as a recording. RecordingError where something is missing."""
        first = [one for all_ in tuple(self.first.values()) for one in tuple(all_)]
        try:
            with McapWriter(path, overwrite=True) as writer:
                for one in sorted(first, key=lambda one: one.receive_ns):
                    about = one.topic, one.connection.type, "ros2msg", b""
                    writer.write_raw(*about, one.data, one.receive_ns)
            with open_drive(path, self._options) as drive:
                recording = drive.recording()
            usual = mounting_path(path)
            if self._options.mounting is not None or usual.exists():
                self.imu_axes = self._options.find_mounting(usual, path).imu_axes
        finally:
            path.unlink(missing_ok=True)
        if not len(recording.fixes()):
            raise RecordingError(
                f"of {counted(len(self.first), 'topic')} none has given a fix; check the receiver, "
                "or name its topic with --topic fix=NAME."
            )
        assert isinstance(recording.source, BagFrames)
        self.frames = recording.source
        self.roles = {one.name: one.role for one in recording.topics if one.role}
        self.roles |= dict.fromkeys(self.frames.plan.topics, "cloud")
        for topic, (type_, subscription) in self._heard.items():
            if subscription and topic not in self.roles and type_ not in TF:
                self._ros.node.destroy_subscription(subscription)
        return recording
