"""Tests over real DDS, on this machine alone: `make ros` runs them, with Python 3.12 and the wheels
of ROS 2; elsewhere they are skipped."""

from __future__ import annotations

import os

# Before rclpy is imported: no other machine hears it, and no other run on this one.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
