"""An open bag, and what was heard of it in the run that counts its messages: all that is no image.

Which topics are used is known only when the run has ended. Of the topics of one role those are
heard that may still be the one, by what their names are worth.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError
from fieldgrid.geometry import Datum, Orientation, RecordedTilt, WheelSpeed
from fieldgrid.recordings.bag.listeners import Numbers, Texts, TopicListener
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import stream_frame
from fieldgrid.recordings.bag.topics import FIXES, KINDS, TopicKind
from fieldgrid.recordings.bag.transforms import Transforms
from fieldgrid.recordings.bag.trees import MovingTrees, Trees
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.ros.bag import Take, open_bag
from fieldgrid.recordings.ros.gnss_messages import DATUM, Tilts, datum_of

_Heard = TypeVar("_Heard", bound=TopicListener)


class Readings:
    """A bag that was opened, and what was heard meanwhile; the `bag` is to be closed."""

    def __init__(self, path: Path, options: DriveOptions) -> None:
        self._given, self._gnss = options.topics, options.gnss
        self._heard: dict[str, TopicListener] = {}
        self._best: dict[str, str] = {}
        self._notes: dict[str, str] = {}
        self.bag = open_bag(path, self._listen, options.epoch_ns)

    def _listen(self, name: str, type_: str) -> Take | None:
        """What takes the messages of a topic; see :data:`fieldgrid.recordings.ros.bag.Listen`."""
        for kind in KINDS:
            if kind.listener and kind.fits(name, type_) and self._may_be(kind, name, type_):
                heard = self._heard[name] = kind.listener(name, type_)
                is_told = "odometry" in {*self._best, *self._given}
                for moving in self._all(MovingTrees):
                    moving.is_whole = moving.is_whole and not is_told
                return heard.take
        return None

    def _may_be(self, kind: TopicKind, name: str, type_: str) -> bool:
        """Whether a topic may be the one of its role, since no better one is known."""
        if kind.role in FIXES and self._gnss is not None:
            return name == str(self._gnss)
        if kind.role in self._given:
            return name == self._given[kind.role]
        if kind.rank is None:
            return not kind.role
        best = self._best.get(kind.role)
        if best is not None and kind.rank(name, type_) >= kind.rank(best, type_):
            return False
        if best is not None and best != self._given.get("attitude"):
            self._heard.pop(best).is_dropped = True
        self._best[kind.role] = name
        return True

    def of(self, topic: str | None, kind: type[_Heard]) -> _Heard | None:
        """What was heard of a topic, if it is of a kind."""
        heard = self._heard.get(topic or "")
        return heard if isinstance(heard, kind) else None

    def _all(self, kind: type[_Heard]) -> Iterator[_Heard]:
        return (heard for _, heard in sorted(self._heard.items()) if isinstance(heard, kind))

    def first(self, topic: str | None) -> Any:
        """The first message of a topic; None where there is none."""
        heard = self._heard.get(topic or "")
        return None if heard is None else heard.first

    def frame_id(self, topic: str | None) -> str:
        """The frame of the messages of a topic, by the first or by its name; empty where nothing
        was heard."""
        heard = self._heard.get(topic or "")
        return "" if heard is None else stream_frame(heard.name) or heard.frame_id

    def body(self, topic: str) -> str:
        """The frame that the orientations of a topic are of: of odometry that of the vehicle; a
        pose names the frame that it is in, and not whose it is."""
        first = self.first(topic)
        is_imu = hasattr(first, "angular_velocity")
        return self.frame_id(topic) if is_imu else str(getattr(first, "child_frame_id", ""))

    def sha256(self, topic: str) -> str:
        """The hash of the messages of a topic; empty where there are none."""
        heard = self._heard.get(topic)
        return "" if heard is None else heard.sha256()

    def tilt(self, topic: str) -> RecordedTilt | Orientation | None:
        """What a converted drive keeps of roll and pitch on a topic."""
        heard = self.of(topic, Texts)
        return heard.said.found() if heard is not None and isinstance(heard.said, Tilts) else None

    def stereo_infos(self) -> dict[str, str]:
        """The calibration of a left camera with that of its right one: of one size and one
        projection, but for T, which only the right one has. Empty where that leaves a choice."""
        alike: dict[Any, list[tuple[float, str]]] = {}
        for name, heard in self._heard.items():
            projection = np.asarray(getattr(heard.first, "p", ()), dtype=np.float64)
            if projection.shape == (12,) and projection[0] > 0.0 and projection[3] <= 0.0:
                size = int(heard.first.width), int(heard.first.height)
                camera = (*size, np.delete(projection, 3).tobytes())
                alike.setdefault(camera, []).append((float(projection[3]), name))  # f·T
        pairs = [sorted(infos) for infos in alike.values() if min(infos)[0] < 0.0 == max(infos)[0]]
        if any(len(infos) > 2 for infos in pairs):
            return {}
        return {left: right for (_, right), (_, left) in pairs}

    def datum(self) -> Datum | None:
        """The datum that the bag declares."""
        message = self.first(DATUM)
        return None if message is None else datum_of(message)

    def transforms(self, static: Collection[str]) -> Transforms:
        """The tree of the static transforms of these topics, and below them of what is published
        on others and never moves."""
        tree = Transforms()
        for moving in self._all(MovingTrees):
            tree.update(moving.transforms.unmoved())
        for name in static:
            found = self.of(name, Trees)
            if found is not None:
                tree.update(found.transforms)
        return tree

    def moving(self) -> tuple[str, str, WheelSpeed] | None:
        """The topic of transforms that tells the way of the vehicle, whose way, and its speed."""
        for heard in self._all(MovingTrees):
            try:
                told = heard.speed(self.bag, is_mapped=self.datum() is not None)
            except RecordingError as problem:
                self.leave_out(heard.name, str(problem))
                continue
            if told is not None:
                return heard.name, *told
        return None

    def series(self, topic: str | None) -> tuple[Int64, Float64] | None:
        """Times, 0 where there is none, and numbers that were heard of a topic, in the order of the
        record; None where there is no message."""
        heard = self.of(topic, Numbers)
        if heard is None or not len(heard.places):
            return None
        return self.times_ns(heard.name)[heard.places], heard.rows()

    def times_ns(self, topic: str) -> Int64:
        """The times of all messages of a topic, 0 for none."""
        times = clock(topic, *self.bag.stamps(topic))
        if times.received:
            self._notes[topic] = "the header stamps are no UTC; the recorder's times are taken"
        return times.time_ns

    def leave_out(self, topic: str, why: str) -> None:
        """Note why a topic is not used."""
        self._notes[topic] = f"not used: {why.removesuffix('.')}"

    def notes(self, topics: Iterable[str]) -> list[str]:
        """Remarks on topics, a sentence each."""
        found = [f"{topic}: {note}." for topic, note in self._notes.items()]
        for topic in dict.fromkeys(topics):
            found += self._heard[topic].notes() if topic in self._heard else ()
        return found
