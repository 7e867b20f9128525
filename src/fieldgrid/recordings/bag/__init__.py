"""Bags of ROS 1 and ROS 2 as recordings, without a ROS installed."""
