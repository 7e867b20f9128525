"""Bags of ROS 1 and ROS 2 as recordings, without a ROS installed."""

from fieldgrid.recording.bag.opening import FORMAT

__all__ = ["FORMAT"]
