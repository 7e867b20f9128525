"""What of a bag is not images, heard in the run that counts its messages: fixes, gyro, wheels,
calibrations, transforms.

Which topics are used is known only when the run has ended. Of the topics of one role those are
heard that may still be the one, by what their names are worth.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError
from fieldgrid.geometry import Datum, Orientation, RecordedTilt, Rig
from fieldgrid.recordings.bag.listeners import (
    First,
    Numbers,
    Sentences,
    Texts,
    TopicListener,
)
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import stream_frame
from fieldgrid.recordings.bag.topics import (
    FIX,
    FIXES,
    IMU,
    INFO,
    NMEA,
    NUMBER,
    ODOMETRY,
    PLACE,
    ROLES,
    TEXT,
    TF,
    TF_STATIC,
)
from fieldgrid.recordings.bag.transforms import Transforms
from fieldgrid.recordings.bag.trees import FrameTrack, MovingTrees, Trees
from fieldgrid.recordings.ros.bag import Bag, Take
from fieldgrid.recordings.ros.gnss_messages import (
    DATUM,
    DETAILS,
    ORIENTATION,
    RIG,
    TILT,
    Details,
    Tilts,
    datum_of,
    rig_of,
)


class _Row(NamedTuple):
    """Topics of some types whose whole names fit a pattern, and what hears their messages. Of the
    topics of a `role` the one is heard whose name has the lowest rank."""

    types: tuple[str, ...]
    named: re.Pattern[str]
    listener: Callable[[str], TopicListener]
    role: str = ""


_ANY = re.compile(".*")
_TABLE = (
    _Row((INFO,), _ANY, lambda _: First()),
    _Row((NUMBER,), re.compile(".*/option/Depth_Units/value"), lambda _: First()),
    _Row((TEXT,), re.compile(RIG), lambda _: First()),
    _Row((TEXT, FIX), re.compile(DATUM), lambda _: First()),
    _Row((TEXT,), re.compile(f".*{DETAILS}"), lambda _: Texts(Details())),
    _Row((TEXT,), re.compile(TILT), lambda _: Texts(Tilts(RecordedTilt))),
    _Row((TEXT,), re.compile(ORIENTATION), lambda _: Texts(Tilts(Orientation))),
    _Row((FIX,), _ANY, lambda _: Numbers(FIX), "fix"),
    _Row((NMEA,), _ANY, lambda _: Sentences(), "nmea"),
    _Row((IMU,), re.compile("(?i).*accel.*"), lambda _: Numbers(IMU)),
    _Row((IMU,), _ANY, lambda _: Numbers(IMU), "imu"),
    _Row((ODOMETRY,), _ANY, lambda _: Numbers(ODOMETRY), "odometry"),
    _Row(TF, re.compile(f".*{TF_STATIC}"), Trees),
    _Row(TF, _ANY, MovingTrees),
    _Row((PLACE,), _ANY, Trees),
)
"""What is heard of a bag; the first row that fits holds."""


_Heard = TypeVar("_Heard", bound=TopicListener)


class Readings:
    """Listens to a bag while it is opened, and tells afterwards what was heard.

    `given` names topics by their role, `gnss` the only topic that may give fixes.
    """

    def __init__(self, given: Mapping[str, str], gnss: str | None) -> None:
        self._given, self._gnss = given, gnss
        self._heard: dict[str, TopicListener] = {}
        self._best: dict[str, str] = {}
        self.attitude: Numbers | None = None
        self._notes: dict[str, str] = {}

    def listen(self, name: str, type_: str) -> Take | None:
        """What takes the messages of a topic; see :data:`fieldgrid.recordings.ros.bag.Listen`."""
        rows = (row for row in _TABLE if type_ in row.types and row.named.fullmatch(name))
        row = next(rows, None)
        heard = None
        if row is not None and (not row.role or self._may_be(row.role, name, type_)):
            heard = self._heard[name] = row.listener(name)
        if isinstance(heard, MovingTrees):
            heard.is_needed = lambda: not {"odometry"} & {*self._best, *self._given}
        if name != self._given.get("attitude"):
            return None if heard is None else heard.take
        self.attitude = heard if isinstance(heard, Numbers) else Numbers(type_)
        return self.attitude.take

    def _may_be(self, role: str, name: str, type_: str) -> bool:
        """Whether a topic may be the one of its role, since no better one is known."""
        if role in FIXES and self._gnss is not None:
            return name == self._gnss
        if role in self._given:
            return name == self._given[role]
        best, rank = self._best.get(role), ROLES[role].rank
        if best is not None:
            if rank(name, type_) >= rank(best, type_):
                return False
            dropped = self._heard.pop(best)
            dropped.is_dropped = dropped is not self.attitude
        self._best[role] = name
        return True

    def of(self, topic: str | None, kind: type[_Heard]) -> _Heard | None:
        """What was heard of a topic, if it is of a kind."""
        heard = self._heard.get(topic or "")
        return heard if isinstance(heard, kind) else None

    def tilt(self, topic: str) -> RecordedTilt | Orientation | None:
        """What a converted drive keeps of roll and pitch on a topic."""
        heard = self.of(topic, Texts)
        return heard.said.found() if heard is not None and isinstance(heard.said, Tilts) else None

    def frame_id(self, topic: str | None) -> str:
        """The frame of the messages of a topic, by the first or by its name; empty where nothing
        was heard."""
        heard = self._heard.get(topic or "")
        return "" if heard is None else stream_frame(topic or "") or heard.frame_id

    def first(self, topic: str | None) -> Any:
        """The first message of a topic of calibrations; None where there is none."""
        heard = self.of(topic, First)
        return None if heard is None else heard.message

    def stereo_infos(self) -> dict[str, str]:
        """The calibrations of left cameras with those of their right ones: of one size and one
        projection, but for T, which only the right one has. Empty where that leaves a choice."""
        alike: dict[Any, list[tuple[float, str]]] = {}
        for name, heard in self._heard.items():
            info: Any = heard.message if isinstance(heard, First) else None
            projection = np.asarray(getattr(info, "p", ()), dtype=np.float64)
            if projection.shape == (12,) and projection[0] > 0.0 and projection[3] <= 0.0:
                camera = (int(info.width), int(info.height), np.delete(projection, 3).tobytes())
                alike.setdefault(camera, []).append((float(projection[3]), name))  # f·T
        pairs = {}
        for infos in alike.values():
            left, right = max(infos), min(infos)
            if left[0] == 0.0 > right[0]:
                pairs[left[1]] = right[1]
                if len(infos) > 2:
                    return {}
        return pairs

    def rig(self) -> Rig | None:
        """The rig that the bag says exactly."""
        message = self.first(RIG)
        return None if message is None else rig_of(message)

    def datum(self) -> Datum | None:
        """The datum that the bag declares."""
        message = self.first(DATUM)
        return None if message is None else datum_of(message)

    def transforms(self, static: Collection[str]) -> Transforms:
        """The tree of the static transforms of these topics, and below them of what is published
        on others and never moves."""
        tree = Transforms()
        for heard in self._heard.values():
            if isinstance(heard, MovingTrees):
                tree.update(heard.transforms.unmoved())
        for name in static:
            found = self.of(name, Trees)
            if found is not None:
                tree.update(found.transforms)
        return tree

    def moving(self, bag: Bag) -> tuple[str, FrameTrack] | None:
        """The topic of transforms that tells the way of the vehicle, and that way."""
        for name, heard in sorted(self._heard.items()):
            if not isinstance(heard, MovingTrees):
                continue
            try:
                way = heard.way(bag, name, is_mapped=self.datum() is not None)
            except RecordingError as problem:
                self.leave_out(name, str(problem))
                continue
            if way is not None:
                return name, way
        return None

    def series(
        self, bag: Bag, topic: str, places: array[int], values: Float64
    ) -> tuple[Int64, Float64]:
        """Times, 0 where there is none, and values that were heard, in the order of the record."""
        return self.times_ns(bag, topic)[np.array(places, dtype=np.int64)], values

    def times_ns(self, bag: Bag, topic: str) -> Int64:
        """The times of all messages of a topic, 0 for none."""
        times = clock(topic, *bag.stamps(topic))
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
            heard = self._heard.get(topic)
            found += [f"{topic}: {note}." for note in (heard.notes() if heard else ())]
        return found
