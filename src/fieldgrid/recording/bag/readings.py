"""What of a bag is not images, heard in the run that counts its messages: fixes, gyro, wheels,
calibrations, transforms.

Which topics are used is known only when the run has ended. Of the topics of one role those are
heard that may still be the one, by what their names are worth.
"""

from __future__ import annotations

import hashlib
import math
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fieldgrid.array_types import Float64, Int64
from fieldgrid.errors import RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import NmeaLog, NmeaStream
from fieldgrid.recording.bag.order import clock
from fieldgrid.recording.bag.topics import (
    FIX,
    FIXES,
    IMU,
    INFO,
    NMEA,
    ODOMETRY,
    TF,
    TF_STATIC,
    worth,
)
from fieldgrid.recording.bag.transforms import Transforms
from fieldgrid.rig import Rig
from fieldgrid.ros import Bag, Message, Take, decode
from fieldgrid.ros.gnss import DATUM, DETAILS, RIG, Details, datum_of, quality_of, rig_of

_TEXT = "std_msgs/msg/String"
_UNLIMITED = 1 << 60
_MOST_TREES = 10_000
_ALL_OF_FIRST, _THEN_EVERY = 200, 50


class Heard:
    """The messages of one topic, each decoded and added; those that do not fit their type are
    counted. `frame_id` is that of the first message."""

    hashes = False

    def __init__(self) -> None:
        self.is_dropped = False
        self.frame_id = ""
        self.damaged = 0
        self.counts: Counter[str] = Counter()
        self.places = array("q")
        self._hash = hashlib.sha256()

    def take(self, message: Message, place: int) -> None:
        """The next message, and its place in the topic."""
        if self.is_dropped:
            return
        if self.hashes:
            self._hash.update(message.data)
        if not self._wants(place):
            return
        try:
            found = decode(message)
        except RecordingError:
            self.damaged += 1
            return
        header = getattr(found, "header", None)
        if not self.frame_id and header is not None:
            self.frame_id = header.frame_id
        self._add(found, place)

    def _wants(self, place: int) -> bool:
        """Whether the message of this place is to be decoded."""
        return True

    def _add(self, message: Any, place: int) -> None:
        """What a decoded message says."""

    def sha256(self) -> str:
        """The hash of all messages one after the other, in hexadecimal."""
        return self._hash.hexdigest()

    def notes(self) -> Iterator[str]:
        """Remarks, without the topic and the full stop."""
        if self.damaged:
            yield f"{self.damaged} messages do not fit their type; skipped"
        for what, count in self.counts.items():
            yield f"{count} {what}"


class Sentences(Heard):
    """NMEA in nmea_msgs/Sentence."""

    hashes = True

    def __init__(self) -> None:
        super().__init__()
        self._stream = NmeaStream(max_undated=_UNLIMITED)
        self._log: NmeaLog | None = None
        self._fixes: list[Any] = []

    def _add(self, message: Any, place: int) -> None:
        text = message.sentence.encode("utf-8", "replace").strip()
        self._fixes += self._stream.feed(text + b"\r\n")

    def log(self) -> NmeaLog:
        """What the sentences come to."""
        if self._log is None:
            self._fixes += self._stream.finish()
            self._log = self._stream.log(self._fixes)
        return self._log


class Fixes(Heard):
    """Positions of sensor_msgs/NavSatFix."""

    hashes = True

    def __init__(self) -> None:
        super().__init__()
        self._values = array("d")

    def _add(self, message: Any, place: int) -> None:
        lat_deg, lon_deg, height_m = message.latitude, message.longitude, message.altitude
        if not (math.isfinite(lat_deg) and math.isfinite(lon_deg)):
            self.counts["messages without a position skipped"] += 1
            return
        if not math.isfinite(height_m):
            self.counts["messages without a height: taken as 0 m"] += 1
            height_m = 0.0
        quality, sigma_m = quality_of(message)
        self.places.append(place)
        self._values.extend(
            (lat_deg, lon_deg, height_m, quality, math.nan if sigma_m is None else sigma_m)
        )

    def columns(self, times_ns: Int64) -> FixColumns:
        """The fixes by the times of all messages of the topic, 0 for none."""
        time_ns = times_ns[np.array(self.places, dtype=np.int64)]
        known = time_ns > 0
        if not known.all():
            self.counts["messages without a time skipped"] = int(np.count_nonzero(~known))
        lat, lon, height, quality, sigma = np.array(self._values).reshape(-1, 5)[known].T
        return FixColumns.of(
            time_ns[known],
            lat_deg=lat,
            lon_deg=lon,
            height_m=height,
            quality=quality.astype(np.int64),
            sigma_m=sigma,
        )


