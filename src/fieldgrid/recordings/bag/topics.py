"""Which topic of a bag is what: by its type, then by its name, and first of all by what is said."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from fieldgrid.core import NoFramesError, RecordingError
from fieldgrid.recordings.bag.topic_names import (
    accelerometer,
    base_name,
    driven_rank,
    imu_rank,
    is_made,
    is_rectified,
    namespace,
    right_partners,
    side_of,
)
from fieldgrid.recordings.ros.gnss_messages import DATUM
from fieldgrid.recordings.ros.model import Topic

Sensing = Literal["stereo", "disparity", "depth", "cloud", ""]
"""What the frames are made of; "" for a bag that has none."""

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO, DISPARITY = "sensor_msgs/msg/CameraInfo", "stereo_msgs/msg/DisparityImage"
CLOUD, FIX, NMEA = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/NavSatFix",
    "nmea_msgs/msg/Sentence",
)
IMU, ODOMETRY = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
POSE, SURE_POSE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
FIXES = frozenset({"fix", "nmea"})
"""The roles that give fixes, of which one is taken."""
TF_STATIC, TF = "/tf_static", ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
PLACE = "geometry_msgs/msg/Transform"
TEXT, NUMBER = "std_msgs/msg/String", "std_msgs/msg/Float32"

_PICTURES = (IMAGE, COMPRESSED)
_NO_PICTURE = re.compile(r"depth|disparity|confidence|mask|label|segment|debug|theora")


class TopicRole(NamedTuple):
    """What a topic is to a recording: of which types it is, the role of its calibration, how its
    name has to be, and of several the rank, by name and type; the lowest is the best."""

    types: tuple[str, ...]
    info: str = ""
    named: re.Pattern[str] = re.compile("")
    rank: Callable[[str, str], Any] = lambda _name, _type: 0


def _depth_rank(name: str, type_: str) -> tuple[bool, bool, bool, bool]:
    """Of the depth camera itself, rectified, plain, without loss first."""
    is_packed = type_ == COMPRESSED
    return "aligned" in name, not is_rectified(name), is_packed, not name.endswith("Depth")


ROLES: dict[str, TopicRole] = {
    "left": TopicRole(_PICTURES, "left_info"),
    "right": TopicRole(_PICTURES, "right_info"),
    "left_info": TopicRole((INFO,)),
    "right_info": TopicRole((INFO,)),
    "depth_info": TopicRole((INFO,)),
    "disparity": TopicRole((DISPARITY,), "left_info"),
    # The cameras of Luxonis call depths just `stereo`.
    "depth": TopicRole(
        _PICTURES,
        "depth_info",
        re.compile(r"^(?!.*confidence).*(depth|(?<![a-z])stereo/image_(raw|rect)$)"),
        _depth_rank,
    ),
    "cloud": TopicRole((CLOUD,), rank=lambda name, _: is_made(name)),
    "fix": TopicRole((FIX,), rank=lambda name, _: is_made(name)),
    "nmea": TopicRole((NMEA,)),
    "imu": TopicRole((IMU,), rank=lambda name, _: imu_rank(name)),
    "odometry": TopicRole((ODOMETRY,), rank=lambda name, _: driven_rank(name)),
    "attitude": TopicRole((IMU, ODOMETRY, POSE, SURE_POSE)),
}
TYPES_OF_ROLES = {name: role.types for name, role in ROLES.items()}
_SENSORS: dict[Sensing, tuple[str, ...]] = {
    "stereo": ("left", "right", "right_info"),
    "disparity": ("disparity",),
    "depth": ("depth", "depth_info"),
    "cloud": ("cloud",),
}
_MOST_LISTED = 2000


class Choice(NamedTuple):
    """The topics by their roles (those of `options.ROLES` that were found), and what is told.

    `problem` is the error of a bag whose frames cannot be chosen, None where they are or where
    there are none.
    """

    kind: Sensing
    roles: Mapping[str, str]
    notes: tuple[str, ...] = ()
    problem: RecordingError | None = None


def choose(
    topics: Mapping[str, Topic],
    given: Mapping[str, str],
    path: Path,
    unwanted: Collection[str] = (),
    sensor: str | None = None,
    partners: Mapping[str, str] | None = None,
) -> Choice:
    """The topics of a bag that are used; `given` names some by their role and outranks names.

    `sensor` is the kind of frames to take where nothing of it is given, None for the best.
    `partners` are calibrations of left cameras with those of their right ones, for images whose
    names say nothing.
    Roles that are `unwanted` stay empty. Raises RecordingError for a given topic that is not
    there or of another type, and where the names leave a choice open; what is open about the
    frames is told in the choice, since not everybody wants them.
    """
    filled = {name: topic for name, topic in topics.items() if topic.count and name != DATUM}
    finder = _Finder(filled, {**given}, path, partners or {})
    finder.check_given(topics)
    kind: Sensing = ""
    problem = None
    try:
        kind = finder.sensor(sensor)
    except RecordingError as error:
        problem = error
    for role in ("fix", "nmea", "imu", "odometry"):
        if role not in unwanted:
            finder.single(role)
    roles = finder.roles
    forces = filled.get(accelerometer(roles.get("imu", "")))
    if forces is not None and forces.type == IMU and forces.name != roles["imu"]:
        roles["acceleration"] = forces.name
    if "attitude" in given:
        roles["attitude"] = given["attitude"]
    return Choice(kind, roles, _told(roles, filled), problem)


def no_frames(topics: Mapping[str, Topic], path: Path) -> NoFramesError:
    """The error of a bag in which there is nothing that frames could be made of."""
    return NoFramesError(
        f"{path} has no pair of a left and a right image, and neither disparity, depth image with "
        f"its camera_info, nor point cloud; it has {listing(topics.values())}; name the images "
        "with --topic left=NAME --topic right=NAME, or --topic depth=NAME."
    )


def listing(topics: Iterable[Topic]) -> str:
    """Topics with their types, for a message."""
    named = [f"{topic.name} ({short(topic.type)}, {topic.count})" for topic in topics]
    text = ", ".join(sorted(named)) or "no topic at all"
    return text if len(text) <= _MOST_LISTED else text[:_MOST_LISTED] + " ..."


def short(kind: str) -> str:
    """A type as people write it: sensor_msgs/Image."""
    return kind.replace("/msg/", "/")


def static_transforms(topics: Mapping[str, Topic], roles: Mapping[str, str]) -> list[str]:
    """The topics of static transforms: the usual one, those of the namespaces that the topics in
    use are in, and the places of streams."""
    used = [f"/{name.lstrip('/')}" for name in roles.values()]
    found = [
        name
        for name in _of_types(topics, TF)
        if name.endswith(TF_STATIC)
        and any(other.startswith(name.removesuffix("tf_static")) for other in used)
    ]
    return found + _of_types(topics, (PLACE,))


def _told(roles: Mapping[str, str], topics: Mapping[str, Topic]) -> tuple[str, ...]:
    used = ", ".join(f"{role} {topic}" for role, topic in roles.items())
    notes = [f"Topics: {used}."] if used else []
    left = [topic for name, topic in topics.items() if name not in roles.values()]
    left = [topic for topic in left if topic.type in _KNOWN_TYPES]
    if left:
        notes.append(f"Not used: {listing(left)}.")
    return tuple(notes)


_KNOWN_TYPES = frozenset(
    kind for role, kinds in TYPES_OF_ROLES.items() for kind in kinds if role != "attitude"
)
"""Of these a recording takes some by itself."""


class _Finder:
    """One search; `roles` is what it has found so far."""

    def __init__(
        self,
        topics: Mapping[str, Topic],
        given: dict[str, str],
        path: Path,
        partners: Mapping[str, str],
    ) -> None:
        self._topics, self._given, self._path = topics, given, path
        self._partners = partners
        self.roles: dict[str, str] = {}

    def check_given(self, everything: Mapping[str, Topic]) -> None:
        """Raise for a given topic that cannot be what it is said to be."""
        for role, name in self._given.items():
            topic, types = everything.get(name), ROLES[role].types
            if topic is None:
                what = "is not there"
            elif topic.type not in types:
                what = f"is of the type {short(topic.type)}, not {' or '.join(map(short, types))}"
            elif topic.count == 0:
                what = "has no message"
            else:
                continue
            raise RecordingError(
                f"{self._path}: --topic {role}={name} {what}; give another topic of "
                f"{listing(everything.values())}."
            )

    def sensor(self, wanted: str | None) -> Sensing:
        """Find the topics of the given sensor, else of the wanted one, else of the best."""
        if "left" in self._given and self._given["left"] == self._given.get("right"):
            raise RecordingError(
                f"{self._path}: left and right are both {self._given['left']}; give two topics."
            )
        asked = [kind for kind, roles in _SENSORS.items() if set(roles) & self._given.keys()]
        if len(asked) > 1:
            raise RecordingError(
                f"{self._path}: the given topics are of {' and '.join(asked)}; give those of one."
            )
        for kind in asked or [kind for kind in _SENSORS if wanted in (None, kind)]:
            if self._stereo() if kind == "stereo" else self.single(kind):
                return kind
        return ""

    def single(self, role: str) -> bool:
        """Find the one topic of a role, and of its calibration: the given one, else the one of the
        lowest rank. Whether there is any."""
        row = ROLES[role]
        names = [
            name
            for name in _of_types(self._topics, row.types)
            if row.named.search(base_name(name).lower())
        ]
        if role in self._given:
            names = [self._given[role]]
        ranks = [row.rank(name, self._topics[name].type) for name in names]
        names = [name for name, rank in zip(names, ranks, strict=True) if rank == min(ranks)]
        if len(names) > 1:
            raise RecordingError(
                f"{self._path} has several topics for {role}: {', '.join(names)}; choose one with "
                f"--topic {role}={names[0]}."
            )
        for name in names:
            self.roles[role] = name
            if row.info:
                self._info(row.info, name, lone=True)
        return bool(names)

    def _stereo(self) -> bool:
        pairs = self._pairs()
        best = min((_image_rank(pair[0], self._topics) for pair in pairs), default=None)
        pairs = [pair for pair in pairs if _image_rank(pair[0], self._topics) == best]
        places = {namespace(left) for left, _ in pairs}
        if len(places) > 1:
            named = ", ".join(f"{left} with {right}" for left, right in pairs)
            raise RecordingError(
                f"{self._path} has several stereo pairs: {named}; choose one with --topic "
                f"left={pairs[0][0]}."
            )
        if not pairs:
            if self._given.keys() & {"left", "right"}:
                raise self._lacks_partner()
            return False
        self.roles["left"], self.roles["right"] = min(pairs, key=lambda p: (len(p[0]), p[0]))
        for side in ("left", "right"):
            self._info(ROLES[side].info, self.roles[side], lone=False)
        return True

    def _pairs(self) -> list[tuple[str, str]]:
        """Left and right topics whose names differ in nothing but the side, else those beside
        the calibrations of one pair."""
        left, right = self._given.get("left"), self._given.get("right")
        if left and right:
            return [(left, right)]
        images = _of_types(self._topics, (IMAGE, COMPRESSED))
        pairs = [
            (name, partner)
            for name in images
            for partner in right_partners(name)
            if partner in images
            and not _NO_PICTURE.search(name.lower())
            and self._topics[name].type == self._topics[partner].type
        ]
        pairs = pairs or [
            (name, partner)
            for name in images
            for partner in images
            if (other := self._partners.get(_beside(name, self._topics)))
            and other == _beside(partner, self._topics)
            and name.rpartition("/")[2] == partner.rpartition("/")[2]
            and not _NO_PICTURE.search(name.lower())
        ]
        return [p for p in pairs if left in (None, p[0]) and right in (None, p[1])]

    def _lacks_partner(self) -> RecordingError:
        role = "left" if "left" in self._given else "right"
        other = "right" if role == "left" else "left"
        images = [t for t in self._topics.values() if t.type in (IMAGE, COMPRESSED)]
        return RecordingError(
            f"{self._path}: no name of a topic tells the partner of {role}={self._given[role]}; "
            f"add --topic {other}=NAME, of {listing(images)}."
        )

    def _info(self, role: str, image: str, *, lone: bool) -> None:
        """The calibration beside an image, or the only one of its side, or if it may be `lone`
        the only one at all. That there is none is told later."""
        infos, side = _of_types(self._topics, (INFO,)), role.removesuffix("_info")
        side = side if side != "depth" else ""
        parts = base_name(image).split("/")[:-1]
        near = ["/".join(parts[:k]) for k in range(len(parts), 0, -1)]
        beside = [f"{place}/camera_info" for place in (base_name(image), *near[: 2 if lone else 1])]
        beside += [f"{place}/info/camera_info" for place in near[:2]]
        beside += [f"{place}/{side}/camera_info" for place in near if side]
        sided = [name for name in infos if side_of(name) == side]
        candidates = [
            *([self._given[role]] if role in self._given else []),
            *(name for name in beside if name in infos),
            *(sided if len(sided) == 1 else []),
            *(infos if lone and len(infos) == 1 else []),
        ]
        if candidates:
            self.roles[role] = candidates[0]


def _of_types(topics: Mapping[str, Topic], types: tuple[str, ...]) -> list[str]:
    return sorted(name for name, topic in topics.items() if topic.type in types)


def _image_rank(name: str, topics: Mapping[str, Topic]) -> tuple[bool, bool, bool]:
    """Rectified before raw, grey before colour, plain before compressed."""
    coloured = re.search(r"colou?r|rgb", name.lower()) is not None
    return not is_rectified(name), coloured, topics[name].type == COMPRESSED


def _beside(image: str, topics: Mapping[str, Topic]) -> str:
    """The calibration below an image, else beside it."""
    below = f"{base_name(image)}/camera_info"
    return below if below in topics else f"{namespace(image)}/camera_info"
