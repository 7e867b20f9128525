"""What of a bag is not images, heard in the run that counts its messages: fixes, gyro, wheels,
calibrations, transforms.

Which topics are used is known only when the run has ended. Of the topics of one role those are
heard that may still be the one, by what their names are worth.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError
from fieldgrid.geometry import Datum, Orientation, RecordedTilt, Rig
from fieldgrid.recordings.bag.listeners import (
    AttitudeMessages,
    First,
    Fixes,
    Sentences,
    Speeds,
    Texts,
    TiltListener,
    TopicListener,
    Turns,
)
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import worth
from fieldgrid.recordings.bag.topics import FIX, FIXES, IMU, INFO, NMEA, ODOMETRY, TF, TF_STATIC
from fieldgrid.recordings.bag.transforms import Transforms
from fieldgrid.recordings.bag.trees import FrameTrack, MovingTrees, Trees
from fieldgrid.recordings.ros.bag import Bag, Take
from fieldgrid.recordings.ros.gnss_messages import (
    DATUM,
    DETAILS,
    ORIENTATION,
    RIG,
    TILT,
    datum_of,
    rig_of,
)
from fieldgrid.recordings.ros.model import Message

_TEXT = "std_msgs/msg/String"


_ROLES: dict[str, tuple[str, type[TopicListener]]] = {
    FIX: ("fix", Fixes),
    NMEA: ("nmea", Sentences),
    IMU: ("imu", Turns),
    ODOMETRY: ("odometry", Speeds),
}
_TILTS: dict[str, type[RecordedTilt | Orientation]] = {
    TILT: RecordedTilt,
    ORIENTATION: Orientation,
}
_SAID_ONCE = {RIG: (_TEXT,), DATUM: (_TEXT, FIX)}


_Heard = TypeVar("_Heard", bound=TopicListener)


class TopicSeries(NamedTuple):
    """Values of a topic with their times, 0 where there is none, in the order of the record."""

    time_ns: Int64
    values: Float64


class Readings:
    """Listens to a bag while it is opened, and tells afterwards what was heard.

    `given` names topics by their role, `gnss` the only topic that may give fixes.
    """

    def __init__(self, given: Mapping[str, str], gnss: str | None) -> None:
        self._given, self._gnss = given, gnss
        self._heard: dict[str, TopicListener] = {}
        self._best: dict[str, str] = {}
        self.attitude: AttitudeMessages | None = None
        self._notes: dict[str, str] = {}

    def listen(self, name: str, type_: str) -> Take | None:
        """What takes the messages of a topic; see :data:`fieldgrid.recordings.ros.bag.Listen`."""
        heard: TopicListener | None = None
        if type_ in _SAID_ONCE.get(name, ()) or type_ == INFO:
            heard = First()
        elif type_ in _ROLES:
            role, kind = _ROLES[type_]
            heard = kind() if self._may_be(role, name) else None
        elif type_ in TF:
            heard = (
                Trees()
                if name.endswith(TF_STATIC)
                else MovingTrees(
                    lambda: "odometry" not in self._best and "odometry" not in self._given
                )
            )
        elif type_ == _TEXT and name.endswith(DETAILS):
            heard = Texts()
        elif type_ == _TEXT and name in _TILTS:
            heard = TiltListener(_TILTS[name])
        if heard is not None:
            self._heard[name] = heard
        if name != self._given.get("attitude"):
            return None if heard is None else heard.take
        self.attitude = AttitudeMessages()
        takes = [one.take for one in (heard, self.attitude) if one is not None]

        def take(message: Message, place: int) -> None:
            for each in takes:
                each(message, place)

        return take

    def _may_be(self, role: str, name: str) -> bool:
        """Whether a topic may be the one of its role, since no better one is known."""
        if role in FIXES and self._gnss is not None:
            return name == self._gnss
        if role in self._given:
            return name == self._given[role]
        best = self._best.get(role)
        if best is not None:
            if worth(role, name) >= worth(role, best):
                return False
            self._heard.pop(best).is_dropped = True
        self._best[role] = name
        return True

    def of(self, topic: str | None, kind: type[_Heard]) -> _Heard | None:
        """What was heard of a topic, if it is of a kind."""
        heard = self._heard.get(topic or "")
        return heard if isinstance(heard, kind) else None

    def tilt(self, topic: str) -> RecordedTilt | Orientation | None:
        """What a converted drive keeps of roll and pitch on a topic."""
        heard = self.of(topic, TiltListener)
        return None if heard is None else heard.tilts.found()

    def frame_id(self, topic: str | None) -> str:
        """The frame of the first message of a topic, empty where nothing was heard."""
        heard = self._heard.get(topic or "")
        return "" if heard is None else heard.frame_id

    def first(self, topic: str | None) -> Any:
        """The first message of a topic of calibrations; None where there is none."""
        heard = self.of(topic, First)
        return None if heard is None else heard.message

    def stereo_infos(self) -> dict[str, str]:
        """The calibrations of left cameras with those of their right ones: of one size and one
        projection, but for T, which only the right one has. Empty where that leaves a choice."""
        lefts: dict[Any, list[str]] = {}
        rights: dict[Any, list[str]] = {}
        for name, heard in self._heard.items():
            info: Any = heard.message if isinstance(heard, First) else None
            projection = np.asarray(getattr(info, "p", ()), dtype=np.float64)
            if projection.shape != (12,) or not projection[0] > 0.0:
                continue
            times_baseline = projection[3]  # f·T
            camera = (int(info.width), int(info.height), np.delete(projection, 3).tobytes())
            if times_baseline <= 0.0:
                side = lefts if times_baseline == 0.0 else rights
                side.setdefault(camera, []).append(name)
        both = lefts.keys() & rights.keys()
        if any(len(lefts[camera]) + len(rights[camera]) > 2 for camera in both):
            return {}
        return {lefts[camera][0]: rights[camera][0] for camera in both}

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

    def series(self, bag: Bag, topic: str, places: array[int], values: Float64) -> TopicSeries:
        """Values that were heard, by the one clock that their topic has."""
        return TopicSeries(self.times_ns(bag, topic)[np.array(places, dtype=np.int64)], values)

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
