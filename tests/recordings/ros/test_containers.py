"""Bags as other libraries write them are read as those libraries read them."""

from __future__ import annotations

import pickle
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.writer import Writer as McapLibraryWriter
from rosbags.highlevel import AnyReader
from rosbags.typesys.store import Typestore

from fieldgrid.core import RecordingError
from fieldgrid.recordings import Message, decode
from fieldgrid.recordings.ros.bag import Take, is_bag, open_bag
from fieldgrid.recordings.ros.model import Topic
from tests.recordings.ros.samples import (
    DELAY_NS,
    FIX,
    IMAGE,
    MCAP_COMPRESSIONS,
    ROS1,
    ROS1_COMPRESSIONS,
    ROS2,
    START_NS,
    STEP_NS,
    TEXT,
    TYPES,
    Plain,
    expected,
    messages_of,
    plain,
    read,
    samples,
    write_folder,
    write_mcap,
    write_old_db3,
    write_rosbag1,
)


def by_time(messages: list[Plain]) -> list[Plain]:
    return sorted(messages, key=lambda message: (message.receive_ns, message.topic))


def rosbags_messages(path: Path) -> list[Plain]:
    with AnyReader([path], default_typestore=ROS2) as reader:
        return [Plain(c.topic, time_ns, bytes(data)) for c, time_ns, data in reader.messages()]


def check_whole(path: Path, store: object = ROS2) -> None:
    """The bag of `samples(store)` is read message by message, with its stamps."""
    made = samples(store)
    with open_bag(path) as bag:
        assert bag.damage == ""
        assert messages_of(bag) == expected(made, store)
        assert bag.topics == {
            topic: Topic(topic, name, sum(one.topic == topic for one in made))
            for topic, name in TYPES.items()
        }
        assert bag.start_ns == START_NS
        assert bag.end_ns == START_NS + 59 * STEP_NS
        for topic in TYPES:
            stamped, received = bag.stamps(topic)
            assert stamped.dtype == received.dtype == np.int64
            assert stamped.tolist() == [one.stamp_ns for one in made if one.topic == topic]
            assert received.tolist() == [one.time_ns for one in made if one.topic == topic]
        for message, one in zip(bag.messages(), made, strict=True):
            decoded = decode(message)
            assert type(decoded).__name__ == type(one.message).__name__
            if one.topic == FIX:
                assert decoded.latitude == one.message.latitude
                assert decoded.header.stamp.nanosec == one.message.header.stamp.nanosec
            elif one.topic == IMAGE:
                assert np.array_equal(decoded.data, one.message.data)
            else:
                assert decoded.data == one.message.data


