"""What each topic of a bag is to a recording: by its type, then by its name, and first of all by
what is said."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

from fieldgrid.core import RecordingError
from fieldgrid.geometry import Orientation, RecordedTilt
from fieldgrid.recordings.bag.listeners import (
    Numbers,
    Sentences,
    Texts,
    TopicListener,
)
from fieldgrid.recordings.bag.topic_names import (
    CLOUD,
    COMPRESSED,
    DISPARITY,
    FIX,
    IMAGE,
    IMU,
    INFO,
    NMEA,
    NUMBER,
    ODOMETRY,
    PLACE,
    POSE,
    SURE_POSE,
    TEXT,
    TF,
    TF_STATIC,
    accelerometer,
    base_name,
    driven_rank,
    imu_rank,
    is_made,
    is_rectified,
    namespace,
    pair_rank,
    right_partners,
    side_of,
)
from fieldgrid.recordings.bag.transforms import MovingTrees, StreamPlace, Trees
from fieldgrid.recordings.ros.gnss_messages import (
    DATUM,
    DETAILS,
    ORIENTATION,
    RIG,
    TILT,
    Details,
    Tilts,
)
from fieldgrid.recordings.ros.model import Topic

Sensing = Literal["stereo", "disparity", "depth", "cloud", ""]
"""What the frames are made of; "" for a bag that has none."""

FIXES = frozenset({"fix", "nmea"})
"""The roles that give fixes, of which one is taken."""

_PICTURES = (IMAGE, COMPRESSED)
_NO_PICTURE = re.compile(r"depth|disparity|confidence|mask|label|segment|debug|theora")
Listener = Callable[[str, str], TopicListener]


class TopicKind(NamedTuple):
    """Topics of some types whose names fit a pattern: what they are to a recording (empty for what
    is told beside its sensors), the role of their calibration, which of several goes first (the
    lowest rank, by name and type), and what hears their messages while a bag opens."""

    types: tuple[str, ...]
    role: str = ""
    named: re.Pattern[str] = re.compile("")
    listener: Listener | None = None
    rank: Callable[[str, str], Any] | None = None
    info: str = ""

    def fits(self, name: str, type_: str) -> bool:
        """Whether a topic is of the kind."""
        return type_ in self.types and self.named.search(base_name(name)) is not None


def _depth_rank(name: str, type_: str) -> tuple[bool, bool, bool, bool]:
    """Of the depth camera itself, rectified, plain, without loss first."""
    is_packed = type_ == COMPRESSED
    return "aligned" in name, not is_rectified(name), is_packed, not name.endswith("Depth")


def _made_rank(name: str, _: str) -> bool:
    return is_made(name)


# The cameras of Luxonis call depths just `stereo`.
_DEPTHS = re.compile(r"(?i)^(?!.*confidence).*(depth|(?<![a-z])stereo/image_(raw|rect)$)")
_TILTS, _ORIENTATIONS = partial(Tilts, RecordedTilt), partial(Tilts, Orientation)

KINDS = (
    TopicKind(_PICTURES, "left", info="left_info"),
    TopicKind(_PICTURES, "right", info="right_info"),
    TopicKind((DISPARITY,), "disparity", info="left_info"),
    TopicKind(_PICTURES, "depth", _DEPTHS, rank=_depth_rank, info="depth_info"),
    TopicKind((CLOUD,), "cloud", rank=_made_rank),
    TopicKind((INFO,), listener=TopicListener),
    TopicKind((INFO,), "left_info"),
    TopicKind((INFO,), "right_info"),
    TopicKind((INFO,), "depth_info"),
    TopicKind((NUMBER,), named=re.compile("/option/Depth_Units/value$"), listener=TopicListener),
    TopicKind((TEXT,), named=re.compile(f"^{RIG}$"), listener=TopicListener),
    TopicKind((TEXT, FIX), named=re.compile(f"^{DATUM}$"), listener=TopicListener),
    TopicKind((TEXT,), "", re.compile(f"{DETAILS}$"), partial(Texts, Details)),
    TopicKind((TEXT,), "", re.compile(f"^{TILT}$"), partial(Texts, _TILTS)),
    TopicKind((TEXT,), "", re.compile(f"^{ORIENTATION}$"), partial(Texts, _ORIENTATIONS)),
    TopicKind((FIX,), "fix", listener=Numbers, rank=_made_rank),
    TopicKind((NMEA,), "nmea", listener=Sentences, rank=lambda _name, _: 0),
    TopicKind((IMU,), named=re.compile("(?i)accel"), listener=Numbers),
    TopicKind((IMU,), "imu", listener=Numbers, rank=lambda name, _: imu_rank(name)),
    TopicKind((ODOMETRY,), "odometry", listener=Numbers, rank=lambda name, _: driven_rank(name)),
    TopicKind((IMU, ODOMETRY, POSE, SURE_POSE), "attitude", listener=Numbers),
    TopicKind(TF, named=re.compile(f"{TF_STATIC}$"), listener=Trees),
    TopicKind(TF, listener=MovingTrees),
    TopicKind((PLACE,), listener=StreamPlace),
)
"""All that is taken of a bag; the first kind that fits holds. Of a role with a rank one topic is
found by itself; others are given, or found beside it."""

_BY_ROLE = {kind.role: kind for kind in KINDS if kind.role}
TYPES_OF_ROLES = {role: kind.types for role, kind in _BY_ROLE.items()}
_TAKEN = {type_ for kind in KINDS for type_ in kind.types if kind.role not in ("", "attitude")}
"""Of these a recording takes some by itself."""

_SENSORS: dict[Sensing, tuple[str, ...]] = {
    "stereo": ("left", "right", "right_info"),
    "disparity": ("disparity",),
    "depth": ("depth", "depth_info"),
    "cloud": ("cloud",),
}
_MOST_LISTED = 2000


def is_of_use(name: str, type_: str) -> bool:
    """Whether anything is taken of such a topic."""
    return any(kind.fits(name, type_) for kind in KINDS)


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
    _check_given(topics, given, path)
    filled = {name: topic for name, topic in topics.items() if topic.count and name != DATUM}
    finder = _Finder(filled, given, path, partners or {})
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
    used = ", ".join(f"{role} {topic}" for role, topic in roles.items())
    others = [t for t in filled.values() if t.type in _TAKEN and t.name not in roles.values()]
    told = {f"Topics: {used}.": used, f"Not used: {listing(others)}.": others}
    return Choice(kind, roles, tuple(note for note, is_so in told.items() if is_so), problem)


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


def _check_given(topics: Mapping[str, Topic], given: Mapping[str, str], path: Path) -> None:
    """Raise RecordingError for a given topic that cannot be what it is said to be."""
    for role, name in given.items():
        topic, types = topics.get(name, Topic(name, "", 0)), TYPES_OF_ROLES[role]
        problems = {
            "is not there": name not in topics,
            f"is of the type {short(topic.type)}, not {' or '.join(map(short, types))}": (
                topic.type not in types
            ),
            "has no message": topic.count == 0,
        }
        for what, is_so in problems.items():
            if is_so:
                raise RecordingError(
                    f"{path}: --topic {role}={name} {what}; give another topic of "
                    f"{listing(topics.values())}."
                )
    if "left" in given and given["left"] == given.get("right"):
        raise RecordingError(f"{path}: left and right are both {given['left']}; give two topics.")


class _Finder:
    """One search; `roles` is what it has found so far."""

    def __init__(
        self,
        topics: Mapping[str, Topic],
        given: Mapping[str, str],
        path: Path,
        partners: Mapping[str, str],
    ) -> None:
        self._topics, self._given, self._path = topics, given, path
        self._partners = partners
        self.roles: dict[str, str] = {}

    def sensor(self, wanted: str | None) -> Sensing:
        """Find the topics of the given sensor, else of the wanted one, else of the best."""
        asked = [kind for kind, roles in _SENSORS.items() if self._given.keys() & roles]
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
        kind, ranked = _BY_ROLE[role], dict[Any, list[str]]()
        for name in [self._given[role]] if role in self._given else sorted(self._topics):
            type_ = self._topics[name].type
            if role in self._given or kind.fits(name, type_):
                rank = kind.rank(name, type_) if kind.rank else 0
                ranked.setdefault(rank, []).append(name)
        names = ranked[min(ranked)] if ranked else []
        if len(names) > 1:
            raise RecordingError(
                f"{self._path} has several topics for {role}: {', '.join(names)}; choose one with "
                f"--topic {role}={names[0]}."
            )
        for name in names:
            self.roles[role] = name
            if kind.info:
                self._info(kind.info, name, lone=True)
        return bool(names)

    def _stereo(self) -> bool:
        """Find a pair, the best of several, and its calibrations. Whether there is any."""
        ranked: dict[Any, list[tuple[str, str]]] = {}
        for pair in self._pairs():
            ranked.setdefault(pair_rank(pair[0], self._topics[pair[0]].type), []).append(pair)
        pairs = ranked[min(ranked)] if ranked else []
        if len({namespace(left) for left, _ in pairs}) > 1:
            named = ", ".join(f"{left} with {right}" for left, right in pairs)
            raise RecordingError(
                f"{self._path} has several stereo pairs: {named}; choose one with --topic "
                f"left={pairs[0][0]}."
            )
        for role, other in (("left", "right"), ("right", "left")):
            if role in self._given and not pairs:
                raise RecordingError(
                    f"{self._path}: no name of a topic tells the partner of {role}="
                    f"{self._given[role]}; add --topic {other}=NAME, of "
                    f"{listing(t for t in self._topics.values() if t.type in _PICTURES)}."
                )
        if pairs:
            self.roles["left"], self.roles["right"] = min(pairs, key=lambda p: (len(p[0]), p[0]))
            self._info("left_info", self.roles["left"], lone=False)
            self._info("right_info", self.roles["right"], lone=False)
        return bool(pairs)

    def _pairs(self) -> list[tuple[str, str]]:
        """Left and right topics whose names differ in nothing but the side, else those beside
        the calibrations of one pair."""
        left, right = self._given.get("left"), self._given.get("right")
        if left and right:
            return [(left, right)]
        types = {name: t.type for name, t in self._topics.items() if t.type in _PICTURES}
        lefts = [name for name in sorted(types) if not _NO_PICTURE.search(name.lower())]
        pairs = [
            (name, partner)
            for name in lefts
            for partner in right_partners(name)
            if types.get(partner) == types[name]
        ]
        pairs = pairs or [
            (name, partner)
            for name in lefts
            if (info := self._partners.get(self._beside(name)))
            for partner in sorted(types)
            if info == self._beside(partner)
            and name.rpartition("/")[2] == partner.rpartition("/")[2]
        ]
        return [p for p in pairs if left in (None, p[0]) and right in (None, p[1])]

    def _beside(self, image: str) -> str:
        """The calibration below an image, else beside it."""
        below = f"{base_name(image)}/camera_info"
        return below if below in self._topics else f"{namespace(image)}/camera_info"

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
