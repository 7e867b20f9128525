"""Tests over real DDS on this machine alone. `.ci/run` runs them with Python 3.12 and the wheels of
ROS 2; elsewhere they are skipped."""

from __future__ import annotations

import os

import pytest

# Before rclpy is imported: no other machine hears it, and no other run on this one.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)

collect_ignore = []
try:
    import rclpy  # noqa: F401
    import tf2_msgs.msg  # noqa: F401
except ImportError:
    collect_ignore = ["player.py"]


@pytest.fixture(autouse=True)
def _needs_ros() -> None:
    pytest.importorskip("tf2_msgs.msg", reason="ROS 2 is not installed")
