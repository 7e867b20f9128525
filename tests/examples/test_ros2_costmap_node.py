"""The node that asks a map about paths, through a stand-in of rclpy."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.examples.rclpy_stand_in import Node, instead_of_ros, message_class
from tests.export.asymmetric import F_BOXES, write_asymmetric_map

RADIUS_M = 0.4


@pytest.fixture
def node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    path = write_asymmetric_map(tmp_path / "f.gpkg")
    values = {"map": str(path), "robot_radius_m": RADIUS_M, "cell_m": 0.05}
    monkeypatch.setattr(Node, "parameters", values)
    with instead_of_ros(lambda node: None):
        file = ROOT / "examples" / "ros2_costmap_node.py"
        spec = importlib.util.spec_from_file_location("ros2_costmap_node", file)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        module.main()  # ends at once, as spinning does
        yield module.PathCheck()


def plan(*points: tuple[float, float], frame: str = "map") -> Any:
    message = message_class("nav_msgs/msg/Path")()
    message.header.frame_id = frame
    for east_m, north_m in points:
        pose = message_class("geometry_msgs/msg/PoseStamped")()
        pose.pose.position.x, pose.pose.position.y = east_m, north_m
        message.poses.append(pose)
    return message


def answer(node: Any, message: Any) -> tuple[bool, float | None, tuple[float, float] | None]:
    """Whether a path is clear, its clearance, and where it is blocked."""
    sent = {topic: publisher.sent for topic, publisher in node.published.items()}
    before = {topic: len(messages) for topic, messages in sent.items()}
    kind, take = node.heard["plan"]
    assert isinstance(message, kind)
    take(message)
    new = {topic: messages[before[topic] :] for topic, messages in sent.items()}
    (clear,) = new["plan_clear"]
    clearance = [one.data for one in new["plan_clearance"]]
    places = [(one.point.x, one.point.y) for one in new["plan_blocked_at"]]
    return clear.data, *((found[0] if found else None) for found in (clearance, places))


def test_paths_beside_and_through_an_obstacle(node: Any) -> None:
    stem = F_BOXES[0]
    middle_m = (stem.south_m + stem.north_m) / 2
    beside_m = stem.west_m - 1.0
    south, north = (beside_m, stem.south_m), (beside_m, stem.north_m)
    clear, clearance_m, place = answer(node, plan(south, north))
    assert (clear, place) == (True, None)
    assert clearance_m == pytest.approx(1.0, abs=0.08)

    # Only the ends are given: what lies between them counts.
    through = plan((beside_m, middle_m), (stem.east_m + 1.0, middle_m))
    clear, clearance_m, place = answer(node, through)
    assert (clear, clearance_m) == (False, 0.0)
    assert place == pytest.approx((stem.west_m - RADIUS_M, middle_m), abs=0.08)
    assert any("too near an obstacle" in text for _, text in node.logger.said)

    too_near_m = stem.west_m - RADIUS_M + 0.1
    assert not answer(node, plan((too_near_m, stem.south_m), (too_near_m, stem.north_m)))[0]


def test_what_the_map_does_not_know_is_not_clear(node: Any) -> None:
    clear, clearance_m, place = answer(node, plan((1000.0, 0.0), (1010.0, 0.0)))
    assert (clear, clearance_m, place) == (False, None, (1000.0, 0.0))
    assert any("never seen" in text for _, text in node.logger.said)
    assert answer(node, plan())[0] is False
    assert answer(node, plan((0.0, 0.0), frame="odom"))[0] is False
    assert "'odom'" in node.logger.said[-1][1]


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "points",
    [
        [(NAN, 0.0)],
        [(0.0, 0.0), (NAN, 1.0)],
        [(INF, 0.0), (INF, 1.0)],
        [(0.0, -INF)],
        [(0.0, 0.0), (1e9, 1e9)],
        [(-1e308, 0.0), (1e308, 0.0)],
    ],
)
def test_a_path_that_cannot_be_is_not_clear(node: Any, points: list[tuple[float, float]]) -> None:
    assert answer(node, plan(*points)) == (False, None, None)
    level, text = node.logger.said[-1]
    assert level == "warning"
    assert "not finite" in text


@pytest.mark.parametrize("far_m", [1e9, -1e9, 1e19, 1e300])
def test_a_short_path_far_away_is_not_clear(node: Any, far_m: float) -> None:
    clear, clearance_m, place = answer(node, plan((far_m, 0.0), (far_m, 0.0)))
    assert (clear, clearance_m, place) == (False, None, (far_m, 0.0))
