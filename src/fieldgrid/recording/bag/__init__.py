"""Bags of ROS 1 and ROS 2 as recordings, without a ROS installed."""

from __future__ import annotations

from fieldgrid.recording.bag.recording import (
    LOOKS_FOR,
    BagRecording,
    open_drive,
    open_recorded,
    recognises,
)

__all__ = ["LOOKS_FOR", "BagRecording", "open_drive", "open_recorded", "recognises"]
