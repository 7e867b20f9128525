"""What tests of exports share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.export.killing import KilledAt, small_process
from tests.export.real_rosbag import check_by_rosbag, rosbag_is_there


@pytest.fixture(scope="session")
def killed_at() -> Iterator[KilledAt]:
    """Writes sets of files and is killed at it."""
    with small_process() as killed:
        yield killed


@pytest.fixture(autouse=True)
def bags_are_read_by_ros(request: pytest.FixtureRequest) -> Iterator[None]:
    """The library of ROS 1 reads each bag of it that a test leaves in its folder."""
    yield
    folder = request.node.funcargs.get("tmp_path")
    if folder is not None and rosbag_is_there():
        for path in folder.rglob("*.bag"):
            check_by_rosbag(path)
