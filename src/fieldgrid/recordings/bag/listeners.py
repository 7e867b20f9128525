"""What is heard of the topics of a bag, by their kind: fixes, gyro, wheels, calibrations."""

from __future__ import annotations

import hashlib
import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError, counted
from fieldgrid.geometry import FixColumns
from fieldgrid.poses import NmeaCounts, NmeaStream
from fieldgrid.recordings.bag.leaning import Leans
from fieldgrid.recordings.bag.topics import FIX, IMU, ODOMETRY, POSE, SURE_POSE
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.gnss_messages import JsonRows, quality_of
from fieldgrid.recordings.ros.model import Message

_UNLIMITED = 1 << 60


class TopicListener:
    """The messages of one topic, each decoded and added; those that do not fit their type are
    counted. `frame_id` is that of the first message.

    `values` are `width` numbers of each message in `places`.
    """

    hashes = False
    width = 0

    def __init__(self) -> None:
        self.is_dropped = False
        self.frame_id = ""
        self.damaged = 0
        self.counts: Counter[str] = Counter()
        self.places, self.values = array("q"), array("d")
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

    def rows(self) -> Float64:
        """The values [n, width], in the order of the record; NaN for what is not measured."""
        return np.array(self.values, dtype=np.float64).reshape(-1, self.width)

    def sha256(self) -> str:
        """The hash of all messages one after the other, in hexadecimal."""
        return self._hash.hexdigest()

    def notes(self) -> Iterator[str]:
        """Remarks, without the topic and the full stop."""
        if self.damaged:
            yield f"{counted(self.damaged, 'message')} that cannot be decoded skipped"
        for what, count in (+self.counts).items():
            yield f"{counted(count, 'message')} {what}"


class Sentences(TopicListener):
    """NMEA in nmea_msgs/Sentence."""

    hashes = True

    def __init__(self) -> None:
        super().__init__()
        self._stream = NmeaStream(max_undated=_UNLIMITED)
        self.fixes: list[Any] = []

    def _add(self, message: Any, place: int) -> None:
        text = message.sentence.encode("utf-8", "replace").strip()
        self.fixes += self._stream.feed(text + b"\r\n")

    def finish(self) -> NmeaCounts:
        """Adds the fixes that were still open to `fixes`; what was found."""
        self.fixes += self._stream.finish()
        return self._stream.counts


def _fix(message: Any) -> tuple[float, ...] | str:
    """Latitude, longitude, height, quality and sigma."""
    if not (math.isfinite(message.latitude) and math.isfinite(message.longitude)):
        return "without a position skipped"
    quality, sigma_m = quality_of(message)
    sigma_m = math.nan if sigma_m is None else sigma_m
    return (message.latitude, message.longitude, message.altitude, quality, sigma_m)


def _sensed(message: Any) -> tuple[float, ...] | str:
    """Rates about the axes of an IMU, rad/s, and forces along them, m/s²."""
    if message.angular_velocity_covariance[:1].tolist() == [-1.0]:  # by its definition
        return "whose covariance says that there is no gyro"
    rates, forces = message.angular_velocity, message.linear_acceleration
    felt = (forces.x, forces.y, forces.z)
    if message.linear_acceleration_covariance[:1].tolist() == [-1.0] or not any(felt):
        felt = (math.nan, math.nan, math.nan)
    return (rates.x, rates.y, rates.z, *felt)


NumberTable = dict[str, tuple[int, Callable[[Any], tuple[float, ...] | str]]]
"""How many numbers a message of a type gives, and which; or why it gives none."""

_ROWS: NumberTable = {
    FIX: (5, _fix),
    IMU: (6, _sensed),
    ODOMETRY: (1, lambda message: (message.twist.twist.linear.x,)),
    POSE: (0, lambda _: ()),
    SURE_POSE: (0, lambda _: ()),
}


class Numbers(TopicListener):
    """The numbers of messages of a type, and of what moves how the frame `body` leans by them."""

    def __init__(self, type_: str, rows: NumberTable = _ROWS) -> None:
        super().__init__()
        self.hashes = type_ == FIX
        self.width, self._row = rows[type_]
        self._type = type_
        self.leans, self.body = Leans(), ""

    def _add(self, message: Any, place: int) -> None:
        if self._type != FIX:
            # A pose names the frame that it is in, and not whose it is.
            child = getattr(message, "child_frame_id", "")
            self.body = self.body or (self.frame_id if self._type == IMU else child)
            self.leans.add(message, place)
        row = self._row(message)
        if isinstance(row, str):
            self.counts[row] += 1
        else:
            self.places.append(place)
            self.values.extend(row)

    def fixes(self, times_ns: Int64) -> FixColumns:
        """The fixes by the times of all messages of the topic, 0 for none."""
        time_ns = times_ns[np.array(self.places, dtype=np.int64)]
        known = time_ns > 0
        lat, lon, height, quality, sigma = self.rows()[known].T
        without = ~np.isfinite(height)
        self.counts["without a height: taken as 0 m"] += int(np.count_nonzero(without))
        self.counts["without a time skipped"] += int(np.count_nonzero(~known))
        return FixColumns.of(
            time_ns[known],
            lat_deg=lat,
            lon_deg=lon,
            height_m=np.where(without, 0.0, height),
            quality=quality.astype(np.int64),
            sigma_m=sigma,
        )


class First(TopicListener):
    """The first message of a topic: a camera says the same with every image."""

    message: Any = None

    def _wants(self, place: int) -> bool:
        return self.message is None

    def _add(self, message: Any, place: int) -> None:
        self.message = message


class Texts(TopicListener):
    """What texts say, as rows: of the fixes on the topic beside them, of roll and pitch."""

    def __init__(self, said: JsonRows) -> None:
        super().__init__()
        self.said = said

    def _add(self, message: Any, place: int) -> None:
        self.said.add(message.data)
