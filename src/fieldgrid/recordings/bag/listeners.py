"""What is heard of the topics of a bag, by their kind: fixes, gyro, wheels, calibrations."""

from __future__ import annotations

import hashlib
import math
from array import array
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError, counted
from fieldgrid.geometry import FixColumns, Orientation, RecordedTilt
from fieldgrid.poses import NmeaCounts, NmeaStream
from fieldgrid.recordings.bag.leaning import Leans
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.gnss_messages import Details, Tilts, quality_of
from fieldgrid.recordings.ros.model import Message

_UNLIMITED = 1 << 60


class TopicListener:
    """The messages of one topic, each decoded and added; those that do not fit their type are
    counted. `frame_id` is that of the first message.

    `values` are the numbers of each message in `places`; `leans` is how the frame `body` leans.
    """

    hashes = False

    def __init__(self) -> None:
        self.is_dropped = False
        self.frame_id = ""
        self.damaged = 0
        self.counts: Counter[str] = Counter()
        self.places, self.values = array("q"), array("d")
        self.leans, self.body = Leans(), ""
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

    def rows(self, width: int) -> Float64:
        """The values [n, width], in the order of the record; NaN for what is not measured."""
        return np.array(self.values, dtype=np.float64).reshape(-1, width)

    def sha256(self) -> str:
        """The hash of all messages one after the other, in hexadecimal."""
        return self._hash.hexdigest()

    def notes(self) -> Iterator[str]:
        """Remarks, without the topic and the full stop."""
        if self.damaged:
            yield f"{counted(self.damaged, 'message')} that cannot be decoded skipped"
        for what, count in self.counts.items():
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


class Fixes(TopicListener):
    """Positions of sensor_msgs/NavSatFix."""

    hashes = True

    def _add(self, message: Any, place: int) -> None:
        lat_deg, lon_deg, height_m = message.latitude, message.longitude, message.altitude
        if not (math.isfinite(lat_deg) and math.isfinite(lon_deg)):
            self.counts["without a position skipped"] += 1
            return
        if not math.isfinite(height_m):
            self.counts["without a height: taken as 0 m"] += 1
            height_m = 0.0
        quality, sigma_m = quality_of(message)
        self.places.append(place)
        self.values.extend(
            (lat_deg, lon_deg, height_m, quality, math.nan if sigma_m is None else sigma_m)
        )

    def columns(self, times_ns: Int64) -> FixColumns:
        """The fixes by the times of all messages of the topic, 0 for none."""
        time_ns = times_ns[np.array(self.places, dtype=np.int64)]
        known = time_ns > 0
        if not known.all():
            self.counts["without a time skipped"] = int(np.count_nonzero(~known))
        lat, lon, height, quality, sigma = self.rows(5)[known].T
        return FixColumns.of(
            time_ns[known],
            lat_deg=lat,
            lon_deg=lon,
            height_m=height,
            quality=quality.astype(np.int64),
            sigma_m=sigma,
        )


class Turns(TopicListener):
    """Rates of turn about the axes of an IMU, rad/s, forces along them, m/s², and how it leans by
    its own estimate."""

    def _add(self, message: Any, place: int) -> None:
        self.body = self.frame_id
        self.leans.add(message, place)
        if message.angular_velocity_covariance[:1].tolist() == [-1.0]:  # by its definition
            self.counts["whose covariance says that there is no gyro"] += 1
            return
        rates, forces = message.angular_velocity, message.linear_acceleration
        felt = (forces.x, forces.y, forces.z)
        if message.linear_acceleration_covariance[:1].tolist() == [-1.0]:
            felt = (math.nan, math.nan, math.nan)
        self.places.append(place)
        self.values.extend((rates.x, rates.y, rates.z, *felt))


class Speeds(TopicListener):
    """Speeds along the x axis of the vehicle, m/s, and how it leans, by nav_msgs/Odometry."""

    def _add(self, message: Any, place: int) -> None:
        self.body = self.body or message.child_frame_id
        self.leans.add(message, place)
        self.places.append(place)
        self.values.append(message.twist.twist.linear.x)


class AttitudeMessages(TopicListener):
    """How the vehicle leans, by the topic that was given for it."""

    def _add(self, message: Any, place: int) -> None:
        if not self.body:  # a pose names the frame that it is in, and not whose it is
            is_imu = hasattr(message, "orientation")
            self.body = self.frame_id if is_imu else getattr(message, "child_frame_id", "")
        self.leans.add(message, place)


class TiltListener(TopicListener):
    """Roll and pitch as a converted drive keeps them."""

    def __init__(self, kind: type[RecordedTilt | Orientation]) -> None:
        super().__init__()
        self.tilts = Tilts(kind)

    def _add(self, message: Any, place: int) -> None:
        self.tilts.add(message.data)


class First(TopicListener):
    """The first message of a topic: a camera says the same with every image."""

    message: Any = None

    def _wants(self, place: int) -> bool:
        return self.message is None

    def _add(self, message: Any, place: int) -> None:
        self.message = message


class Texts(TopicListener):
    """What texts say of the fixes on the topic beside them."""

    def __init__(self) -> None:
        super().__init__()
        self.details = Details()

    def _add(self, message: Any, place: int) -> None:
        self.details.add(message.data)
