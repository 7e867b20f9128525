"""`fieldgrid live --ros` and `serve-ros` over real DDS, beside a node that plays a bag."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

pytest.importorskip("tf2_msgs.msg", reason="ROS 2 is not installed")

from mcap.reader import make_reader
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Bounds
from fieldgrid.maps import CostCurve, Mark, MarkKind, Selection, open_map
from fieldgrid.pipeline import build_map, convert_recording
from tests.conftest import make_small_drive
from tests.export.asymmetric import write_asymmetric_map
from tests.live.making import cut_log
from tests.pipeline.drives.making import content
from tests.ros.player import OtherNode, type_of

# Of what rclpy imports.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

ODOM_AT = np.array([3.0, -2.0, 0.5])
ODOM_TURN = Rotation.from_euler("z", 30.0, degrees=True)
RATE = 0.4
"""Slow, so that nothing is dropped, and poses come in time, on a machine with other work."""

GRID, UPDATE = "nav_msgs/msg/OccupancyGrid", "map_msgs/msg/OccupancyGridUpdate"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six pairs of the example as a robot records them: without poses and texts of ours."""
    drive = make_small_drive(tmp_path_factory.mktemp("ros") / "drive", range(20, 26))
    cut_log(drive)
    convert_recording(drive, drive.parent / "all.mcap")
    out = drive.parent / "drive.mcap"
    with (drive.parent / "all.mcap").open("rb") as source, out.open("wb") as to:
        writer = Writer(to)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            topic = channel.topic
            if schema is None or topic in ("/tf", "/gnss/fix/details") or "pose" in topic:
                continue
            if topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                about = topic, channel.message_encoding, number, channel.metadata
                channels[topic] = writer.register_channel(*about)
            writer.add_message(channels[topic], message.log_time, message.data, message.log_time)
        writer.finish()
    return out


@contextmanager
def running(*arguments: str | Path) -> Iterator[subprocess.Popen[bytes]]:
    """A command, which is ended by Ctrl-C where it still runs."""
    order = [sys.executable, "-m", "fieldgrid", *map(str, arguments)]
    with subprocess.Popen(order) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)


def cells(message: Any) -> npt.NDArray[np.int8]:
    info = message.info
    return np.array(message.data, dtype=np.int8).reshape(info.height, info.width)


def matrix(at: Any, turn: Any) -> npt.NDArray[np.float64]:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    found[:3, 3] = at.x, at.y, at.z
    return found


def odometry_to(publisher: Any, time_ns: int) -> None:
    """A vehicle that its odometry takes to stand still."""
    message = type_of("tf2_msgs/msg/TFMessage")()
    one = type_of("geometry_msgs/msg/TransformStamped")()
    one.header.stamp.sec, one.header.stamp.nanosec = divmod(time_ns, 10**9)
    one.header.frame_id, one.child_frame_id = "odom", "base_footprint"
    (one.transform.translation.x, one.transform.translation.y, one.transform.translation.z) = (
        ODOM_AT.tolist()
    )
    turn = one.transform.rotation
    turn.x, turn.y, turn.z, turn.w = ODOM_TURN.as_quat().tolist()
    message.transforms.append(one)
    publisher.publish(message)


def occupancy_of(path: Path, **asked: Any) -> tuple[npt.NDArray[np.int8], Any]:
    """What a map comes to as an occupancy grid, and where it lies."""
    with open_map(path) as universal:
        selection = Selection(**asked)
        view = selection.view(universal, decide=selection.layer)
    return CostCurve().occupancy(*view.decision()), view.bounds


