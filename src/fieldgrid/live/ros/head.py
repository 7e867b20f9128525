"""The head of a drive: what its topics said first, opened as the bag that it would be in.

So the topics are chosen, and sensor, calibration, mounting and units found, as for any bag, with
what lies beside the map: `mounting.json`, `recording.toml`, `calibration/`.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
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
"""Of images and clouds that wait; of more the oldest are left out."""

_FRAME_ROLES = ("left", "right", "disparity", "depth", "cloud")
_FRAMES = frozenset(type_ for role in _FRAME_ROLES for type_ in TYPES_OF_ROLES[role])


class Inbox:
    """Messages in the order in which they came; safe to use from several threads."""

    def __init__(self) -> None:
        self._frames, self._others = deque[tuple[int, Message]](), deque[tuple[int, Message]]()
        self._changed = threading.Condition()
        self._number = self._bytes = self.left_out = 0
        self.is_closed = False
        """Whether nothing more is put in."""

    def __len__(self) -> int:
        with self._changed:
            return len(self._frames) + len(self._others)

    def put(self, message: Message) -> None:
        """Add a message. What waits longest gives way where images and clouds are too many."""
        if self.is_closed:
            return
        with self._changed:
            self._number += 1
            if message.connection.type in _FRAMES:
                self._frames.append((self._number, message))
                self._bytes += len(message.data)
                while self._bytes > MOST_BYTES:
                    self._bytes -= len(self._frames.popleft()[1].data)
                    self.left_out += 1
            else:
                self._others.append((self._number, message))
            self._changed.notify()

    def take(self, timeout_s: float) -> Message | None:
        """The next message; None where none comes in time."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._frames or self._others, timeout_s):
                return None
            first = min((queue for queue in (self._frames, self._others) if queue), key=_number)
            message = first.popleft()[1]
            if first is self._frames:
                self._bytes -= len(message.data)
            return message


def _number(queue: deque[tuple[int, Message]]) -> int:
    return queue[0][0]


@dataclass(frozen=True, eq=False)
class Head:
    """A drive that has begun: what its topics are, by their names, what its sensors are, and what
    came until now, in the inbox. `first` are the first messages of each topic."""

    recording: Recording
    frames: BagFrames
    roles: dict[str, str]
    first: dict[str, list[Message]]
    inbox: Inbox
    imu_axes: str


class Listener:
    """Hears all topics that may be of use, until it is known which are."""

    def __init__(self, ros: RosNode, options: DriveOptions, tell: Callable[[str], None]) -> None:
        given = ros.remapped(ROLES)
        self._options = replace(options, topics={**given, **options.topics})
        self._ros, self._inbox, self._tell = ros, Inbox(), tell
        self._heard: dict[str, Any] = {}
        self._first: dict[str, list[Message]] = {}
        self._begun_s = 0.0

    def _take(self, message: Message) -> None:
        is_frame = message.connection.type in _FRAMES
        first = self._first.setdefault(message.topic, [])
        if len(first) < (MOST_FRAMES if is_frame else MOST_OTHERS):
            first.append(message)
        if is_frame:
            self._begun_s = self._begun_s or time.monotonic()
        self._inbox.put(message)

    def wait(self, path: Path, stop: threading.Event) -> Head | None:
        """The head, once the drive has begun; None when it is stopped before. `path` is where the
        bag of it is written, beside which further files are looked for; nothing of it is left.
        What is missing yet is told once."""
        told = set[str]()
        while not stop.wait(LOOK_S):
            for topic, type_ in self._ros.topics().items():
                if topic not in self._heard and is_of_use(topic, type_):
                    self._heard[topic] = self._ros.subscribe(topic, type_, self._take)
            if not self._begun_s or time.monotonic() < self._begun_s + HEAD_S:
                continue
            try:
                return self._opened(path)
            except RecordingError as problem:
                if str(problem) not in told:
                    told.add(str(problem))
                    self._tell(f"no drive begins yet: {problem}")
                self._begun_s = time.monotonic()
        return None

    def _opened(self, path: Path) -> Head:
        """The head. RecordingError where something is missing."""
        first = {topic: list(messages) for topic, messages in list(self._first.items())}
        every = sorted((one for all_ in first.values() for one in all_), key=_received)
        try:
            with McapWriter(path, overwrite=True) as writer:
                for one in every:
                    about = one.topic, one.connection.type, "ros2msg", b""
                    writer.write_raw(*about, one.data, one.receive_ns)
            with open_drive(path, self._options) as drive:
                recording = drive.recording()
            usual = mounting_path(path)
            is_said = self._options.mounting is not None or usual.exists()
            axes = self._options.find_mounting(usual, path).imu_axes if is_said else AXES
        finally:
            path.unlink(missing_ok=True)
        frames = recording.source
        assert isinstance(frames, BagFrames)
        if not len(recording.fixes()) and not recording.pose_name:
            raise RecordingError(
                f"of {counted(len(first), 'topic')} none has given a fix; check the receiver, or "
                "name its topic with --topic fix=NAME."
            )
        roles = {one.name: one.role for one in recording.topics if one.role}
        roles |= dict.fromkeys(frames.plan.topics, "cloud")
        for topic, subscription in self._heard.items():
            if subscription is not None and topic not in roles and not _is_tree(first, topic):
                self._ros.node.destroy_subscription(subscription)
        return Head(recording, frames, roles, first, self._inbox, axes)


def _is_tree(first: dict[str, list[Message]], topic: str) -> bool:
    return topic in first and first[topic][0].connection.type in TF


def _received(message: Message) -> int:
    return message.receive_ns
