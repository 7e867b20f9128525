"""Gyros that contradict the drive: scale, sense, a turned IMU, zeros."""
