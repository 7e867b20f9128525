"""Small bags of every kind, made by libraries other than ours."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer as Rosbag2Writer,
)
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from fieldgrid.recordings import Message
from fieldgrid.recordings.ros.bag import Bag, open_bag

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
START_NS = 1_717_243_200_000_000_000
STEP_NS = 50_000_000
DELAY_NS = 3_000_000  # from the stamp to the reception
FIX, IMAGE, TEXT = "/gps/fix", "/left/image_raw", "/notes"
TYPES = {
    FIX: "sensor_msgs/msg/NavSatFix",
    IMAGE: "sensor_msgs/msg/Image",
    TEXT: "std_msgs/msg/String",
}
ROS1_COMPRESSIONS = {
    "none": None,
    "bz2": Rosbag1Writer.CompressionFormat.BZ2,
    "lz4": Rosbag1Writer.CompressionFormat.LZ4,
}
MCAP_COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}


class Sample(NamedTuple):
    topic: str
    message: Any
    time_ns: int

    @property
    def stamp_ns(self) -> int:
        header = getattr(self.message, "header", None)
        return header.stamp.sec * 10**9 + header.stamp.nanosec if header else 0


class Plain(NamedTuple):
    """A message without what says how to decode it."""

    topic: str
    receive_ns: int
    data: bytes


def plain(message: Message) -> Plain:
    return Plain(message.topic, message.receive_ns, message.data)


def samples(store: Typestore, count: int = 60, side: int = 24) -> list[Sample]:
    """Fixes, noisy images of `side` x `side` pixels and, now and then, a text."""
    rng = np.random.default_rng(7)
    made = []
    for k in range(count):
        time_ns = START_NS + k * STEP_NS
        stamp_ns = time_ns - DELAY_NS
        if k % 10 == 9:
            made.append(Sample(TEXT, store.types[TYPES[TEXT]](data=f"note {k}"), time_ns))
        elif k % 2:
            made.append(Sample(FIX, _fix(store, stamp_ns, k), time_ns))
        else:
            made.append(Sample(IMAGE, _image(store, stamp_ns, rng, side), time_ns))
    return made


def _header(store: Typestore, stamp_ns: int) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](
        sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
    )
    extra = {"seq": 5} if store is ROS1 else {}
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="gps", **extra)


def _fix(store: Typestore, stamp_ns: int, k: int) -> Any:
    return store.types[TYPES[FIX]](
        header=_header(store, stamp_ns),
        status=store.types["sensor_msgs/msg/NavSatStatus"](status=2, service=1),
        latitude=39.5 + 1e-6 * k,
        longitude=-1.2,
        altitude=700.0,
        position_covariance=np.arange(9.0),
        position_covariance_type=2,
    )


def _image(store: Typestore, stamp_ns: int, rng: np.random.Generator, side: int) -> Any:
    return store.types[TYPES[IMAGE]](
        header=_header(store, stamp_ns),
        height=side,
        width=side,
        encoding="mono8",
        is_bigendian=0,
        step=side,
        data=rng.integers(0, 256, side * side, dtype=np.uint8),
    )


def serialised(sample: Sample, store: Typestore) -> bytes:
    name = sample.message.__msgtype__
    if store is ROS1:
        return bytes(store.serialize_ros1(sample.message, name))
    return bytes(store.serialize_cdr(sample.message, name))


def expected(made: list[Sample], store: Typestore) -> list[Plain]:
    return [Plain(one.topic, one.time_ns, serialised(one, store)) for one in made]


def write_rosbag1(
    path: Path, made: list[Sample], compression: str = "none", chunk_bytes: int = 4000
) -> None:
    writer = Rosbag1Writer(path)
    if ROS1_COMPRESSIONS[compression]:
        writer.set_compression(ROS1_COMPRESSIONS[compression])
    writer.chunk_threshold = chunk_bytes
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=ROS1)
            for topic, name in TYPES.items()
        }
        for one in made:
            writer.write(connections[one.topic], one.time_ns, serialised(one, ROS1))


def write_mcap(
    path: Path,
    made: list[Sample],
    compression: str = "zstd",
    chunk_bytes: int = 4000,
    store: Typestore = ROS2,
    **options: bool,
) -> None:
    ros1 = store is ROS1
    with path.open("wb") as file:
        writer = McapLibraryWriter(
            file,
            chunk_size=chunk_bytes,
            compression=MCAP_COMPRESSIONS[compression],
            **options,
        )
        writer.start(profile="ros1" if ros1 else "ros2", library="test")
        channels = {}
        for topic, name in TYPES.items():
            text, _ = store.generate_msgdef(name, ros_version=1 if ros1 else 2)
            schema = writer.register_schema(
                name.replace("/msg/", "/") if ros1 else name,
                "ros1msg" if ros1 else "ros2msg",
                text.encode(),
            )
            channels[topic] = writer.register_channel(topic, "ros1" if ros1 else "cdr", schema)
        for one in made:
            writer.add_message(
                channels[one.topic], one.time_ns, serialised(one, store), one.time_ns
            )
        writer.finish()


def write(path: Path, compression: str = "none", count: int = 60) -> list[Plain]:
    """A bag of samples, of the kind that its name says; what is to be read of it."""
    store = ROS1 if path.suffix == ".bag" else ROS2
    made = samples(store, count)
    if path.suffix == ".bag":
        write_rosbag1(path, made, compression)
    elif path.suffix == ".mcap":
        write_mcap(path, made, compression)
    else:
        write_old_db3(path, made).close()
    return expected(made, store)


def write_folder(
    path: Path,
    made: list[Sample],
    storage: Literal["sqlite3", "mcap"] = "sqlite3",
    mode: Literal["none", "file", "message", "storage"] = "none",
) -> None:
    plugin = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
    writer = Rosbag2Writer(path, version=9, storage_plugin=plugin)
    if mode != "none":
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=ROS2)
            for topic, name in TYPES.items()
        }
        for one in made:
            writer.write(connections[one.topic], one.time_ns, serialised(one, ROS2))


def write_old_db3(path: Path, made: list[Sample], journal: str = "delete") -> sqlite3.Connection:
    """A database of ROS 2 Foxy, which has no definitions; it is left open."""
    database = sqlite3.connect(path, isolation_level=None)
    database.execute(f"PRAGMA journal_mode = {journal}")
    database.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    )
    numbers = {topic: number for number, topic in enumerate(TYPES, start=1)}
    for topic, number in numbers.items():
        database.execute(
            "INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, topic, TYPES[topic])
        )
    add_rows(database, made)
    return database


def add_rows(database: sqlite3.Connection, made: list[Sample]) -> None:
    numbers = {topic: number for number, topic in enumerate(TYPES, start=1)}
    database.execute("BEGIN")
    for one in made:
        database.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            (numbers[one.topic], one.time_ns, serialised(one, ROS2)),
        )
    database.execute("COMMIT")


def read(path: Path) -> tuple[list[Plain], str]:
    """All messages of a bag, and its damage."""
    with open_bag(path) as bag:
        return list(messages_of(bag)), bag.damage


def messages_of(bag: Bag) -> list[Plain]:
    """The messages of a bag, which are as many as its topics count."""
    found = [plain(message) for message in bag.messages()]
    for name, topic in bag.topics.items():
        assert topic.count == sum(message.topic == name for message in found)
    return found
