"""Clocks of camera and receiver: their offset, and its changes within a drive."""
