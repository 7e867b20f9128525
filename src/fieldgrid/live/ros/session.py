"""A live session of what the topics of ROS say: the node, the head of the drive, its outputs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from fieldgrid.core import Closing, RecordingError
from fieldgrid.live.intake import Sources
from fieldgrid.live.options import LiveOptions
from fieldgrid.live.results import LiveResult
from fieldgrid.live.ros.head import Head
from fieldgrid.live.ros.node import RosNode
from fieldgrid.live.ros.outputs import RosOutputs
from fieldgrid.live.ros.place import RobotFrames
from fieldgrid.live.ros.serving import MapServer
from fieldgrid.live.ros.stream import RosStream
from fieldgrid.live.session import Live
from fieldgrid.live.sources.mcap_stream import FIXES
from fieldgrid.maps import Selection
from fieldgrid.recordings import (
    TF,
    TF_STATIC,
    DriveOptions,
    Recording,
    Transforms,
    decode,
)

_LOOK_S = 0.2
_HEAD = ".head"


class RosSession(Closing):
    """The topics of ROS as the source of a session for the map `out`, whose results are published.

    `wait` is for the drive to begin, `run` for its end: when the event of either is set, or the
    service `save` is called, which answers when `finished` or `close` is called. `tell` is told
    why no drive begins yet, `arguments` are those of ROS, by default those of the program.
    """

    def __init__(
        self,
        out: Path,
        options: DriveOptions,
        tell: Callable[[str], None] = print,
        arguments: list[str] | None = None,
    ) -> None:
        self._out, self._options, self._tell = out, options, tell
        self._ros = RosNode(arguments)
        self._outputs: RosOutputs | None = None
        self._is_asked, self._is_done = threading.Event(), threading.Event()
        self._server: MapServer | None = None
        self._ros.serve("save", self._save)

    def wait(self, stop: threading.Event) -> Recording:
        """The head of the drive, with all but its frames. RecordingError where none began."""
        head = Head(self._ros, self._options)
        found = head.find(self._out.with_suffix(f"{_HEAD}.mcap"), stop, self._tell)
        if found is None:
            raise RecordingError("No drive began, so there is no map.")
        static, antenna = Transforms(), ""
        for topic, messages in head.first.items():
            if head.roles.get(topic) in FIXES:
                antenna = decode(messages[0]).header.frame_id
            if topic.endswith(TF_STATIC) and messages[0].connection.type in TF:
                for message in messages:
                    static.add(decode(message))
        robot = RobotFrames(static, antenna, found.rig.antenna)
        self._outputs = RosOutputs(self._ros, robot, LiveOptions().curve)
        if self._out.exists():
            self._outputs.begin_with(self._out)
        self._head, self._stream = head, RosStream(head, robot, self._options.epoch_ns)
        return replace(found, name=found.name.removesuffix(_HEAD))

    def take(self, result: LiveResult) -> None:
        """Publish a result."""
        if self._outputs is not None:
            self._outputs.take(result)

    def run(self, live: Live, stop: threading.Event) -> bool:
        """Push what comes until the end of the drive; False, since more would come."""
        with Sources(live, [self._stream]):
            while not (stop.is_set() or self._is_asked.wait(_LOOK_S)):
                pass
            self._head.is_closed = True
            while len(self._head):  # what came counts
                time.sleep(_LOOK_S)
        return False

    def finished(self, stop: threading.Event) -> None:
        """Publish the map that was made; where it was asked for with `save`, serve it until the
        event is set."""
        self._server = MapServer(self._ros, self._out, Selection())
        self._is_done.set()
        if self._is_asked.is_set():
            stop.wait()

    def close(self) -> None:
        """Leave the graph."""
        self._is_done.set()
        self._ros.close()

    def _save(self) -> str:
        was_made = self._is_done.is_set()
        self._is_asked.set()
        self._is_done.wait()
        if self._server is None:
            raise RecordingError("No map was made.")
        return self._server.publish() if was_made else f"the map is {self._out}"
