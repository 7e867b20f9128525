"""Bags of ROS messages: no crash, and every message that is counted is there."""

from __future__ import annotations

import sqlite3
import struct
import tempfile
import zlib
from pathlib import Path

from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Rosbag1Writer

from fieldgrid.core import RecordingError
from fieldgrid.recordings import decode
from fieldgrid.recordings.ros.bag import open_bag
from fieldgrid.recordings.ros.definitions import types
from fuzz.target import Target, check_sentence, written

_TYPE = "std_msgs/msg/Header"
_DEFINITION = "builtin_interfaces/Time stamp\nstring frame_id\n"
_OWN = "std_msgs/Header header\nuint8[<=9] few\nfloat32[2] two\nstring[] many\n"
_DATA = b"\0\1\0\0\x05\0\0\0\x06\0\0\0\x04\0\0\0map\0"
_CHUNK_HEAD = struct.Struct("<BQQQQII")  # of an MCAP


def check_bag(data: bytes) -> None:
    try:
        bag = open_bag(written(data, "drive"))
    except RecordingError as error:
        check_sentence(str(error))
        return
    with bag:
        counts = dict.fromkeys(bag.topics, 0)
        for message in bag.messages():
            counts[message.topic] += 1
            assert bag.start_ns <= message.receive_ns <= bag.end_ns
            try:
                decode(message)
            except RecordingError as error:
                check_sentence(str(error))
        assert counts == {name: topic.count for name, topic in bag.topics.items()}
        for name, count in counts.items():
            assert [len(times) for times in bag.stamps(name)] == [count, count]
        assert bag.damage == "" or bag.damage.endswith(" used.")


def rosbag1_seeds() -> list[bytes]:
    return [_rosbag1(compression) for compression in (None, *Rosbag1Writer.CompressionFormat)]


def _rosbag1(compression: Rosbag1Writer.CompressionFormat | None) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "drive.bag")
        writer = Rosbag1Writer(path)
        writer.chunk_threshold = 100
        if compression:
            writer.set_compression(compression)
        with writer:
            connection = writer.add_connection(
                "/a", _TYPE, msgdef="uint32 seq\ntime stamp\nstring frame_id\n", md5sum="0"
            )
            for k in range(6):
                writer.write(connection, 10**18 + k, _DATA[:16] + bytes(4))
        # The head is filled up to 4 kB, of which nothing is read.
        blob = path.read_bytes()
    start = blob.index(b"#ROSBAG V2.0\n") + 13
    head = start + 4 + int.from_bytes(blob[start : start + 4], "little")
    filling = int.from_bytes(blob[head : head + 4], "little")
    return blob[:head] + bytes(4) + blob[head + 4 + filling :]


def mcap_seeds() -> list[bytes]:
    return [
        _mcap(CompressionType.NONE, _DEFINITION),
        _mcap(CompressionType.ZSTD, _DEFINITION),
        _mcap(CompressionType.LZ4, _OWN, name="a/msg/B"),
        _mcap(CompressionType.NONE, _DEFINITION, use_chunking=False),
    ]


def _mcap(
    compression: CompressionType,
    text: str,
    *,
    name: str = _TYPE,
    use_chunking: bool = True,
) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "drive.mcap")
        with path.open("wb") as file:
            writer = Writer(
                file, chunk_size=100, compression=compression, use_chunking=use_chunking
            )
            writer.start(profile="ros2")
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channel = writer.register_channel("/a", "cdr", schema)
            for k in range(6):
                writer.add_message(channel, 10**18 + k, _DATA, k)
            writer.finish()
        return path.read_bytes()


def mend_mcap(data: bytes) -> bytes:
    """The data with the right checksum in every chunk that is not compressed."""
    mended = bytearray(data)
    at = 8
    while at + _CHUNK_HEAD.size <= len(data):
        op, length, _, _, _, _, name_bytes = _CHUNK_HEAD.unpack_from(data, at)
        end = at + 9 + length
        if op == 6 and name_bytes == 0 and end <= len(data):
            crc = zlib.crc32(data[at + _CHUNK_HEAD.size + 8 : end])
            struct.pack_into("<I", mended, at + _CHUNK_HEAD.size - 8, crc)
        at = end
    return bytes(mended)


def db3_seeds() -> list[bytes]:
    return [_db3(with_definitions) for with_definitions in (False, True)]


def _db3(with_definitions: bool) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "drive.db3")
        database = sqlite3.connect(path)
        database.execute("PRAGMA page_size = 512")
        database.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT,"
            " serialization_format TEXT)"
        )
        database.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
            " data BLOB)"
        )
        database.execute("INSERT INTO topics VALUES (1, '/a', ?, 'cdr')", (_TYPE,))
        if with_definitions:
            database.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT,"
                " encoding TEXT, encoded_message_definition TEXT)"
            )
            database.execute(
                "INSERT INTO message_definitions VALUES (1, ?, 'ros2msg', ?)", (_TYPE, _DEFINITION)
            )
        for k in range(40):
            row = (10**18 + k, _DATA + bytes(k % 4))
            database.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", row
            )
        database.commit()
        database.close()
        return path.read_bytes()


def check_message(data: bytes) -> None:
    """The bytes as a definition and, after a zero byte, a message of that type."""
    text, _, message = data.partition(b"\0")
    record = b"\0\1\0\0" + message
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "drive.mcap")
        with path.open("wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start(profile="ros2")
            schema = writer.register_schema("a/msg/B", "ros2msg", text)
            channel = writer.register_channel("/a", "cdr", schema)
            writer.add_message(channel, 1, record, 1)
            writer.finish()
        check_bag(path.read_bytes())


def message_seeds() -> list[bytes]:
    store = types()
    header = store.generate_msgdef("nav_msgs/msg/Odometry", ros_version=2)[0]
    return [
        _OWN.encode() + b"\0" + _DATA[4:] + b"\x02\0\0\0ab" + bytes(40),
        header.encode() + b"\0" + _DATA[4:] + bytes(720),
    ]


TARGETS = [
    Target("rosbag1", check_bag, rosbag1_seeds),
    Target("mcap", check_bag, mcap_seeds, mend_mcap),
    Target("db3", check_bag, db3_seeds),
    Target("ros-message", check_message, message_seeds),
]
