"""What takes the messages of the topics of a bag: numbers, sentences, texts, or the first alone."""

from __future__ import annotations

import hashlib
import math
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError, counted
from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.poses import NmeaStream
from fieldgrid.recordings.bag.topic_names import (
    FIX,
    IMU,
    ODOMETRY,
    POSE,
    SURE_POSE,
    stream_frame,
)
from fieldgrid.recordings.poses.pose_files import OFF_UNIT
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.gnss_messages import JsonRows, quality_of
from fieldgrid.recordings.ros.model import Message

_UNLIMITED = 1 << 60

MOST_SIGMA_DEG = 15.0
"""An orientation that states a larger error says that it does not know: odometry in the plane has a
large variance there."""

_OF_POSE, _OF_IMU = [21, 28], [0, 4]
"""The variances of roll and pitch in a covariance of x, y, z and the turns about them, and in one
of the turns alone."""

_UNTOLD = (math.nan,) * 4


class TopicListener:
    """Takes the messages of one topic, of which it decodes the `first`: a camera says the same of
    itself with every image. Others decode more. Messages of which something is to be told are
    counted by it."""

    hashes = takes_all = False

    def __init__(self, name: str, type_: str) -> None:
        self.name = name
        self.is_dropped = False
        self.first: Any = None
        self.counts: Counter[str] = Counter()
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
            self.counts["that cannot be decoded skipped"] += 1
            return
        self.first = self.first or found
        self._add(found, place)

    def _wants(self, place: int) -> bool:
        """Whether the message of this place is to be decoded."""
        return self.takes_all or self.first is None

    def _add(self, message: Any, place: int) -> None:
        """Keep what a decoded message says."""

    @property
    def frame_id(self) -> str:
        """The frame of the messages, by the name of the topic or the first of them; else empty."""
        header = getattr(self.first, "header", None)
        return stream_frame(self.name) or ("" if header is None else str(header.frame_id))

    def sha256(self) -> str:
        """The hash of all messages one after the other, in hexadecimal."""
        return self._hash.hexdigest()

    def notes(self) -> list[str]:
        """Remarks, a sentence each."""
        return [
            f"{self.name}: {counted(count, 'message')} {what}."
            for what, count in self.counts.items()
        ]


class Sentences(TopicListener):
    """NMEA in nmea_msgs/Sentence; `fixes` without those that are still open in `stream`."""

    hashes = takes_all = True

    def __init__(self, name: str, type_: str) -> None:
        super().__init__(name, type_)
        self.stream = NmeaStream(max_undated=_UNLIMITED)
        self.fixes: list[Fix] = []

    def _add(self, message: Any, place: int) -> None:
        text = message.sentence.encode("utf-8", "replace").strip()
        self.fixes += self.stream.feed(text + b"\r\n")


class Texts(TopicListener):
    """What texts say, as rows: of the fixes on the topic beside them, of roll and pitch."""

    takes_all = True

    def __init__(self, rows: Callable[[], JsonRows], name: str, type_: str) -> None:
        super().__init__(name, type_)
        self.said = rows()

    def _add(self, message: Any, place: int) -> None:
        self.said.add(message.data)


def _fix(message: Any) -> tuple[float, ...]:
    """Latitude, longitude, height, quality and sigma."""
    quality, sigma_m = quality_of(message)
    sigma_m = math.nan if sigma_m is None else sigma_m
    return (message.latitude, message.longitude, message.altitude, quality, sigma_m)


