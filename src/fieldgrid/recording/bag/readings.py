"""What of a bag is not images, read in one pass: fixes, gyro, wheels, calibration, transforms."""

from __future__ import annotations

import hashlib
import math
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int64
from fieldgrid.errors import RecordingError
from fieldgrid.fixes import Fix, quality_by_sigma
from fieldgrid.gnss import NmeaLog, NmeaStream
from fieldgrid.quality import Quality
from fieldgrid.recording.bag.order import clock
from fieldgrid.recording.bag.topics import FIXES, static_transforms
from fieldgrid.recording.bag.transforms import Transforms
from fieldgrid.ros import Bag, Message, decode

_CALIBRATIONS = ("left_info", "right_info", "depth_info")
_UNLIMITED = 1 << 60
_NO_FIX, _UNKNOWN = -1, 0
# NavSatStatus: a fix, one with satellite-based and one with ground-based corrections.
_QUALITY_OF_STATUS = {
    _NO_FIX: Quality.NONE,
    0: Quality.GPS,
    1: Quality.SBAS,
    2: Quality.DIFFERENTIAL,
}


class Turns(NamedTuple):
    """Rates of turn about the axes of an IMU, rad/s [n, 3], in the order of the record."""

    time_ns: Int64
    rates_rad_s: Float64


class Speeds(NamedTuple):
    """Speeds along the x axis of the vehicle, m/s, in the order of the record."""

    time_ns: Int64
    speed_mps: Float64


@dataclass
class Readings:
    """The content of the small topics of a bag.

    `infos` are the first messages of calibration by their role, `frame_ids` those of the
    first message of a role, `sha256` the hashes of all messages of a role that gives fixes.
    `notes` are remarks, a sentence each.
    """

    nmea: NmeaLog = field(default_factory=lambda: NmeaLog([]))
    fixes: list[Fix] = field(default_factory=list)
    turns: Turns | None = None
    speeds: Speeds | None = None
    infos: dict[str, Any] = field(default_factory=dict)
    frame_ids: dict[str, str] = field(default_factory=dict)
    sha256: dict[str, str] = field(default_factory=dict)
    transforms: Transforms = field(default_factory=Transforms)
    notes: list[str] = field(default_factory=list)


def read_readings(bag: Bag, roles: Mapping[str, str]) -> Readings:
    """One pass over the topics of these roles that are small; images are left alone.

    A message that does not fit its type is left out and counted.
    """
    one_pass = _Pass(bag, roles)
    of_topic: dict[str, list[tuple[str, Callable[[Any, Message, int], None]]]] = {}
    for role, take in one_pass.takers().items():
        if role in roles:
            of_topic.setdefault(roles[role], []).append((role, take))
    for topic in static_transforms(bag.topics, roles):
        of_topic[topic] = [("", lambda tree, *_: one_pass.found.transforms.add(tree))]
    places: Counter[str] = Counter()
    for message in bag.messages(tuple(of_topic)):
        place = places[message.topic]
        places[message.topic] += 1
        one_pass.hash(message)
        wanted = [t for role, t in of_topic[message.topic] if role not in one_pass.found.infos]
        if not wanted:
            continue  # a camera says the same with every image
        try:
            found = decode(message)
        except RecordingError:
            one_pass.damaged[message.topic] += 1
            continue
        for take in wanted:
            take(found, message, place)
    return one_pass.finish()


