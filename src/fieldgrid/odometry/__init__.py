"""Stereo visual odometry: how the vehicle moved from one pair of images to the next.

`features` does the heavy part, one frame at a time, and keeps no state, so that frames may be
prepared in worker threads; `step` is the light rest, for two frames in order. Both give the
same bits for the same images, in whatever thread they run.
"""

from __future__ import annotations

from fieldgrid.odometry.corners import Features, features
from fieldgrid.odometry.rigid import RigidMotion
from fieldgrid.odometry.steps import CameraStep, Refusal, camera_motion, step, steps_of

__all__ = [
    "CameraStep",
    "Features",
    "Refusal",
    "RigidMotion",
    "camera_motion",
    "features",
    "step",
    "steps_of",
]
