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
    # Asked for before the test, so that it is still there after it.
    asked = "tmp_path" in request.fixturenames and rosbag_is_there()
    folder = request.getfixturevalue("tmp_path") if asked else None
    yield
    if folder is not None:
        for path in folder.rglob("*.bag"):
            if path.read_bytes().startswith(b"#ROSBAG"):  # else another's file of that name
                check_by_rosbag(path)
