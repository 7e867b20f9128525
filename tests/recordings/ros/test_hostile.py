"""Files made to do harm: absurd lengths, bombs, wild definitions. Memory stays bounded."""

from __future__ import annotations

import bz2
import os
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import Writer

from fieldgrid.core import LimitError, RecordingError
from fieldgrid.core.input_limits import Limits, limited
from fieldgrid.recordings import decode
from fieldgrid.recordings.ros.bag import open_bag
from fieldgrid.recordings.ros.source import inflate
from tests.recordings.ros.samples import (
    ROS1,
    ROS2,
    START_NS,
    Plain,
    expected,
    plain,
    read,
    samples,
    write_mcap,
    write_old_db3,
    write_rosbag1,
)

MB = 1 << 20
PACK: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}


@contextmanager
def at_most(limit_bytes: int) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit_bytes
    finally:
        tracemalloc.stop()


def fields(**values: bytes) -> bytes:
    body = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in values.items()
    )
    return struct.pack("<I", len(body)) + body


def rosbag1(*records: bytes) -> bytes:
    head = fields(op=b"\x03", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    return b"#ROSBAG V2.0\n" + head + bytes(4) + b"".join(records)


def chunk(data: bytes, compression: bytes = b"none", size: int | None = None) -> bytes:
    count = len(data) if size is None else size
    head = fields(op=b"\x05", compression=compression, size=struct.pack("<I", count))
    return head + struct.pack("<I", len(data)) + data


@pytest.mark.parametrize("length", [0xFFFFFFFF, 0x7FFFFFFF, 1 << 20])
def test_absurd_lengths_of_a_ros1_bag(length: int, tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    absurd = struct.pack("<I", length)
    head = fields(op=b"\x05", compression=b"none", size=absurd)
    for tail in (absurd, head + absurd, chunk(absurd), chunk(absurd, b"bz2", length)):
        path.write_bytes(rosbag1(tail + bytes(50)))
        with at_most(8 * MB), pytest.raises(RecordingError, match="holds no message"):
            open_bag(path)


@pytest.mark.parametrize("length", [(1 << 64) - 1, 1 << 62, 1 << 31])
def test_absurd_lengths_of_an_mcap(length: int, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    absurd = struct.pack("<Q", length)
    for op in range(16):
        path.write_bytes(b"\x89MCAP0\r\n" + bytes([op]) + absurd + bytes(100))
        with at_most(8 * MB), pytest.raises(RecordingError, match="holds no message"):
            open_bag(path)
    body = struct.pack("<QQQII", 0, 0, length, 0, 0) + absurd
    path.write_bytes(b"\x89MCAP0\r\n\x06" + struct.pack("<Q", len(body)) + body)
    with at_most(8 * MB), pytest.raises(RecordingError, match="holds no message"):
        open_bag(path)


@pytest.mark.parametrize("compression", PACK)
def test_bombs_grow_no_further_than_allowed(compression: str) -> None:
    bomb = PACK[compression](bytes(100 * MB))
    assert len(bomb) < MB
    with at_most(20 * MB):
        assert inflate(bomb, compression, 5 * MB) == bytes(5 * MB)


MESSAGE = fields(op=b"\x02", conn=bytes(4), time=bytes(8)) + bytes(4)
CONNECTION = fields(op=b"\x07", conn=bytes(4), topic=b"/a") + fields(
    type=b"std_msgs/Empty", md5sum=b"", message_definition=b""
)


@pytest.mark.parametrize("compression", ["lz4", "bz2"])
def test_a_file_unfolds_to_so_many_times_its_size_and_no_more(
    compression: str, tmp_path: Path
) -> None:
    path = tmp_path / "drive.bag"
    data = CONNECTION + MESSAGE[:-4] + struct.pack("<I", 3 * MB) + bytes(3 * MB)
    packed = chunk(PACK[compression](data), compression.encode(), len(data))
    path.write_bytes(rosbag1(*5 * [packed]))
    refused = pytest.raises(LimitError, match=r"unfolds to more than 10 MiB.*LIMIT_FACTOR=4 and")
    with limited(factor=1, free_mib=10), at_most(20 * MB), refused:
        open_bag(path)
    with limited(factor=1, free_mib=16), open_bag(path) as bag:
        assert bag.topics["/a"].count == 5
        with limited(free_mib=10), pytest.raises(LimitError):
            list(bag.messages())


def test_messages_and_files_that_are_packed_count_too(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    database = write_old_db3(path, samples(ROS2))
    bomb = zstandard.compress(bytes(3 * MB))
    database.execute("UPDATE messages SET data = ?", (bomb,))
    database.close()
    packed = tmp_path / "drive.mcap.zstd"
    packed.write_bytes(zstandard.compress(bytes(20 * MB)))
    with limited(factor=1, free_mib=10):
        for bag in (path, packed):
            with at_most(20 * MB), pytest.raises(LimitError, match="unfolds to more than 10 MiB"):
                open_bag(bag)


@pytest.mark.parametrize(
    "statement",
    [
        "ALTER TABLE messages ADD COLUMN rowid INTEGER",
        "ALTER TABLE messages ADD COLUMN more BLOB AS (zeroblob(1000000000))",
    ],
)
def test_columns_that_are_none_of_a_bag_are_refused(statement: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    database = write_old_db3(path, samples(ROS2))
    database.execute(statement)
    database.close()
    with pytest.raises(RecordingError, match="columns that are computed, or take the place"):
        open_bag(path)


def test_a_pipe_beside_a_database_is_let_be(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    write_old_db3(path, samples(ROS2)).close()
    for end in ("-wal", "-journal"):
        os.mkfifo(f"{path}{end}")
    with open_bag(path) as bag:
        assert bag.damage == ""


@pytest.mark.parametrize("compression", PACK)
def test_what_claims_to_be_large_takes_no_room(compression: str) -> None:
    data = PACK[compression](b"small")
    with at_most(12 * MB):
        assert inflate(data, compression, 1 << 30) == b"small"
        assert inflate(b"no such thing", compression, 1 << 30) == b""
        assert inflate(b"", compression, 1 << 30) == b""


def test_more_messages_than_a_file_can_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.recordings.ros.bag._MOST_MESSAGES", 10)
    path = tmp_path / "drive.bag"
    data = CONNECTION + 100_000 * MESSAGE
    path.write_bytes(rosbag1(chunk(bz2.compress(data), b"bz2", len(data))))
    with pytest.raises(RecordingError, match="more messages than a bag of its size can"):
        open_bag(path)


def test_a_million_connections_are_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    definition = fields(type=b"std_msgs/Empty", md5sum=b"", message_definition=b"")
    records = b"".join(
        fields(op=b"\x07", conn=struct.pack("<I", k), topic=b"/topic%d" % k) + definition
        for k in range(50_000)
    )
    path.write_bytes(rosbag1(chunk(records + MESSAGE)))
    with open_bag(path) as bag:
        assert 10_000 < len(bag.topics) < 42_000


def test_connections_that_each_chunk_repeats_count_once(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    definition = fields(type=b"std_msgs/Empty", md5sum=b"", message_definition=b"")
    often = fields(op=b"\x07", conn=b"\x01\0\0\0", topic=b"/" + 1000 * b"a") + definition
    path.write_bytes(rosbag1(chunk(5000 * often + CONNECTION + MESSAGE)))
    with open_bag(path) as bag:
        assert bag.topics["/a"].count == 1


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
def test_memory_does_not_grow_with_the_length(kind: str, tmp_path: Path) -> None:
    peaks = []
    for count in (40, 400):
        path = tmp_path / f"{count}.{kind}"
        store = ROS1 if kind == "bag" else ROS2
        made = samples(store, count, side=200)
        if kind == "bag":
            write_rosbag1(path, made, "lz4", chunk_bytes=100_000)
        elif kind == "mcap":
            write_mcap(path, made, "zstd", chunk_bytes=100_000)
        else:
            write_old_db3(path, made).close()
        assert path.stat().st_size > count * 15_000
        del made
        with open_bag(path) as bag:  # what is only made once is not counted
            bag.stamps("/gps/fix")
        tracemalloc.start()
        with open_bag(path) as bag:
            assert sum(1 for _ in bag.messages()) == count
            peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 100_000  # 400 messages of 40 kB


DEFINITIONS = {
    "endless": "a/Loop loop\n" + "=" * 80 + "\nMSG: a/Loop\na/Loop loop\n",
    "itself": "Wild again\n",
    "code": "uint8 a\nimport os\n",
    "no fields for a million": "Nothing[10000] a\n" + "=" * 80 + "\nMSG: a/Nothing\n",
    "nothing, often": "Nothing[] a\n" + "=" * 80 + "\nMSG: a/Nothing\nMore m\n"
    + "=" * 80 + "\nMSG: a/More\n",
    "unrolled": "string[1000000] a\n",
    "empty array": "string[0] a\n",
    "negative array": "uint8[-5] a\n",
    "unknown": "b/Unheard a\n",
    "garbage": "\x00\x01\x02",
    "keyword": "uint8 class\nuint8 import\n",
    "huge number": "uint8[" + "9" * 5000 + "] a\n",
    "dunder": "uint8 __class__\n",
    "deep": "".join(
        f"a/T{k} f\n" + "=" * 80 + f"\nMSG: a/T{k}\n" for k in range(300)
    ) + "uint8 f\n",
    "wide": "".join(
        f"a/T{k} f\na/T{k} g\n" + "=" * 80 + f"\nMSG: a/T{k}\n" for k in range(40)
    ) + "uint8 f\n",
}  # fmt: skip


@pytest.mark.parametrize("name", DEFINITIONS)
def test_wild_definitions_harm_no_other_topic(name: str, tmp_path: Path) -> None:
    check_definition(tmp_path / "drive.bag", DEFINITIONS[name], b"a/Wild")


@pytest.mark.parametrize(
    "type_name", [b"a/Wild\nimport os", b"a/1\"'", b"", b"Wild", b"a/b/c/d/e", b"../Wild", b"*"]
)
def test_wild_names_harm_no_other_topic(type_name: bytes, tmp_path: Path) -> None:
    check_definition(tmp_path / "drive.bag", "uint8 a\n", type_name)


def check_definition(path: Path, text: str, type_name: bytes) -> None:
    """A message of a wild type is refused or decoded; the other topic is decoded."""
    records = [
        fields(op=b"\x07", conn=bytes(4), topic=b"/wild")
        + fields(type=type_name, md5sum=b"", message_definition=text.encode()),
        fields(op=b"\x07", conn=b"\x01\0\0\0", topic=b"/good")
        + fields(type=b"std_msgs/UInt8", md5sum=b"", message_definition=b"uint8 data\n"),
    ]
    for conn in (b"\0", b"\x01"):
        for data in (b"", b"\x07", bytes(range(200))):
            records.append(
                fields(op=b"\x02", conn=conn + bytes(3), time=bytes(8))
                + struct.pack("<I", len(data))
                + data
            )
    path.write_bytes(rosbag1(chunk(b"".join(records))))
    with open_bag(path) as bag:
        assert [topic.count for topic in bag.topics.values()] == [3, 3]
        good = 0
        for message in bag.messages():
            try:
                decoded = decode(message)
            except RecordingError:
                assert message.topic == "/wild" or len(message.data) != 1
                continue
            if message.topic == "/good":
                assert decoded.data == 7
                good += 1
        assert good == 1


def test_times_beyond_all_measure(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/b", "cdr", 0)
        for time_ns in (1 << 63, (1 << 63) - 1, START_NS):
            writer.add_message(channel, time_ns, b"", 0)
        writer.finish()
    messages, damage = read(path)
    assert messages == [Plain("/b", (1 << 63) - 1, b""), Plain("/b", START_NS, b"")]
    assert damage.startswith("drive.mcap holds 1 unreadable message; 2 messages up to 2262-04-11")


def test_a_view_in_the_place_of_messages_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    database = write_old_db3(path, samples(ROS2))
    database.execute("ALTER TABLE messages RENAME TO kept")
    database.execute(
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)"
        " SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n"
    )
    database.close()
    with pytest.raises(RecordingError, match="it has no tables of topics and messages"):
        open_bag(path)


def test_a_bag_whose_file_changes_under_it(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    made = samples(ROS1)
    write_rosbag1(path, made)
    with open_bag(path) as bag:
        path.write_bytes(path.read_bytes()[:9000])
        messages = [plain(message) for message in bag.messages()]
        assert 0 < len(messages) < 60
        assert messages == expected(made, ROS1)[: len(messages)]


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_chunk_beyond_the_limit_is_passed_over(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"drive.{kind}"
    store = ROS1 if kind == "bag" else ROS2
    made = [*samples(store, 20), *samples(store, 5, side=300), *samples(store, 20)]
    if kind == "bag":
        write_rosbag1(path, made)
    else:
        write_mcap(path, made, "none")
    monkeypatch.setattr(Limits, "piece_bytes", 50_000)
    messages, damage = read(path)
    wanted = expected(made, store)
    assert messages[0] == wanted[0]
    assert messages[-1] == wanted[-1]
    assert all(message in wanted for message in messages)
    assert max(len(message.data) for message in messages) < 50_000
    assert f"drive.{kind} holds 3 damaged places" in damage


def test_a_message_beyond_the_limit_ends_the_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "drive.mcap"
    made = [*samples(ROS2, 20), *samples(ROS2, 1, side=300)]
    write_mcap(path, made, "none", use_chunking=False)
    monkeypatch.setattr(Limits, "piece_bytes", 50_000)
    messages, damage = read(path)
    assert messages == expected(made[:20], ROS2)
    assert "drive.mcap ends in the middle of a record" in damage


def test_messages_too_short_for_their_header_have_no_stamp(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    database = write_old_db3(path, samples(ROS2))
    database.execute("UPDATE messages SET data = substr(data, 1, id % 12)")
    database.close()
    with open_bag(path) as bag:
        assert set(bag.stamps("/gps/fix")[0].tolist()) == {0}
