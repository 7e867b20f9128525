"""Formats of robots: Nav2, ROS, Foxglove."""