def test_a_bag_that_is_played_becomes_the_map_of_a_build(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "row.gpkg"
    build_map([bag], tmp_path / "built.gpkg", BuildSettings())
    with OtherNode() as other, running("live", "-o", out, "--ros", "--name", "drive") as process:
        for topic, type_ in {"/map": GRID, "/costmap": GRID, "/path": "nav_msgs/msg/Path"}.items():
            other.hear(topic, type_, latched=True)
        other.hear("/map_updates", UPDATE)
        other.hear("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
        other.hear("/tf", "tf2_msgs/msg/TFMessage")
        other.hear("/datum/point", "geographic_msgs/msg/GeoPoint", latched=True)
        other.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        tree = other.publisher("/tf", "tf2_msgs/msg/TFMessage")
        other.play(bag, RATE, lambda time_ns: odometry_to(tree, time_ns))
        so_far = composed(other)
        answer = other.call("/save")
        assert answer.success, answer.message
        other.wait(lambda: cells(other.heard["/map"][-1]).shape != so_far.shape)
    assert process.returncode == 0
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for kind in theirs:
        if kind != "fieldgrid_session":  # which says where its data come from
            assert ours[kind] == theirs[kind], kind
    whole, bounds = occupancy_of(out)
    last = other.heard["/map"][-1]
    assert np.array_equal(cells(last), whole)
    assert (last.header.frame_id, last.info.resolution) == ("map", pytest.approx(0.05))
    corner = last.info.origin.position
    assert (corner.x, corner.y) == (bounds.west_m, bounds.south_m)
    known = np.count_nonzero(whole >= 0)
    assert known / 2 < np.count_nonzero(so_far >= 0) <= 1.1 * known
    check_what_was_told(other)


def composed(other: OtherNode) -> npt.NDArray[np.int8]:
    """The map so far as RViz and Nav2's static layer have it: the grid, then its updates."""
    found = np.zeros((0, 0), dtype=np.int8)
    for topic, one in list(other.order):
        if topic == "/map":
            found = cells(one).copy()
        elif topic == "/map_updates":
            part = np.array(one.data, dtype=np.int8).reshape(one.height, one.width)
            found[one.y : one.y + one.height, one.x : one.x + one.width] = part
    return found


def check_what_was_told(other: OtherNode) -> None:
    poses = list(other.heard["/pose"])
    assert poses
    trees = [message.transforms for message in other.heard["/tf"]]
    ours = [one for (one,) in trees if one.header.frame_id == "map"]
    assert {one.child_frame_id for one in ours} == {"odom"}
    for one, told in zip(ours, poses, strict=True):
        assert one.header.stamp == told.header.stamp
        pose = told.pose.pose
        placed = matrix(one.transform.translation, one.transform.rotation)
        at = np.eye(4)
        at[:3, :3], at[:3, 3] = ODOM_TURN.as_matrix(), ODOM_AT
        assert np.allclose(placed @ at, matrix(pose.position, pose.orientation), atol=1e-6)
    path = other.heard["/path"][-1].poses
    assert len(path) > 2
    assert {message.status[0].name for message in other.heard["/diagnostics"]} == {"fieldgrid"}
    window = max(other.heard["/costmap"], key=lambda one: np.count_nonzero(cells(one) >= 0))
    assert set(np.unique(cells(window))) >= {-1, 0, 100}
    corner, last = window.info.origin.position, path[-1].pose.position
    side_m = window.info.width * window.info.resolution
    assert corner.x < last.x < corner.x + side_m
    assert corner.y < last.y < corner.y + side_m
    datum = other.heard["/datum/point"][-1]
    assert 30.0 < datum.latitude < 60.0


def test_a_map_is_served_with_its_keepouts(tmp_path: Path) -> None:
    path = write_asymmetric_map(tmp_path / "f.gpkg")
    corners = ((7.0, -5.0), (9.0, -5.0), (9.0, -3.0), (7.0, -3.0))
    shed = Mark(MarkKind.KEEPOUT, corners, "shed")
    with open_map(path, writable=True) as universal:
        universal.add_marks([shed])
    whole, bounds = occupancy_of(path, bounds=Bounds(-5.0, -6.0, 10.0, 8.0), cell_m=0.25)
    order = ("serve-ros", path, "--cell", "0.25", "--bounds", "-5", "-6", "10", "8")
    order += ("--slow-percent", "40", "--slow-within", "0.5")
    with OtherNode() as other, running(*order) as process:
        info = "nav2_msgs/msg/CostmapFilterInfo"
        other.hear("/keepout_costmap_filter_info", info, latched=True)
        other.wait(lambda: other.heard["/keepout_costmap_filter_info"])
        # Everything was published before; who comes later gets it.
        (told,) = other.heard["/keepout_costmap_filter_info"]
        assert (told.type, told.base, told.multiplier) == (0, 0.0, 1.0)
        for topic in ("/map", told.filter_mask_topic):
            other.hear(topic, GRID, latched=True)
        other.hear("/datum/point", "geographic_msgs/msg/GeoPoint", latched=True)
        other.hear("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        for kind, type_ in (("costmap_filter_info", info), ("filter_mask", GRID)):
            other.hear(f"/speed_{kind}", type_, latched=True)
        other.wait(lambda: len([one for one in other.heard.values() if one]) == 7)
        check_speeds(other)
        check_paths(other)
        (grid,), (mask,) = other.heard["/map"], other.heard[told.filter_mask_topic]
        check_marks(other, path)
        process.send_signal(signal.SIGINT)
    assert process.returncode == 0
    assert np.array_equal(cells(grid), whole)
    assert mask.info == grid.info
    corner = mask.info.origin.position
    assert (corner.x, corner.y) == (bounds.west_m, bounds.south_m)
    rows, columns = np.nonzero(cells(mask))
    assert set(np.unique(cells(mask))) == {0, 100}
    centres = corner.x + 0.25 * (columns + 0.5), corner.y + 0.25 * (rows + 0.5)
    assert (min(centres[0]), max(centres[0])) == pytest.approx((7.125, 8.875))
    assert (min(centres[1]), max(centres[1])) == pytest.approx((-4.875, -3.125))
    (placed,) = other.heard["/tf_static"][0].transforms
    assert (placed.header.frame_id, placed.child_frame_id) == ("earth", "map")


def value_at(mask: Any, x: float, y: float) -> int | None:
    """What a mask says of a place: `worldToMap` of nav2_util, and `getMaskData` of Nav2's filters
    (nav2_costmap_2d, CostmapFilter)."""
    info, corner = mask.info, mask.info.origin.position
    if x < corner.x or y < corner.y:
        return None
    i, j = int((x - corner.x) / info.resolution), int((y - corner.y) / info.resolution)
    return mask.data[j * info.width + i] if i < info.width and j < info.height else None


def keepout_cost(mask: Any, x: float, y: float) -> int:
    """The cost of a place by Nav2's keepout filter (`CostmapFilter::getMaskCost`), 255 where it
    changes nothing."""
    value = value_at(mask, x, y)
    return 255 if value is None or value == -1 else round(value * 254 / 100)


def speed_limit(told: Any, mask: Any, x: float, y: float) -> float:
    """The limit at a place by Nav2's speed filter (`SpeedFilter::getSpeedLimitAtPose`), percent; 0
    for none. It refuses what it cannot use."""
    assert told.type == 1
    value = value_at(mask, x, y)
    assert value is not None
    assert value != -1, "unknown is invalid for this filter"
    if value == 0:
        return 0.0
    limit = value * told.multiplier + told.base
    assert 0.0 <= limit <= 100.0
    return float(limit)


def check_speeds(other: OtherNode) -> None:
    """The stem of the F is at -3 m east, and nothing stands west of it."""
    (told,), (mask,) = (
        other.heard[f"/speed_{kind}"] for kind in ("costmap_filter_info", "filter_mask")
    )
    assert told.filter_mask_topic == "/speed_filter_mask"
    assert (mask.header.frame_id, mask.info) == ("map", other.heard["/map"][0].info)
    keepouts = other.heard["/keepout_filter_mask"][0]
    assert keepout_cost(keepouts, 8.0, -4.0) == 254
    assert keepout_cost(keepouts, -4.0, 0.0) == 0
    assert speed_limit(told, mask, 8.0, -4.0) == pytest.approx(40.0)
    assert speed_limit(told, mask, -3.0, 0.0) == pytest.approx(40.0)
    assert speed_limit(told, mask, -4.2, 0.0) == 0.0

    assert {speed_limit(told, mask, *at) for at in places_of(mask)} == {0.0, 40.0}


def places_of(mask: Any) -> Iterator[tuple[float, float]]:
    """The middles of its cells."""
    info, corner = mask.info, mask.info.origin.position
    for j, i in np.ndindex(info.height, info.width):
        yield corner.x + info.resolution * (i + 0.5), corner.y + info.resolution * (j + 0.5)


def check_marks(other: OtherNode, path: Path) -> None:
    """Three clicks, as of RViz's tool, are a keep-out of the map; two are none."""
    clicks = other.publisher("/clicked_point", "geometry_msgs/msg/PointStamped")
    other.wait(clicks.get_subscription_count)
    other.hear("/clicked_polygon", "geometry_msgs/msg/PolygonStamped", latched=True)
    shown = other.heard["/clicked_polygon"]

    def click(*corners: tuple[float, float], frame: str = "map") -> None:
        for corner in corners:
            point = type_of("geometry_msgs/msg/PointStamped")()
            point.header.frame_id = frame
            point.point.x, point.point.y = corner
            clicks.publish(point)
        if frame == "map":
            other.wait(lambda: shown and len(shown[-1].polygon.points) == len(corners))

    masks, topic = other.heard["/keepout_filter_mask"], "/mark_keepout"
    assert not other.call(topic).success
    click((0.0, 0.0), (1.0, 1.0))
    click((2.0, 0.0), frame="odom")
    answer = other.call(topic)
    assert (answer.success, "2 corners" in answer.message) == (False, True)
    assert keepout_cost(masks[-1], 6.0, 6.0) == 0
    click((5.0, 5.0), (7.0, 5.0), (7.0, 7.0), (5.0, 7.0))
    answer = other.call(topic)
    assert answer.success, answer.message
    other.wait(lambda: keepout_cost(masks[-1], 6.0, 6.0) == 254)
    with open_map(path) as universal:
        marks = universal.marks()
    assert [mark.kind for mark in marks] == [MarkKind.KEEPOUT] * 2
    assert marks[-1].corners == ((5.0, 5.0), (7.0, 5.0), (7.0, 7.0), (5.0, 7.0))
    before = len(masks)
    assert other.call("/save").success
    other.wait(lambda: len(masks) > before)


def check_paths(other: OtherNode) -> None:
    """Beside the stem of the F, through it, out of the map, and of places that are none."""
    plans = other.publisher("/plan", "nav_msgs/msg/Path")
    for topic, type_ in {
        "/plan_clear": "std_msgs/msg/Bool",
        "/plan_clearance": "std_msgs/msg/Float32",
        "/plan_blocked_at": "geometry_msgs/msg/PointStamped",
    }.items():
        other.hear(topic, type_)
    other.wait(plans.get_subscription_count)

    def is_clear(*points: tuple[float, float], frame: str = "map") -> bool:
        before = len(other.heard["/plan_clear"])
        plan = type_of("nav_msgs/msg/Path")()
        plan.header.frame_id = frame
        for x, y in points:
            pose = type_of("geometry_msgs/msg/PoseStamped")()
            pose.pose.position.x, pose.pose.position.y = x, y
            plan.poses.append(pose)
        plans.publish(plan)
        other.wait(lambda: len(other.heard["/plan_clear"]) > before)
        return bool(other.heard["/plan_clear"][-1].data)

    assert is_clear((-4.0, -3.0), (-4.0, 4.0))
    assert not is_clear((-4.0, 0.0), (0.0, 0.0))
    other.wait(lambda: other.heard["/plan_blocked_at"] and len(other.heard["/plan_clearance"]) > 1)
    assert other.heard["/plan_blocked_at"][0].point.x == pytest.approx(-3.5, abs=0.25)
    assert other.heard["/plan_clearance"][0].data == pytest.approx(1.0, abs=0.25)
    assert other.heard["/plan_clearance"][1].data == 0.0
    for wrong in [(1000.0, 0.0)], [(float("nan"), 0.0)], [(0.0, 0.0), (1e300, 0.0)], []:
        assert not is_clear(*wrong)
    assert not is_clear((-4.0, -3.0), (-4.0, 4.0), frame="odom")