@pytest.mark.parametrize("compression", ROS1_COMPRESSIONS)
def test_ros1_bag(compression: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    write_rosbag1(path, samples(ROS1), compression)
    assert is_bag(path)
    check_whole(path, ROS1)
    assert read(path)[0] == rosbags_messages(path)


@pytest.mark.parametrize("use_chunking", [True, False])
@pytest.mark.parametrize("compression", MCAP_COMPRESSIONS)
def test_mcap(compression: str, use_chunking: bool, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    write_mcap(path, samples(ROS2), compression, use_chunking=use_chunking)
    assert is_bag(path)
    check_whole(path)
    assert read(path)[0] == rosbags_messages(path)


def test_mcap_without_summary_and_checksums(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    bare = dict.fromkeys(
        ("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False
    )
    write_mcap(path, samples(ROS2), **bare, enable_crcs=False)
    check_whole(path)


def test_mcap_of_ros1_messages(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    write_mcap(path, samples(ROS1), store=ROS1)
    check_whole(path, ROS1)


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        ("sqlite3", "none"),
        ("sqlite3", "message"),
        ("sqlite3", "file"),
        ("mcap", "none"),
        ("mcap", "message"),
        ("mcap", "file"),
        ("mcap", "storage"),
    ],
)
def test_ros2_folder(storage: str, mode: str, tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    write_folder(folder, samples(ROS2), storage, mode)
    assert is_bag(folder)
    check_whole(folder)
    assert read(folder)[0] == rosbags_messages(folder)
    (folder / "metadata.yaml").unlink()
    assert is_bag(folder)
    check_whole(folder)
    (file,) = folder.iterdir()
    assert is_bag(file)
    check_whole(file)


def test_old_db3_without_definitions(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    write_old_db3(path, samples(ROS2)).close()
    check_whole(path)


def test_content_counts_where_the_name_says_nothing(tmp_path: Path) -> None:
    made = samples(ROS2)
    write_mcap(tmp_path / "a", made)
    write_rosbag1(tmp_path / "b", samples(ROS1))
    for name in "ab":
        assert is_bag(tmp_path / name)
        assert len(read(tmp_path / name)[0]) == 60


def test_what_is_no_bag(tmp_path: Path) -> None:
    database = tmp_path / "map.gpkg"
    with sqlite3.connect(database) as connection:
        connection.execute("CREATE TABLE topics (id INTEGER)")
    connection.close()
    text = tmp_path / "notes.txt"
    text.write_text("#ROS")
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("camera: left\n")
    for path in (database, text, folder, tmp_path / "missing", Path("/dev/null")):
        assert not is_bag(path), path
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    assert is_bag(folder)
    with pytest.raises(RecordingError, match=r"holds no \.db3, \.mcap or \.bag file"):
        open_bag(folder)
    with pytest.raises(RecordingError, match="no ROS 2 bag: it has no tables"):
        open_bag(database)
    with pytest.raises(RecordingError, match="does not begin like any bag"):
        open_bag(text)
    with pytest.raises(RecordingError, match="is not there"):
        open_bag(tmp_path / "missing")
    assert not is_bag(tmp_path / ("x" * 300))
    with pytest.raises(RecordingError, match=r"cannot be read \(File name too long\)"):
        open_bag(tmp_path / ("x" * 300))


@pytest.mark.parametrize("name", ["drive.bag", "drive.mcap", "drive.db3", "drive.db3.zstd"])
def test_an_empty_file_is_named_a_bag_and_is_none(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    assert is_bag(tmp_path / name)
    with pytest.raises(RecordingError, match=r"is empty: it is not a \.bag"):
        open_bag(tmp_path / name)


def test_a_whole_bag_without_messages(tmp_path: Path) -> None:
    write_mcap(tmp_path / "drive.mcap", [])
    with pytest.raises(RecordingError, match=r"holds no message that can be read; record again\."):
        open_bag(tmp_path / "drive.mcap")


def test_old_ros1_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.bag"
    path.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(RecordingError, match=r"convert an older \.bag with `rosbag fix`"):
        open_bag(path)


def test_encrypted_ros1_bag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "secret.bag"
    fields = [b"op=\x03", b"index_pos=" + bytes(8), b"encryptor=rosbag/AesCbcEncryptor"]
    header = b"".join(len(field).to_bytes(4, "little") + field for field in fields)
    path.write_bytes(b"#ROSBAG V2.0\n" + len(header).to_bytes(4, "little") + header + bytes(4))
    with pytest.raises(RecordingError, match="is encrypted"):
        open_bag(path)


@pytest.mark.parametrize("topics", [[FIX], [TEXT, IMAGE], [], ["/none"]])
def test_topics_are_chosen(topics: list[str], tmp_path: Path) -> None:
    for path, store in written_bags(tmp_path):
        with open_bag(path) as bag:
            assert [plain(message) for message in bag.messages(topics)] == [
                message for message in expected(samples(store), store) if message.topic in topics
            ]


def written_bags(folder: Path) -> Iterator[tuple[Path, Typestore]]:
    """The samples in every container, in one file and in several."""
    write_rosbag1(folder / "drive.bag", samples(ROS1), "lz4")
    yield folder / "drive.bag", ROS1
    for name, chunked in (("chunks", True), ("bare", False)):
        write_mcap(folder / f"{name}.mcap", samples(ROS2), use_chunking=chunked)
        yield folder / f"{name}.mcap", ROS2
    write_old_db3(folder / "drive.db3", samples(ROS2)).close()
    yield folder / "drive.db3", ROS2
    split_folder(folder / "split", [0, 1, 2])
    yield folder / "split", ROS2


def test_reading_starts_where_a_message_is(tmp_path: Path) -> None:
    for path, store in written_bags(tmp_path):
        with open_bag(path) as bag:
            wanted = [one for one in expected(samples(store), store) if one.topic == IMAGE]
            places = bag.places(IMAGE)
            assert np.all(np.diff(places) >= 0)
            for k in (0, 1, len(places) // 2, len(places) - 1):
                first = int(np.searchsorted(places, places[k]))  # of those that lie together
                found = [plain(m) for m in bag.messages([IMAGE], int(places[k]))]
                assert found == wanted[first:], path
                assert k - first < 8


def test_a_copy_in_another_process_reads_the_same(tmp_path: Path) -> None:
    for path, store in written_bags(tmp_path):
        with open_bag(path) as bag:
            copy = pickle.loads(pickle.dumps(bag))
            wanted = [one for one in expected(samples(store), store) if one.topic == FIX]
            messages = list(copy.messages([FIX]))
            copy.close()
            assert [plain(message) for message in messages] == wanted
            assert [plain(message) for message in bag.messages([FIX])] == wanted
            assert decode(pickle.loads(pickle.dumps(messages[0]))).longitude == -1.2


def test_what_listens_hears_the_messages_of_its_topics(tmp_path: Path) -> None:
    for path, store in written_bags(tmp_path):
        heard = Heard([], [])
        with open_bag(path, heard.listen):
            wanted = [one for one in expected(samples(store), store) if one.topic == FIX]
            assert heard.messages == [(one, k) for k, one in enumerate(wanted)]
            assert sorted(heard.asked) == sorted(TYPES.items())


class Heard(NamedTuple):
    messages: list[tuple[Plain, int]]
    asked: list[tuple[str, str]]

    def listen(self, name: str, type_: str) -> Take | None:
        self.asked.append((name, type_))
        return self.take if name == FIX else None

    def take(self, message: Message, place: int) -> None:
        self.messages.append((plain(message), place))


def test_a_topic_without_messages_is_listed(tmp_path: Path) -> None:
    made = [one for one in samples(ROS2) if one.topic != TEXT]
    write_mcap(tmp_path / "drive.mcap", made)
    with open_bag(tmp_path / "drive.mcap") as bag:
        assert bag.topics[TEXT] == Topic(TEXT, TYPES[TEXT], 0)
        assert bag.stamps(TEXT)[0].size == 0
        assert bag.damage == ""


def split_folder(folder: Path, order: list[int]) -> list[Plain]:
    """Files of 20 messages each, `order` in the description. Returns what is expected."""
    made = samples(ROS2)
    folder.mkdir()
    for k in range(3):
        write_mcap(folder / f"drive_{9 + k}.mcap", made[20 * k : 20 * k + 20])
    listed = "".join(f"    - bag/drive_{9 + k}.mcap\n" for k in order)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{listed}"
    )
    messages = expected(made, ROS2)
    return [message for k in order for message in messages[20 * k : 20 * k + 20]]


def test_files_follow_their_description(tmp_path: Path) -> None:
    wanted = split_folder(tmp_path / "bag", [2, 0, 1])
    assert read(tmp_path / "bag") == (wanted, "")


@pytest.mark.parametrize("content", [None, b"", b"a: [", b"\xff\xfe", b"[" * 5000, b"a: 1"])
def test_files_follow_their_numbers_without_description(
    content: bytes | None, tmp_path: Path
) -> None:
    wanted = split_folder(tmp_path / "bag", [0, 1, 2])
    description = tmp_path / "bag" / "metadata.yaml"
    description.unlink()
    if content is not None:
        description.write_bytes(content)
    assert read(tmp_path / "bag") == (wanted, "")


def test_the_files_of_a_split_ros1_bag_follow_their_numbers(tmp_path: Path) -> None:
    made, folder = samples(ROS1), tmp_path / "drive"
    folder.mkdir()
    for k, suffix in enumerate((".bag", ".bag", ".bag.active")):
        write_rosbag1(folder / f"drive_{9 + k}.bag", made[20 * k : 20 * k + 20])
        (folder / f"drive_{9 + k}.bag").rename(folder / f"drive_{9 + k}{suffix}")
    assert is_bag(folder)
    assert read(folder) == (expected(made, ROS1), "")
    with open_bag(folder) as bag:
        assert bag.files == ("drive_9.bag", "drive_10.bag", "drive_11.bag.active")
    # What a bag was converted from, or to, is not read twice.
    write_mcap(folder / "drive.mcap", samples(ROS2))
    with open_bag(folder) as bag:
        assert bag.files == ("drive.mcap",)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    wanted = split_folder(tmp_path / "bag", [0, 1, 2])
    (tmp_path / "bag" / "drive_10.mcap").unlink()
    messages, damage = read(tmp_path / "bag")
    assert messages == wanted[:20] + wanted[40:]
    assert damage == (
        "drive_10.mcap, named in metadata.yaml, is missing; 40 messages up to "
        "2024-06-01T12:00:02Z are used."
    )


def test_one_useless_file_of_several(tmp_path: Path) -> None:
    wanted = split_folder(tmp_path / "bag", [0, 1, 2])
    (tmp_path / "bag" / "drive_9.mcap").write_bytes(b"")
    messages, damage = read(tmp_path / "bag")
    assert messages == wanted[20:]
    assert damage.startswith("drive_9.mcap cannot be read; 40 messages")


def test_several_databases(tmp_path: Path) -> None:
    made = samples(ROS2)
    folder = tmp_path / "bag"
    folder.mkdir()
    for k in range(3):
        write_old_db3(folder / f"bag_{k}.db3", made[20 * k : 20 * k + 20]).close()
    assert read(folder) == (expected(made, ROS2), "")
    (folder / "bag_1.db3").write_bytes((folder / "bag_1.db3").read_bytes()[:100])
    messages, damage = read(folder)
    assert messages == expected(made[:20] + made[40:], ROS2)
    assert "bag_1.db3 cannot be read" in damage


def test_foreign_encodings_are_listed_and_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = McapLibraryWriter(file)
        writer.start()
        schema = writer.register_schema("foxglove.LocationFix", "protobuf", b"\x0a\x0b")
        channel = writer.register_channel("/fix", "protobuf", schema)
        writer.add_message(channel, 5, b"0123456789abcdef", 5)
        channel = writer.register_channel("/json", "json", 0)
        writer.add_message(channel, 6, b"{}", 6)
        writer.finish()
    with open_bag(path) as bag:
        assert bag.topics == {
            "/fix": Topic("/fix", "foxglove.LocationFix", 1),
            "/json": Topic("/json", "", 1),
        }
        assert bag.stamps("/fix")[0].tolist() == [0]
        first, _ = bag.messages()
        assert plain(first) == Plain("/fix", 5, b"0123456789abcdef")
        with pytest.raises(RecordingError, match="/fix are encoded as 'protobuf'"):
            decode(first)


def test_a_topic_of_two_types_is_that_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with path.open("wb") as file:
        writer = McapLibraryWriter(file)
        writer.start()
        for k, name in enumerate(("std_msgs/msg/String", "std_msgs/msg/Int32")):
            text, _ = ROS2.generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channel = writer.register_channel("/a", "cdr", schema)
            for j in range(3):
                writer.add_message(channel, 10 * k + j, b"\0\1\0\0" + bytes(4), 0)
        writer.finish()
    messages, damage = read(path)
    assert [message.receive_ns for message in messages] == [0, 1, 2]
    assert damage.startswith("3 messages of /a that are not of type std_msgs/msg/String are left")


def test_big_endian_stamps(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    one = samples(ROS2)[1]
    data = bytes(ROS2.serialize_cdr(one.message, TYPES[FIX], little_endian=False))
    with path.open("wb") as file:
        writer = McapLibraryWriter(file)
        writer.start()
        text, _ = ROS2.generate_msgdef(TYPES[FIX], ros_version=2)
        schema = writer.register_schema(TYPES[FIX], "ros2msg", text.encode())
        writer.add_message(writer.register_channel(FIX, "cdr", schema), one.time_ns, data, 0)
        writer.finish()
    with open_bag(path) as bag:
        assert bag.stamps(FIX)[0].tolist() == [one.time_ns - DELAY_NS]
        (message,) = bag.messages()
        assert decode(message).latitude == one.message.latitude


def test_real_ros1_bags(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    path = shared_data("husky_gps_rosbag") / "test1.bag"
    messages, damage = read(path)
    assert damage == ""
    assert messages == rosbags_messages(path)
    assert len(messages) == 16806
    with open_bag(path) as bag:
        stamped, received = bag.stamps("/fix")
        assert stamped.size == 989
        assert (received > stamped).all()
        fix = decode(next(bag.messages(["/fix"])))
        assert (fix.latitude, fix.longitude) == pytest.approx((42.376, -71.147), abs=1e-3)
    copy = tmp_path / "copy"
    shutil.copyfile(path, copy)
    assert is_bag(copy)