class _Pass:
    """What one pass has collected so far."""

    def __init__(self, bag: Bag, roles: Mapping[str, str]) -> None:
        self.found = Readings()
        self.damaged: Counter[str] = Counter()
        self._bag, self._roles = bag, roles
        self._nmea = NmeaStream(max_undated=_UNLIMITED)
        self._sentences: list[Fix] = []
        self._clocks: dict[str, Int64] = {}
        self._counts: Counter[str] = Counter()
        self._turn_ns, self._turn_xyz = array("q"), array("d")
        self._speed_ns, self._speed = array("q"), array("d")
        self._no_gyro = 0
        self._hashes = {roles[role]: hashlib.sha256() for role in FIXES if role in roles}

    def hash(self, message: Message) -> None:
        """Take a message into the hash of its topic, if that gives fixes."""
        if message.topic in self._hashes:
            self._hashes[message.topic].update(message.data)

    def takers(self) -> dict[str, Callable[[Any, Message, int], None]]:
        """What to do with a decoded message, by role."""
        infos = {role: self._info_taker(role) for role in _CALIBRATIONS}
        return {
            "fix": self._fix,
            "nmea": self._sentence,
            "imu": self._turn,
            "odometry": self._speeds,
            **infos,
        }

    def finish(self) -> Readings:
        """Everything, once the last message is through."""
        found = self.found
        found.sha256 = {
            role: self._hashes[self._roles[role]].hexdigest() for role in FIXES & self._roles.keys()
        }
        if "nmea" in self._roles:
            self._sentences += self._nmea.finish()
            found.nmea = self._nmea.log(self._sentences)
        if self._turn_ns:
            rates = np.array(self._turn_xyz, dtype=np.float64).reshape(-1, 3)
            found.turns = Turns(np.array(self._turn_ns, dtype=np.int64), rates)
        if self._speed_ns:
            found.speeds = Speeds(
                np.array(self._speed_ns, dtype=np.int64), np.array(self._speed, dtype=np.float64)
            )
        if self._no_gyro:
            topic = self._roles["imu"]
            found.notes.append(f"{topic}: {self._no_gyro} messages say that they have no gyro.")
        for topic, count in self.damaged.items():
            found.notes.append(f"{topic}: {count} messages do not fit their type; skipped.")
        for what, count in self._counts.items():
            if count:
                found.notes.append(f"{self._roles['fix']}: {count} {what}.")
        return found

    def _time_ns(self, topic: str, place: int) -> int:
        """The time of a message, 0 for none, by the clock that the whole topic has."""
        if topic not in self._clocks:
            times = clock(topic, *self._bag.stamps(topic))
            if times.received:
                self.found.notes.append(
                    f"{topic}: the header stamps are no UTC; the recorder's times are taken."
                )
            self._clocks[topic] = times.time_ns
        times_ns = self._clocks[topic]
        return int(times_ns[place]) if place < len(times_ns) else 0

    def _info_taker(self, role: str) -> Callable[[Any, Message, int], None]:
        def take(info: Any, _message: Message, _place: int) -> None:
            self.found.infos[role] = info
            self.found.frame_ids[role] = info.header.frame_id

        return take

    def _sentence(self, said: Any, _message: Message, _place: int) -> None:
        self.found.frame_ids.setdefault("nmea", said.header.frame_id)
        text = said.sentence.encode("utf-8", "replace").strip()
        self._sentences += self._nmea.feed(text + b"\r\n")

    def _fix(self, said: Any, message: Message, place: int) -> None:
        self.found.frame_ids.setdefault("fix", said.header.frame_id)
        time_ns = self._time_ns(message.topic, place)
        if not (math.isfinite(said.latitude) and math.isfinite(said.longitude)):
            self._counts["messages without a position skipped"] += 1
        elif not time_ns:
            self._counts["messages without a time skipped"] += 1
        else:
            self._counts["messages without a height: taken as 0 m"] += not math.isfinite(
                said.altitude
            )
            self.found.fixes.append(fix_of(said, time_ns))

    def _turn(self, said: Any, message: Message, place: int) -> None:
        self.found.frame_ids.setdefault("imu", said.header.frame_id)
        if said.angular_velocity_covariance[:1].tolist() == [-1.0]:  # by its definition
            self._no_gyro += 1
            return
        rates = said.angular_velocity
        self._turn_ns.append(self._time_ns(message.topic, place))
        self._turn_xyz.extend((rates.x, rates.y, rates.z))

    def _speeds(self, said: Any, message: Message, place: int) -> None:
        self._speed_ns.append(self._time_ns(message.topic, place))
        self._speed.append(said.twist.twist.linear.x)


def fix_of(said: Any, time_ns: int) -> Fix:
    """The fix of a sensor_msgs/NavSatFix: its altitude is above the ellipsoid.

    The quality is that of the status, and RTK fixed where the covariance says centimetres. A
    covariance of unknown type, of zeros or of nonsense says nothing.
    """
    sigma_m = _sigma_m(said)
    quality = _QUALITY_OF_STATUS.get(int(said.status.status), Quality.UNKNOWN)
    if quality is not Quality.NONE and sigma_m is not None:
        by_sigma = Quality(int(quality_by_sigma(sigma_m)))
        quality = quality if by_sigma is Quality.UNKNOWN else by_sigma
    height_m = float(said.altitude)
    return Fix(
        time_ns=time_ns,
        lat_deg=float(said.latitude),
        lon_deg=float(said.longitude),
        height_m=height_m if math.isfinite(height_m) else 0.0,
        quality=quality,
        sigma_m=sigma_m,
    )


def _sigma_m(said: Any) -> float | None:
    """1-sigma error along one horizontal axis; None when it is not said."""
    if said.position_covariance_type == _UNKNOWN or len(said.position_covariance) != 9:
        return None
    east, north = (float(said.position_covariance[k]) for k in (0, 4))
    if not (east > 0.0 and north > 0.0):
        return None
    mean = east if east == north else (east + north) / 2.0
    return math.sqrt(mean) if math.isfinite(mean) else None
