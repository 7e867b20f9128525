"""Messages of an MCAP as they come through a pipe: a source of frames, fixes and motion.

Messages are decoded by what reads bags. Nothing is known of a stream beforehand, so a topic is
taken for a role by its type and its name as soon as it is announced, or because it was said to be.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import ConfigError, RecordingError, quoted, shortened
from fieldgrid.geometry import Fix
from fieldgrid.live.intake import Intake
from fieldgrid.live.pose.sensor_rows import Rows, rows_of
from fieldgrid.live.sources.imu_stream import ImuStream
from fieldgrid.live.sources.links import open_link, parse_address
from fieldgrid.live.sources.mcap_link import LinkBytes
from fieldgrid.live.sources.moments import Waiting, together
from fieldgrid.live.sources.orientation_stream import ATTITUDE, RECORDED, OrientationStream
from fieldgrid.live.sources.receiver import ReceiverStream
from fieldgrid.recordings import (
    AXES,
    DATUM,
    ODOMETRY,
    TF,
    TF_STATIC,
    TYPES_OF_ROLES,
    UNNAMED,
    BagFrames,
    CloudFrame,
    CloudKind,
    Connection,
    Frame,
    FrameKind,
    Message,
    MessageCloud,
    Numbers,
    PairKind,
    StereoFrame,
    Taken,
    Transforms,
    as_utc,
    connection_of,
    decode,
    image_source,
    is_optical,
    is_utc,
    named,
    optical,
    pose_numbers,
    short,
    stamp_ns,
)

MOST_RECORD_BYTES = 1 << 28
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CLOUD, _TEXT = "sensor_msgs/msg/PointCloud2", "std_msgs/msg/String"
_BY_TYPE = {
    "sensor_msgs/msg/NavSatFix": "fix",
    "nmea_msgs/msg/Sentence": "nmea",
    "sensor_msgs/msg/Imu": "imu",
    ODOMETRY: "odometry",
}
_POSES = (
    ODOMETRY,
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
ROLES = ("left", "right", "cloud", ATTITUDE, *_BY_TYPE.values())
FIXES = ("fix", "nmea")
POSE = "pose"
"""The role of a topic that has poses of another program."""


class PoseTopic(NamedTuple):
    """The topic of a stream that has poses of another program, and what is added to their times."""

    name: str
    offset_ns: int = 0


class StreamChannel(NamedTuple):
    """A topic and what it is for: an Odometry may be wheels and a pose, an Imu an attitude, too."""

    connection: Connection
    roles: tuple[str, ...]


class McapStream:
    """An MCAP out of standard input (`-`), a FIFO or tcp://HOST:PORT, with the pairs of a camera
    whose calibration is known, or the clouds of a lidar: `kind` says of what they are.

    `topics` are those of roles (`ROLES`) that are not to be told by type and name, `imu_axes` how
    an IMU sits. Without `takes_fixes` they are left to a receiver. `poses` is the topic of those of
    another program, `epoch_ns` the UTC at which a clock began that counts from its own start, that
    of a simulation. ConfigError for another address or role.
    """

    def __init__(
        self,
        address: str,
        kind: FrameKind | BagFrames,
        topics: Mapping[str, str] | None = None,
        *,
        imu_axes: str = AXES,
        takes_fixes: bool = True,
        poses: PoseTopic | None = None,
        epoch_ns: int | None = None,
    ) -> None:
        self._address = parse_address(address)
        if self._address.kind not in ("stdin", "fifo", "tcp"):
            raise ConfigError(
                f"{quoted(address)} is no MCAP; give -, a FIFO's path or tcp://HOST:PORT."
            )
        if not isinstance(kind, PairKind | CloudKind | BagFrames):
            raise ConfigError(
                "Of an MCAP pairs and clouds are read while driving; give the rig of a stereo "
                "camera or a lidar."
            )
        self._given = dict(topics or {})
        for role in self._given:
            if role not in ROLES:
                raise ConfigError(
                    f"No topic of a stream is {quoted(role)}; give one of {', '.join(ROLES)}."
                )
        self._transforms = Transforms()
        self._kind, self._imu = kind, ImuStream(imu_axes, self._transforms)
        is_given = ATTITUDE in self._given
        self._leans = OrientationStream(imu_axes, self._imu, self._transforms, is_given=is_given)
        self._takes_fixes, self._poses, self._epoch_ns = takes_fixes, poses, epoch_ns
        self._roles: dict[str, str] = {}
        self._told: set[str] = set()
        self._nmea = ReceiverStream()
        count = len(kind.plan.topics) if isinstance(kind, BagFrames) else 2
        self._parts: list[Waiting] = [
            deque() for _ in range(1 if isinstance(kind, CloudKind) else count)
        ]
        self._is_behind = False
        self._frames = 0
        self._turns: dict[str, tuple[str, tuple[float, ...]]] = {}
        self._fixes_of = ""

    @property
    def name(self) -> str:
        """Where it comes from."""
        return f"The MCAP of {self._address.text}"

    def run(self, intake: Intake) -> None:
        """Give what comes; see `Source`."""
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader

        with closing(open_link(self._address)) as link:
            stream = LinkBytes(link, intake)
            try:
                while not intake.stop.is_set():  # a FIFO may carry one after the other
                    reader = StreamReader(
                        stream,  # type: ignore[arg-type]
                        record_size_limit=MOST_RECORD_BYTES,
                    )
                    self._read(reader.records, intake)
            except (McapError, ValueError, RuntimeError) as error:
                raise RecordingError(f"what comes is no MCAP: {shortened(repr(error))}") from error

    def finish(self, intake: Intake) -> None:
        """Give the fixes that are still open, and what was held of an IMU."""
        self._push_motion(self._imu.finish(), intake)
        self._push_motion(self._leans.finish(), intake)
        for fix in self._nmea.finish():
            intake.push_fix(fix)

    def _read(self, records: Any, intake: Intake) -> None:
        from mcap.records import Channel, Message as Record, Schema

        schemas = {0: UNNAMED}
        channels: dict[int, StreamChannel] = {}
        for record in records:
            if isinstance(record, Schema):
                schemas[record.id] = named(record)
            elif isinstance(record, Channel) and record.id not in channels:
                connection = connection_of(record, schemas.get(record.schema_id, UNNAMED))
                roles = tuple(self._roles_of(connection, intake))
                channels[record.id] = StreamChannel(connection, roles)
            elif isinstance(record, Record) and record.channel_id in channels:
                channel = channels[record.channel_id]
                message = Message(channel.connection, record.log_time, record.data)
                self.take(channel, message, intake)

    def take(self, channel: StreamChannel, message: Message, intake: Intake) -> None:
        """Give what a message says."""
        if channel.connection.type in TF and message.topic.endswith(TF_STATIC):
            self._static(message, intake)
        for role in channel.roles:
            self._take(role, message, intake)
        if channel.connection.type == _TEXT and message.topic in RECORDED:
            # Roll and pitch of a converted drive; the texts have their own times.
            with suppress(RecordingError):
                told = self._leans.recorded(message.topic, decode(message).data)
                self._push_motion(told, intake)

    def _roles_of(self, connection: Connection, intake: Intake) -> Iterator[str]:
        """All that the messages of a topic are for."""
        role, topic = self._role(connection, intake), connection.topic
        if role and (self._takes_fixes or role not in FIXES):
            yield role
        named = {POSE: self._poses and self._poses.name, ATTITUDE: self._given.get(ATTITUDE)}
        for other, name in named.items():
            if name == topic and self._can_be(other, connection, intake):
                yield other

    def _role(self, connection: Connection, intake: Intake) -> str:
        """What the messages of a topic are for; empty for nothing."""
        topic = connection.topic
        for role, name in self._given.items():
            if name == topic and role != ATTITUDE:
                return role if self._can_be(role, connection, intake) else ""
        role = "" if topic == DATUM else _BY_TYPE.get(connection.type, "")
        if isinstance(self._kind, CloudKind):
            role = "cloud" if connection.type == _CLOUD else role
        elif connection.type in _IMAGES:
            role = next((side for side in ("left", "right") if side in topic.lower()), "")
        if not role or role in self._given:
            return ""
        if self._roles.setdefault(role, topic) != topic:
            self._say(
                intake,
                f"has {topic} beside {self._roles[role]}, which is taken as {role}; "
                f"--topic {role}=NAME takes another.",
            )
            return ""
        return role

    def _can_be(self, role: str, connection: Connection, intake: Intake) -> bool:
        """Whether a topic that was given for a role is of a type that it can have."""
        option = "--poses-topic" if role == POSE else f"--topic {role}=NAME"
        types = _POSES if role == POSE else TYPES_OF_ROLES[role]
        if connection.type not in types:
            self._say(
                intake,
                f"has {connection.topic} of the type {short(connection.type)}, not "
                f"{' or '.join(map(short, types))}, which is not used; give another with {option}.",
            )
        return connection.type in types

    def _take(self, role: str, message: Message, intake: Intake) -> None:
        takers: dict[str, Callable[[Message, int, Intake], None]] = {
            **{part: partial(self._part, part) for part in ("left", "right", "cloud")},
            "fix": self._fix,
            "nmea": self._sentence,
            "imu": self._turn,
            "odometry": self._speed,
            POSE: self._pose,
            ATTITUDE: self._attitude,
        }
        stamped_ns = stamp_ns(message.connection.encoding, message.data)
        times_ns = as_utc(np.array([stamped_ns, message.receive_ns]), self._epoch_ns)
        known = is_utc(times_ns)
        if not known.any():
            self._say(
                intake,
                f"has no UTC in the stamps of {message.topic} and of the recorder, so that what it "
                "says is left out; set the clock, or say with --epoch 2026-05-14T07:30:00Z when "
                "that of a simulation began.",
            )
            return
        time_ns = int(times_ns[0 if known[0] else 1])
        if not known[0]:
            self._say(
                intake,
                f"has no UTC in the stamps of {message.topic}; the recorder's times are taken.",
            )
        try:
            takers[role](message, time_ns, intake)
        except (ConfigError, RecordingError) as problem:
            self._say(intake, f"has messages on {message.topic} that are left out: {problem}")

    def _static(self, message: Message, intake: Intake) -> None:
        """Take the places of frames on the vehicle."""
        try:
            self._transforms.add(decode(message))
        except RecordingError as problem:
            self._say(intake, f"has messages on {message.topic} that are left out: {problem}")
            return
        self._imu.check_transforms()
        self._push_motion([], intake)
        for topic, (frame, turn) in self._turns.items():
            if self._turn_of(frame) != turn:
                self._say(
                    intake,
                    f"has a static transform of {frame} that came after the first cloud of "
                    f"{topic}, and is not used; record /tf_static from the start, or say axes in "
                    "recording.toml.",
                )

    def _part(self, role: str, message: Message, time_ns: int, intake: Intake) -> None:
        """Hold a message until the others of its frame come, and give the frame."""
        kind = self._kind
        part = int(role == "right")
        if isinstance(kind, BagFrames):
            part = kind.plan.topics.index(message.topic)
        elif isinstance(kind, CloudKind) != (role == "cloud"):
            raise ConfigError("the rig is of another sensor; give that of this one with --rig.")
        self._parts[part].append((message, time_ns))
        for taken in together(self._parts):
            intake.push_frame(self._frame(taken), wait=self._is_behind)
            self._frames += 1

    def _frame(self, taken: Sequence[Taken]) -> Frame:
        """The frame of the messages of one moment. The frame of a cloud tells by its name or place
        when its axes are a camera's."""
        kind, about = self._kind, (f"{self._frames:06d}", taken[0][1])
        if isinstance(kind, BagFrames):
            return kind.frame(self._frames, taken)
        if isinstance(kind, PairKind):
            left, right = (image_source(*one, kind.image_format.bits or 16) for one in taken)
            return StereoFrame(*about, left, right, kind.size_px, kind.rectifier)
        ((message, time_ns),) = taken
        if message.topic not in self._turns:
            name = str(decode(message).header.frame_id)
            self._turns[message.topic] = name, self._turn_of(name)
        turn = self._turns[message.topic][1]
        return CloudFrame(*about, MessageCloud(message, time_ns, turn, kind.corrected))

    def _turn_of(self, frame: str) -> tuple[float, ...]:
        """What turns points of a frame into right, down, forward, by what is known of it now."""
        axes = self._kind.axes if isinstance(self._kind, CloudKind) else AXES
        is_said = axes != CloudKind().axes and not is_optical(frame)
        R = optical(frame, self._transforms, axes if is_said else None)
        return tuple(R.ravel().tolist())

    def _fix(self, message: Message, time_ns: int, intake: Intake) -> None:
        one = Numbers(message.topic, message.connection.type)
        one.take(message, 0)
        self._push(list(one.fixes(np.array([time_ns]))), "fix", intake)

    def _sentence(self, message: Message, time_ns: int, intake: Intake) -> None:
        text = decode(message).sentence.encode("utf-8", "replace").strip()
        self._push(self._nmea.feed(text + b"\r\n"), "nmea", intake)

    def _push(self, fixes: list[Fix], role: str, intake: Intake) -> None:
        """Take fixes of the kind that gave the first one: both tell the same positions."""
        self._fixes_of = self._fixes_of or (role if fixes else "")
        for fix in fixes if role == self._fixes_of else ():
            intake.push_fix(fix)

    def _turn(self, message: Message, time_ns: int, intake: Intake) -> None:
        said = decode(message)
        self._push_motion(self._imu.take(said, time_ns), intake)
        self._push_motion(self._leans.take("imu", said, time_ns, str(said.header.frame_id)), intake)

    def _push_motion(self, made: list[tuple[str, Rows]], intake: Intake) -> None:
        for part, rows in made:
            intake.live.push_rows(part, rows)
        for note in (*self._imu.notes, *self._leans.notes):
            self._say(intake, note)

    def _speed(self, message: Message, time_ns: int, intake: Intake) -> None:
        said = decode(message)
        speed_mps = float(said.twist.twist.linear.x)
        if np.isfinite(speed_mps):
            intake.live.push_rows("wheels", rows_of("wheels", time_ns, speed_mps))
        self._push_motion(self._leans.take("odometry", said, time_ns, said.child_frame_id), intake)

    def _attitude(self, message: Message, time_ns: int, intake: Intake) -> None:
        imu, kind = self._given.get("imu", self._roles.get("imu")), message.connection.type
        said, is_of_imu = decode(message), imu == message.topic
        self._push_motion(self._leans.take_given(said, time_ns, kind, is_of_imu=is_of_imu), intake)

    def _pose(self, message: Message, time_ns: int, intake: Intake) -> None:
        said = pose_numbers(decode(message))
        assert self._poses is not None
        intake.live.push_pose(time_ns + self._poses.offset_ns, said[:3], said[3:7], said[7:])

    def _say(self, intake: Intake, text: str) -> None:
        """Tell something, each thing once."""
        if text not in self._told and len(self._told) < 100:
            self._told.add(text)
            intake.tell(text)
