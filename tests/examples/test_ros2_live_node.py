"""The example's node, through messages that were recorded, and a stand-in of rclpy."""

from __future__ import annotations

import importlib.util
import math
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from fieldgrid.core import BuildSettings
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map, convert_recording
from fieldgrid.recordings import open_recording
from tests.conftest import ROOT, make_small_drive
from tests.examples.rclpy_stand_in import Node, instead_of_ros, message_class
from tests.live.making import cut_log

TIMEOUT_S = 60.0
TOPICS = {
    "/stereo/left/image_rect": "left/image_rect",
    "/stereo/right/image_rect": "right/image_rect",
    "/stereo/left/camera_info": "left/camera_info",
    "/stereo/right/camera_info": "right/camera_info",
    "/gnss/fix": "fix",
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_small_drive(tmp_path_factory.mktemp("ros2") / "drive", range(20, 24))
    cut_log(made)
    return made


@pytest.fixture(scope="module")
def bag(drive: Path) -> Path:
    out = drive.parent / "drive.mcap"
    convert_recording(drive, out, images="raw")
    return out


@pytest.fixture
def spun() -> list[Callable[[Any], None]]:
    """What happens while the node spins."""
    return []


@pytest.fixture
def example(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spun: list[Callable[[Any], None]]
) -> Iterator[Any]:
    """The file of the example, imported as the program that it is."""
    with open_recording(drive) as recording:
        rig = recording.rig
    antenna = rig.antenna
    parameters = {
        "map": str(tmp_path / "row.gpkg"),
        "height_m": rig.mount.height_m,
        "tilt_deg": rig.mount.tilt_deg,
        "roll_deg": rig.mount.roll_deg,
        "yaw_deg": rig.mount.yaw_deg,
        "antenna_m": [antenna.right_m, antenna.forward_m, antenna.up_m],
        "rear_axle_forward_m": rig.rear_axle_forward_m or math.nan,
    }
    monkeypatch.setattr(Node, "parameters", parameters)
    with instead_of_ros(lambda node: spun[0](node)):
        spec = importlib.util.spec_from_file_location(
            "ros2_live_node", ROOT / "examples" / "ros2_live_node.py"
        )
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module


def recorded(bag: Path) -> Iterator[tuple[str, Any]]:
    """The messages of a bag by the topics of the node, as rclpy would hand them over."""
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic in TOPICS]
        assert {c.topic for c in wanted} == set(TOPICS)
        for connection, _, data in reader.messages(wanted):
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, "encoding"):
                message.data = array("B", message.data.tobytes())
            yield TOPICS[connection.topic], message