def lean_of(message: Any) -> tuple[float, float, float, float]:
    """The vertical in a body's axes, and its stated 1-sigma error (degrees; NaN for none), by a
    sensor_msgs/Imu, nav_msgs/Odometry, or pose with or without a covariance; NaN if it tells none.
    """
    if hasattr(message, "orientation_covariance"):
        variances, turn = message.orientation_covariance[_OF_IMU].tolist(), message.orientation
        if variances[0] == -1.0:  # by its definition: it has no orientation
            return _UNTOLD
    elif hasattr(message.pose, "covariance"):
        variances = message.pose.covariance[_OF_POSE].tolist()
        turn = message.pose.pose.orientation
    else:
        variances, turn = [0.0], message.pose.orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    length2 = x * x + y * y + z * z + w * w
    most = max(variances)
    sigma_deg = math.degrees(math.sqrt(most)) if 0.0 < most < math.inf else math.nan
    if sigma_deg > MOST_SIGMA_DEG or not abs(length2 - 1.0) < 2.0 * OFF_UNIT:
        return _UNTOLD
    return (
        2.0 * (x * z - w * y) / length2,
        2.0 * (y * z + w * x) / length2,
        (w * w - x * x - y * y + z * z) / length2,
        sigma_deg,
    )


def sensed_by(message: Any) -> tuple[float, ...]:
    """Rates about the axes of an IMU, rad/s, and forces along them, m/s²; NaN where it has none."""
    rates, forces = message.angular_velocity, message.linear_acceleration
    turning, felt = (rates.x, rates.y, rates.z), (forces.x, forces.y, forces.z)
    # By the definition of the message there is then no gyro, or no accelerometer.
    if message.angular_velocity_covariance[:1].tolist() == [-1.0]:
        turning = (math.nan, math.nan, math.nan)
    if message.linear_acceleration_covariance[:1].tolist() == [-1.0] or not any(felt):
        felt = (math.nan, math.nan, math.nan)
    return (*turning, *felt)


NumberTable = Mapping[str, tuple[int, Callable[[Any], tuple[float, ...]]]]
"""How many numbers a message of a type gives, and which."""

_ROWS: NumberTable = {
    FIX: (5, _fix),
    IMU: (10, lambda message: (*sensed_by(message), *lean_of(message))),
    ODOMETRY: (5, lambda message: (message.twist.twist.linear.x, *lean_of(message))),
    POSE: (4, lean_of),
    SURE_POSE: (4, lean_of),
}


class Numbers(TopicListener):
    """The numbers of messages of a type, NaN for what is not measured; of what moves, the last four
    are how it leans (:func:`lean_of`)."""

    takes_all = True

    def __init__(self, name: str, type_: str, rows: NumberTable = _ROWS) -> None:
        super().__init__(name, type_)
        self.hashes = type_ == FIX
        self._width, self._row = rows[type_]
        self._places, self._values = array("q"), array("d")

    def _add(self, message: Any, place: int) -> None:
        self._places.append(place)
        self._values.extend(self._row(message))

    @property
    def places(self) -> Int64:
        """The places of the messages that could be decoded, [n]."""
        return np.array(self._places, dtype=np.int64)

    @property
    def body(self) -> str:
        """The frame that the orientations are of: of odometry that of the vehicle; a pose names the
        frame that it is in, and not whose it is."""
        is_imu = hasattr(self.first, "angular_velocity")
        return self.frame_id if is_imu else str(getattr(self.first, "child_frame_id", ""))

    def rows(self) -> Float64:
        """Their numbers [n, k], in the order of the record."""
        return np.array(self._values, dtype=np.float64).reshape(-1, self._width)

    def fixes(self, times_ns: Int64) -> FixColumns:
        """The fixes by the times of all messages of the topic, 0 for none."""
        time_ns, rows = times_ns[self.places], self.rows()
        placed, dated = np.isfinite(rows[:, :2]).all(axis=1), time_ns > 0
        without = placed & ~np.isfinite(rows[:, 2])
        lacking = {
            "without a position skipped": ~placed,
            "without a height: taken as 0 m": without,
            "without a time skipped": placed & ~dated,
        }
        self.counts += {what: int(is_so.sum()) for what, is_so in lacking.items()}
        rows[without, 2] = 0.0
        lat, lon, height, quality, sigma = rows[placed & dated].T
        return FixColumns.of(
            time_ns[placed & dated],
            lat_deg=lat,
            lon_deg=lon,
            height_m=height,
            quality=quality.astype(np.int64),
            sigma_m=sigma,
        )
