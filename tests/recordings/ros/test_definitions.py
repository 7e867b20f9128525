"""What messages mean, by the definition in the bag or by that of ROS 2 Humble."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer as McapLibraryWriter

from fieldgrid.core import RecordingError
from fieldgrid.recordings import Connection, Message, decode
from fieldgrid.recordings.ros.bag import open_bag
from fieldgrid.recordings.ros.definitions import has_header, types
from tests.recordings.bags import Maker
from tests.recordings.ros.samples import FIX, ROS1, ROS2, TYPES, samples, write_old_db3

SEPARATOR = "=" * 80 + "\n"
NAV_SAT_FIX = types().generate_msgdef(TYPES[FIX], ros_version=2)[0]
DEPTH = "std_msgs/Header header\nmy_msgs/Part part\n" + SEPARATOR + "MSG: my_msgs/Part\nfloat64 m\n"


def bag_of(path: Path, *channels: tuple[str, str, str, bytes]) -> Path:
    """An MCAP of one message a channel: type, encoding of the schema, schema, message."""
    with path.open("wb") as file:
        writer = McapLibraryWriter(file)
        writer.start()
        for name, encoding, text, data in channels:
            schema = writer.register_schema(name, encoding, text.encode())
            writer.add_message(writer.register_channel("/a", "cdr", schema), 5, data, 5)
        writer.finish()
    return path


def cdr_of_depth(metres: float) -> bytes:
    store = types()
    stamp = store.types["builtin_interfaces/msg/Time"](sec=3, nanosec=4)
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="abc")
    # A pose stamped begins alike: a header and then doubles.
    point = store.types["geometry_msgs/msg/Point"](x=metres, y=0.0, z=0.0)
    message = store.types["geometry_msgs/msg/PointStamped"](header=header, point=point)
    return bytes(store.serialize_cdr(message, "geometry_msgs/msg/PointStamped"))[:-16]


def test_own_types(tmp_path: Path) -> None:
    """The definition leaves out std_msgs/msg/Header, which everybody knows."""
    data = cdr_of_depth(2.5)
    path = bag_of(tmp_path / "a.mcap", ("my_msgs/msg/Depth", "ros2msg", DEPTH, data))
    with open_bag(path) as bag:
        (message,) = bag.messages()
        decoded = decode(message)
        assert (decoded.header.frame_id, decoded.part.m) == ("abc", 2.5)
        assert bag.stamps("/a")[0].tolist() == [3_000_000_004]
    with open_bag(bag_of(path, ("my_msgs/msg/Depth", "ros2idl", "module a {};", data))) as bag:
        (message,) = bag.messages()
        with pytest.raises(RecordingError, match="has no definition that can be used"):
            decode(message)


def test_each_of_two_definitions_of_a_type_is_used(tmp_path: Path) -> None:
    path = bag_of(
        tmp_path / "a.mcap",
        ("a/msg/B", "ros2msg", "uint8 old\n", b"\0\1\0\0\x07"),
        ("a/msg/B", "ros2msg", "uint64 new\n", b"\0\1\0\0" + (9).to_bytes(8, "little")),
    )
    with open_bag(path) as bag:
        assert bag.topics["/a"].count == 2
        first_message, second_message = bag.messages()
        first, second = decode(first_message), decode(second_message)
        assert (first.old, second.new) == (7, 9)
        with pytest.raises(RecordingError, match=r"\(2 bytes\) does not fit its type 'a/msg/B'"):
            decode(first_message._replace(data=b"ab"))


@pytest.mark.parametrize(
    ("text", "missing"),
    [
        ("uint8 latitude\n", "NavSatFix without a header"),
        (NAV_SAT_FIX.replace(" header", " HEADER"), "NavSatFix without a header"),
        (NAV_SAT_FIX.replace("float64 latitude", "string latitude"), "without a latitude"),
    ],
)
def test_a_type_of_ros_with_other_fields_is_refused(
    text: str, missing: str, tmp_path: Path
) -> None:
    path = bag_of(tmp_path / "a.mcap", (TYPES[FIX], "ros2msg", text, b"\0\1\0\0" + bytes(200)))
    with open_bag(path) as bag, pytest.raises(RecordingError, match=missing):
        decode(next(bag.messages()))


def test_matrices_of_ros_1_are_named_as_in_ros_2(tmp_path: Path) -> None:
    name = "sensor_msgs/msg/CameraInfo"
    text, _ = ROS1.generate_msgdef(name, ros_version=1)
    maker = Maker("bag")
    info = maker.info(5, (16, 16), [[20.0, 0, 8, -4], [0, 20, 8, 0], [0, 0, 1, 0]])
    data = bytes(maker.store.serialize_ros1(info, name))
    for definition in (text, None):
        connection = Connection("/a", name, "ros1", definition)
        decoded = decode(Message(connection, 5, data))
        assert decoded.k.tolist() == [20.0, 0, 8, 0, 20, 8, 0, 0, 1]
        assert (len(decoded.d), decoded.r.tolist()[0], decoded.p.tolist()[3]) == (5, 1.0, -4.0)


def test_a_type_that_nobody_defines(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    database = write_old_db3(path, samples(ROS2))
    database.execute("UPDATE topics SET type = 'my_msgs/msg/Own' WHERE id = 1")
    database.close()
    with open_bag(path) as bag:
        with pytest.raises(RecordingError, match=r"my_msgs/msg/Own' of /gps/fix has no definition"):
            decode(next(bag.messages([FIX])))
        assert bag.stamps(FIX)[0].tolist() == [0] * bag.topics[FIX].count


def test_every_cut_of_a_message_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    write_old_db3(path, samples(ROS2)).close()
    with open_bag(path) as bag:
        fix = next(bag.messages([FIX]))
        assert decode(fix).status.status == 2
        for length in range(len(fix.data) - 3):
            with pytest.raises(RecordingError, match="does not fit its type"):
                decode(fix._replace(data=fix.data[:length]))


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_every_standard_type_with_a_header_is_known(encoding: str) -> None:
    store: Any = ROS1 if encoding == "ros1" else types()
    version = 1 if encoding == "ros1" else 2
    checked = 0
    for name, (_, fields) in store.fielddefs.items():
        if "/msg/" not in name or not name.startswith(("sensor_msgs", "nav_msgs", "nmea_msgs")):
            continue
        text, _ = store.generate_msgdef(name, ros_version=version)
        connection = Connection("/a", name, encoding, text)
        wanted = fields[0][1][1] == "std_msgs/msg/Header"
        assert has_header(connection) == wanted, name
        assert has_header(connection._replace(encoding="json")) is False
        checked += wanted
    assert checked > 20