def test_recorded_messages_make_costmaps_poses_and_the_map(
    example: Any, bag: Path, drive: Path, tmp_path: Path, spun: list[Callable[[Any], None]]
) -> None:
    nodes: list[Any] = []

    def spin(node: Any) -> None:
        nodes.append(node)
        images = 0
        for topic, message in recorded(bag):
            kind, take = node.heard[topic]
            assert message.__msgtype__ == kind.NAME
            take(message)
            if "image" in topic and node.live is not None:
                assert node.live.drain(TIMEOUT_S)  # faster than it was driven, and none is dropped
            images += "image" in topic
            if topic == "fix" and node.live is not None:  # its first window is one of doubt
                node.published["costmap"].wait(bool, TIMEOUT_S)
            if images == 8:  # after it fixes alone, by which no window is to be trusted
                images += 1
                node.published["costmap"].wait(
                    lambda sent: any((one.data == 100).any() for one in sent), TIMEOUT_S
                )
        raise KeyboardInterrupt

    spun.append(spin)
    example.main()
    (node,) = nodes
    assert ("info", f"the map is {tmp_path / 'row.gpkg'}") in node.logger.said
    assert not [text for level, text in node.logger.said if level == "error"]
    with open_map(tmp_path / "row.gpkg") as made:
        (session,) = made.sessions()
        assert (session.name, session.frames) == ("ros2", 4)
        assert made.verify(deep=True).sound
        datum = made.datum
        ours = [frame.pose for frame in made.frames()]
    build_map([drive], tmp_path / "built.gpkg", BuildSettings())
    with open_map(tmp_path / "built.gpkg") as built:
        theirs = [frame.pose for frame in built.frames()]
        # The recording says its datum, the node takes that of the first fix.
        for mine, one in zip(ours, theirs, strict=True):
            at = datum.to_enu(*built.datum.to_geodetic(one.east_m, one.north_m, one.up_m))
            assert math.dist(at[:2], (mine.east_m, mine.north_m)) < 0.05
            assert abs(mine.heading_deg - one.heading_deg) < 0.2

    (place,) = node.published["datum"].sent
    assert (place.latitude, place.longitude) == (datum.lat_deg, datum.lon_deg)
    poses, costmaps = node.published["pose"].sent, node.published["costmap"].sent
    doubts = [one.data for one in node.published["doubt"].sent]
    assert doubts[0]
    assert "" in doubts

    # The poses are along the way, of the vehicle's nose, and sure by their covariance.
    def apart_s(published: Any, pose: Any) -> float:
        return abs(stamp_s(published) - pose.time_ns / 1e9)

    published, near = min(
        ((one, pose) for one in poses for pose in ours), key=lambda both: apart_s(*both)
    )
    assert apart_s(published, near) < 0.1
    last = published.pose
    assert published.header.frame_id == "map"
    position = last.pose.position
    assert math.dist((position.x, position.y), (near.east_m, near.north_m)) < 0.3
    yaw_deg = math.degrees(2 * math.atan2(last.pose.orientation.z, last.pose.orientation.w))
    assert abs((90.0 - yaw_deg - near.heading_deg + 180.0) % 360.0 - 180.0) < 3.0
    assert 0.0 < last.covariance[0] < 1.0
    assert last.covariance[14] == 1e6
    # A costmap lies around the vehicle; what is not to be trusted is unknown.
    assert all((one.data == -1).all() for one in costmaps[:1])
    best = max(costmaps, key=lambda one: int((one.data >= 0).sum()))
    assert len(best.data) == best.info.width * best.info.height
    assert set(np.unique(best.data)) >= {-1, 0, 100}
    west, south = best.info.origin.position.x, best.info.origin.position.y
    side_m = best.info.width * best.info.resolution
    for pose in ours:
        assert west < pose.east_m < west + side_m
        assert south < pose.north_m < south + side_m


def stamp_s(message: Any) -> float:
    return float(message.header.stamp.sec + message.header.stamp.nanosec / 1e9)


def test_costs_are_those_of_nav2(example: Any) -> None:
    table = example.OCCUPANCY
    assert (table[0], table[1], table[252]) == (0, 1, 98)
    assert (table[253], table[254], table[255]) == (99, 100, -1)
    assert (np.diff(table[:255].astype(int)) >= 0).all()


def image_of(encoding: str, pixels: np.ndarray[Any, Any]) -> Any:
    step = pixels.strides[0] + 4  # rows may be longer than their pixels
    data = np.zeros((pixels.shape[0], step), dtype=np.uint8)
    data[:, :-4] = pixels.reshape(len(pixels), -1)
    message = message_class("sensor_msgs/msg/Image")()
    message.height, message.width, message.step = (*pixels.shape[:2], step)
    message.encoding, message.data = encoding, array("B", data.tobytes())
    return message


def test_images_of_any_usual_encoding(example: Any) -> None:
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    np.testing.assert_array_equal(example.grey(image_of("mono8", grey)), grey)
    red = np.zeros((6, 8, 3), dtype=np.uint8)
    red[..., 0] = 200
    assert (example.grey(image_of("rgb8", red)) == 60).all()
    assert (example.grey(image_of("bgr8", np.ascontiguousarray(red[..., ::-1]))) == 60).all()
    with pytest.raises(ValueError, match="encoded as mono16; this node takes mono8"):
        example.grey(image_of("mono16", grey))


def test_halves_of_pairs_that_never_come_are_given_up(example: Any, tmp_path: Path) -> None:
    node = example.LiveNode()
    for sec in range(20):
        one = image_of("mono8", np.zeros((6, 8), np.uint8))
        one.header.stamp.sec = sec
        node._take_image(one, "left")
    assert sorted(node._images["left"]) == [sec * 10**9 for sec in range(12, 20)]
    assert not list(tmp_path.iterdir())
