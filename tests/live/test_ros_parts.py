"""What the node of ROS 2 works out, and what is said where ROS is not installed."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldgrid.core import ConfigError, Float64
from fieldgrid.geometry import Lattice, LeverArm, Pose, Window
from fieldgrid.live import MapSoFar, RobotFrames, RosNode
from fieldgrid.recordings import Transforms, ros_messages

ARM = LeverArm(0.2, 0.5, 2.0)
POSE = Pose(10_000_000_000, 100.0, 50.0, 3.0, 30.0, 0.02, 0.3, 1.0)


def placed(time_ns: int, parent: str, child: str, at_m: list[float], yaw_deg: float = 0.0) -> Any:
    turn = ros_messages.turn_left(np.radians(yaw_deg))
    return ros_messages.transform(time_ns, parent, child, np.array(at_m), turn)


def matrix(one: Any) -> Float64:
    at, turn = one.transform.translation, one.transform.rotation
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    found[:3, 3] = at.x, at.y, at.z
    return found


def static(*transforms: Any) -> Transforms:
    found = Transforms()
    found.add(ros_messages.transforms(*transforms))
    return found


def test_without_rclpy_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(ConfigError, match=r"pip install 'fieldgrid\[ros\]'"):
        RosNode([])


def test_the_map_is_above_the_top_of_the_robots_tree() -> None:
    # The antenna is 0.7 m ahead of the axle, where the base is, and 0.5 m ahead of the origin.
    tree = static(
        placed(0, "base_footprint", "base_link", [0.0, 0.0, 0.4]),
        placed(0, "base_link", "gps", [0.7, -0.2, 1.6]),
    )
    robot = RobotFrames(tree, "gps", ARM)
    (told,) = robot.message(POSE).transforms
    assert (told.header.frame_id, told.child_frame_id) == ("map", "base_footprint")
    base = matrix(told)
    ahead = np.array([np.sin(np.radians(30.0)), np.cos(np.radians(30.0))])
    assert np.allclose(base[:2, 3], np.array([100.0, 50.0]) - 0.2 * ahead)
    assert base[2, 3] == pytest.approx(3.0)
    assert np.allclose(base[:2, 0], ahead)  # x is forward

    # Of odometry that drifts, that of the time of the pose counts.
    for second, at_m in ((9, [5.0, 1.0, 0.0]), (10, [6.0, 2.0, 0.0]), (11, [7.0, 3.0, 0.0])):
        moved = placed(second * 10**9, "odom", "base_footprint", at_m, 20.0)
        other = placed(second * 10**9, "map", "odom", [9.0, 9.0, 9.0])
        robot.moved(ros_messages.transforms(other, moved))
    (told,) = robot.message(POSE).transforms
    assert told.child_frame_id == "odom"
    in_odom = matrix(placed(0, "odom", "base_footprint", [6.0, 2.0, 0.0], 20.0))
    assert np.allclose(matrix(told) @ in_odom, base)


def test_without_the_place_of_the_antenna_the_origin_is_base_link() -> None:
    (told,) = RobotFrames(static(), "gps", ARM).message(POSE).transforms
    assert told.child_frame_id == "base_link"
    assert np.allclose(matrix(told)[:3, 3], [100.0, 50.0, 3.0])


def test_the_map_so_far_keeps_what_windows_leave_behind() -> None:
    lattice, shown = Lattice(0.5), np.full((4, 4), -1, dtype=np.int8)
    so_far = MapSoFar(lattice, Window(0, 0, 4, 4), shown)
    truth: dict[tuple[int, int], int] = {}
    before = so_far.grid(0)
    random = np.random.default_rng(1)
    for step in range(40):
        window = Window(10 * step, -3 * (step % 5), 4, 4)  # where none was before
        for again in range(2):  # what a window shows may go again, while it is there
            cells = random.choice(np.array([-1, 0, 100], dtype=np.int8), (4, 4))
            whole, part = so_far.window, so_far.take(window, cells)
            after = so_far.grid(0)
            if so_far.window == whole and part is not None:
                update = so_far.update(part, 0)
                grid = np.array(before.data).reshape(before.info.height, -1)
                into = grid[update.y : update.y + update.height, update.x : update.x + update.width]
                into[:] = update.data.reshape(into.shape)
                assert np.array_equal(grid.reshape(-1), after.data)
            before = ros_messages.new("nav_msgs/OccupancyGrid", **_copied(after))
            if again:
                places = zip(*np.nonzero(cells >= 0), strict=True)
                truth |= {(window.j0 + r, window.i0 + c): int(cells[r, c]) for r, c in places}
    grid = np.array(before.data).reshape(before.info.height, -1)
    assert np.count_nonzero(grid >= 0) == len(truth)
    j0, i0 = so_far.window.j0, so_far.window.i0
    assert all(grid[j - j0, i - i0] == value for (j, i), value in truth.items())
    assert before.info.origin.position.x == lattice.cell_m * i0


def _copied(message: Any) -> dict[str, Any]:
    return {"header": message.header, "info": message.info, "data": message.data.copy()}


def test_what_a_window_still_shows_is_not_kept() -> None:
    """A frame that moves in the window leaves nothing behind."""
    lattice, nothing = Lattice(0.5), np.full((4, 4), -1, dtype=np.int8)
    so_far, cells = MapSoFar(lattice, Window(0, 0, 4, 4), nothing), nothing.copy()
    cells[:, 0], cells[:, 3] = 0, 100
    so_far.take(Window(0, 0, 4, 4), cells)
    so_far.take(Window(1, 0, 4, 4), nothing)
    grid = so_far.grid(0)
    known = np.array(grid.data)[np.array(grid.data) >= 0]
    assert known.tolist() == [0, 0, 0, 0]
