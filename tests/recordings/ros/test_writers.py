"""Bags that are written, read by other libraries."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from fieldgrid.core import MapExistsError, MapWriteError
from fieldgrid.recordings import BagFolderWriter, McapWriter, decode
from fieldgrid.recordings.ros.bag import open_bag
from fieldgrid.recordings.ros.definitions import types
from tests.recordings.ros.samples import FIX, ROS2, TYPES, Sample, expected, read, samples


def own_samples() -> list[Sample]:
    """Samples, and messages of the types that Humble alone does not have."""
    store = types()
    made = samples(ROS2, 40)
    kinds = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=5, nanosec=6)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
    sentence = kinds["nmea_msgs/msg/Sentence"](header=header, sentence="$GPGGA,1*00")
    pose = kinds["geometry_msgs/msg/Pose"](
        position=kinds["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=0.0),
        orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    grid = kinds["grid_map_msgs/msg/GridMap"](
        header=header,
        info=kinds["grid_map_msgs/msg/GridMapInfo"](
            resolution=0.05, length_x=1.0, length_y=2.0, pose=pose
        ),
        layers=["density"],
        basic_layers=["density"],
        data=[
            kinds["std_msgs/msg/Float32MultiArray"](
                layout=layout, data=np.array([1.0, np.nan, 3.0], np.float32)
            )
        ],
        outer_start_index=0,
        inner_start_index=0,
    )
    last_ns = made[-1].time_ns
    return [*made, Sample("/nmea", sentence, last_ns + 1), Sample("/grid", grid, last_ns + 2)]


def write_all(kind: type[McapWriter | BagFolderWriter], path: Path, made: list[Sample]) -> None:
    with kind(path) as writer:
        for one in made:
            writer.write(*one)


def check_own_reading(path: Path) -> None:
    made = own_samples()
    assert read(path) == (expected(made, types()), "")
    with open_bag(path) as bag:
        assert bag.topics["/nmea"].type == "nmea_msgs/msg/Sentence"
        assert bag.topics["/grid"].type == "grid_map_msgs/msg/GridMap"
        assert bag.stamps("/grid")[0].tolist() == [5_000_000_006]
        (message,) = bag.messages(["/grid"])
        grid = decode(message)
        assert grid.info.pose.position.y == 2.0
        np.testing.assert_array_equal(grid.data[0].data, np.array([1, np.nan, 3], np.float32))


def test_mcap_is_read_by_the_library_of_mcap(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    made = own_samples()
    with McapWriter(path) as writer:
        for one in made:
            writer.write(*one)
        assert not path.exists()
    assert [file.name for file in tmp_path.iterdir()] == ["out.mcap"]
    check_own_reading(path)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(made)
        assert len(summary.schemas) == len(summary.channels) == 5
        found = list(reader.iter_decoded_messages())
    assert [(c.topic, m.log_time) for _, c, m, _ in found] == [(o.topic, o.time_ns) for o in made]
    for (_, channel, _, message), one in zip(found, made, strict=True):
        if channel.topic == FIX:
            assert message.latitude == one.message.latitude
            assert message.header.stamp.sec == one.message.header.stamp.sec
    assert found[-1][3].layers == ["density"]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_folder_is_read_by_rosbags(storage: str, tmp_path: Path) -> None:
    path = tmp_path / "out"
    made = own_samples()
    with BagFolderWriter(path, storage=storage) as writer:
        for one in made:
            writer.write(*one)
        assert not path.exists()
    suffix = {"sqlite3": "db3", "mcap": "mcap"}[storage]
    assert sorted(file.name for file in path.iterdir()) == ["metadata.yaml", f"out.{suffix}"]
    assert [file.name for file in tmp_path.iterdir()] == ["out"]
    check_own_reading(path)
    with AnyReader([path]) as reader:
        found = list(reader.messages())
        assert [(c.topic, t, bytes(data)) for c, t, data in found] == [
            tuple(message) for message in expected(made, types())
        ]
        fix = reader.deserialize(found[1][2], TYPES[FIX])
        assert fix.latitude == made[1].message.latitude


def test_raw_messages(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with McapWriter(path) as writer:
        writer.write_raw("/a", "foxglove.LocationFix", "protobuf", b"\x0a\x02", b"data", 7)
        writer.write_raw("/a", "foxglove.LocationFix", "protobuf", b"\x0a\x02", b"more", 8)
        text, _ = ROS2.generate_msgdef("std_msgs/msg/UInt8", ros_version=2)
        writer.write_raw("/b", "std_msgs/msg/UInt8", "ros2msg", text.encode(), b"\0\1\0\0\x05", 9)
    with path.open("rb") as file:
        reader = make_reader(file)
        found = [
            (schema.name, schema.encoding, schema.data, channel.message_encoding, message.data)
            for schema, channel, message in reader.iter_messages()
            if schema is not None
        ]
        assert len(reader.get_summary().channels) == 2
    raw = ("foxglove.LocationFix", "protobuf", b"\x0a\x02", "protobuf")
    assert found == [
        (*raw, b"data"),
        (*raw, b"more"),
        ("std_msgs/msg/UInt8", "ros2msg", text.encode(), "cdr", b"\0\1\0\0\x05"),
    ]
    with open_bag(path) as bag:
        assert decode(next(bag.messages(["/b"]))).data == 5


@pytest.mark.parametrize("kind", [McapWriter, BagFolderWriter])
def test_nothing_is_left_of_what_fails(
    kind: type[McapWriter | BagFolderWriter], tmp_path: Path
) -> None:
    path = tmp_path / "out.mcap"
    with pytest.raises(AttributeError):
        write_all(kind, path, [*samples(ROS2)[:5], Sample("/a", "no message", 5)])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", [McapWriter, BagFolderWriter])
def test_what_exists_is_replaced_only_when_asked(
    kind: type[McapWriter | BagFolderWriter], tmp_path: Path
) -> None:
    path = tmp_path / "out.mcap"
    made = samples(ROS2)
    with kind(path) as writer:
        writer.write(*made[0])
    with pytest.raises(MapExistsError, match="exists already"):
        kind(path)
    with pytest.raises(ZeroDivisionError), kind(path, overwrite=True) as writer:
        _ = 1 / 0
    assert len(read(path)[0]) == 1
    with kind(path, overwrite=True) as writer:
        for one in made[:3]:
            writer.write(*one)
    assert len(read(path)[0]) == 3
    assert [file.name for file in tmp_path.iterdir()] == ["out.mcap"]


@pytest.mark.parametrize("name", ["thesis.txt", "drive.bag"])
def test_a_folder_of_other_things_is_not_replaced(name: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    with pytest.raises(MapExistsError, match="other things than a bag that fieldgrid has"):
        BagFolderWriter(tmp_path / "out", overwrite=True)
    assert [file.name for file in tmp_path.rglob("*")] == ["out", name]


@pytest.mark.parametrize("kind", [McapWriter, BagFolderWriter])
def test_a_folder_that_is_not_there(
    kind: type[McapWriter | BagFolderWriter], tmp_path: Path
) -> None:
    with pytest.raises(MapWriteError, match="make it first"):
        kind(tmp_path / "missing" / "out.mcap")


@pytest.mark.parametrize("kind", [McapWriter, BagFolderWriter])
def test_a_disk_that_takes_no_more(
    kind: type[McapWriter | BagFolderWriter], tmp_path: Path
) -> None:
    path = tmp_path / "out.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    previous = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
    try:
        with pytest.raises(MapWriteError, match=r"could not be written.*check the space"):
            write_all(kind, path, samples(ROS2, 400, side=100))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, previous)
    assert list(tmp_path.iterdir()) == []