class Turns(Heard):
    """Rates of turn about the axes of an IMU, rad/s, and forces along them, m/s²."""

    def __init__(self) -> None:
        super().__init__()
        self._sensed = array("d")

    def _add(self, message: Any, place: int) -> None:
        if message.angular_velocity_covariance[:1].tolist() == [-1.0]:  # by its definition
            self.counts["messages say that they have no gyro"] += 1
            return
        rates, forces = message.angular_velocity, message.linear_acceleration
        felt = (forces.x, forces.y, forces.z)
        if message.linear_acceleration_covariance[:1].tolist() == [-1.0]:
            felt = (math.nan, math.nan, math.nan)
        self.places.append(place)
        self._sensed.extend((rates.x, rates.y, rates.z, *felt))

    def sensed(self) -> Float64:
        """Rates and forces [n, 6], in the order of the record; NaN for a force that is not
        measured."""
        return np.array(self._sensed, dtype=np.float64).reshape(-1, 6)


class Speeds(Heard):
    """Speeds along the x axis of the vehicle, m/s, by nav_msgs/Odometry."""

    def __init__(self) -> None:
        super().__init__()
        self._speeds = array("d")

    def _add(self, message: Any, place: int) -> None:
        self.places.append(place)
        self._speeds.append(message.twist.twist.linear.x)

    def speeds_mps(self) -> Float64:
        """The speeds [n], in the order of the record."""
        return np.array(self._speeds, dtype=np.float64)


class First(Heard):
    """The first message of a topic: a camera says the same with every image."""

    message: Any = None

    def _wants(self, place: int) -> bool:
        return self.message is None

    def _add(self, message: Any, place: int) -> None:
        self.message = message


class Texts(Heard):
    """What texts say of the fixes on the topic beside them."""

    def __init__(self) -> None:
        super().__init__()
        self.details = Details()

    def _add(self, message: Any, place: int) -> None:
        self.details.add(message.data)


class Trees(Heard):
    """Static transforms."""

    def __init__(self) -> None:
        super().__init__()
        self.transforms = Transforms()

    def _wants(self, place: int) -> bool:
        return place < _MOST_TREES

    def _add(self, message: Any, place: int) -> None:
        self.transforms.add(message)


class MovingTrees(Trees):
    """Transforms on /tf, of which some robots publish those that never change, too."""

    def _wants(self, place: int) -> bool:
        return place < _ALL_OF_FIRST or (place < _MOST_TREES and place % _THEN_EVERY == 0)

    def _add(self, message: Any, place: int) -> None:
        self.transforms.add_unmoved(message)


_ROLES: dict[str, tuple[str, type[Heard]]] = {
    FIX: ("fix", Fixes),
    NMEA: ("nmea", Sentences),
    IMU: ("imu", Turns),
    ODOMETRY: ("odometry", Speeds),
}
_SAID_ONCE = {RIG: (_TEXT,), DATUM: (_TEXT, FIX)}


_Heard = TypeVar("_Heard", bound=Heard)


class Series(NamedTuple):
    """Values of a topic with their times, 0 where there is none, in the order of the record."""

    time_ns: Int64
    values: Float64


class Readings:
    """Listens to a bag while it is opened, and tells afterwards what was heard.

    `given` names topics by their role, `gnss` the only topic that may give fixes.
    """

    def __init__(self, given: Mapping[str, str], gnss: str | None) -> None:
        self._given, self._gnss = given, gnss
        self._heard: dict[str, Heard] = {}
        self._best: dict[str, str] = {}
        self._notes: dict[str, str] = {}

    def listen(self, name: str, type_: str) -> Take | None:
        """What takes the messages of a topic; see :data:`fieldgrid.ros.Listen`."""
        heard: Heard | None = None
        if type_ in _SAID_ONCE.get(name, ()) or type_ == INFO:
            heard = First()
        elif type_ in _ROLES:
            role, kind = _ROLES[type_]
            heard = kind() if self._may_be(role, name) else None
        elif type_ in TF:
            heard = Trees() if name.endswith(TF_STATIC) else MovingTrees()
        elif type_ == _TEXT and name.endswith(DETAILS):
            heard = Texts()
        if heard is None:
            return None
        self._heard[name] = heard
        return heard.take

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

    def series(self, bag: Bag, topic: str, places: array[int], values: Float64) -> Series:
        """Values that were heard, by the one clock that their topic has."""
        return Series(self.times_ns(bag, topic)[np.array(places, dtype=np.int64)], values)

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
