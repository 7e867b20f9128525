"""Frames in memory: those that are pushed, and one of bare ground to begin with."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldgrid.core import Float32, Float64, RecordingError
from fieldgrid.geometry import DepthCamera, Rig, StereoCamera
from fieldgrid.perception import LocalGridder, Sweep, step
from fieldgrid.pipeline import encoded, perceive_frame
from fieldgrid.recordings import CloudFrame, DepthFrame, Frame, StereoFrame

_WALL_M = 30.0


@dataclass(frozen=True, slots=True)
class PushedSource:
    """An image, depths or a cloud in memory, as a source of a frame."""

    name: str
    values: Any
    after_s: Float32 | None = None
    """Seconds after its stamp at which the points of a cloud were taken."""

    def read(self) -> Any:
        """The values."""
        return self.values

    def sweep(self) -> Sweep:
        """The values as points, and their times. RecordingError where these are of other points."""
        if self.after_s is not None and self.after_s.shape != (len(self.values),):
            raise RecordingError(
                f"There are times of the shape {self.after_s.shape} for {len(self.values)} points; "
                "give one for each."
            )
        return Sweep(self.values, self.after_s)

    def sha256(self) -> str:
        """The hash of the values, row by row."""
        return hashlib.sha256(np.ascontiguousarray(self.values).tobytes()).hexdigest()

    def encoded(self) -> bytes:
        """Nothing: it is no file."""
        return b""


class PushedImage(PushedSource):
    """A grey image in memory. Reading raises RecordingError for what is none."""

    __slots__ = ()

    def read(self) -> Any:
        """The values, uint8 [height, width]."""
        values = self.values
        if isinstance(values, np.ndarray) and values.dtype == np.uint8 and values.ndim == 2:
            return values
        what = type(values).__name__
        if isinstance(values, np.ndarray):
            what = f"{values.dtype} {list(values.shape)}"
        raise RecordingError(
            f"{self.name} is {what}; push a grey image of 8 bit, uint8 [height, width]."
        )


def warm_up(gridder: LocalGridder, *, odometry: bool) -> None:
    """Stage a frame of level ground with noise on it: what a frame goes through is compiled or
    loaded then, which takes seconds, and the first frames need not wait for it."""
    seen = perceive_frame(_of_level_ground(gridder.rig), gridder, odometry=odometry)
    encoded(seen, gridder.rig)
    if seen.features is not None:
        moved = seen.features._replace(measured_px=seen.features.measured_px + 1e-6)
        step(seen.features, moved, gridder.rig)


def _of_level_ground(rig: Rig) -> Frame:
    sensor, random = rig.sensor, np.random.default_rng(0)
    if not isinstance(sensor, StereoCamera | DepthCamera):
        right = np.tile(np.linspace(-0.5, 0.5, 60), 60)
        down = np.repeat(np.linspace(0.1, 1.0, 60), 60)
        depth_m = 1.0 / _nearness_1pm(rig, down)
        points_m = np.stack([right * depth_m, down * depth_m, depth_m], axis=1)
        return CloudFrame("ground", 0, PushedSource("cloud", points_m.astype(np.float32)))
    size_px = (sensor.width_px, sensor.height_px)
    shape = size_px[::-1]
    if isinstance(sensor, DepthCamera):
        down = (np.arange(float(sensor.height_px)) - sensor.cy_px) / sensor.fy_px
        depth_m = np.full(shape, 1.0 / _nearness_1pm(rig, down)[:, None], dtype=np.float32)
        return DepthFrame("ground", 0, PushedSource("depth", depth_m), size_px)
    down = (np.arange(float(sensor.height_px)) - sensor.cy_px) / sensor.focal_px
    disparity_px = sensor.focal_px * sensor.baseline_m * _nearness_1pm(rig, down)
    left = random.integers(0, 256, shape, dtype=np.uint8)
    rows = [np.roll(row, -round(d)) for row, d in zip(left, disparity_px, strict=True)]
    sides = PushedSource("left", left), PushedSource("right", np.stack(rows))
    return StereoFrame("ground", 0, *sides, size_px)


def _nearness_1pm(rig: Rig, down: Float64) -> Float64:
    """1 / depth of level ground along rays that go `down` metres for each metre ahead; a far wall
    where they do not come down to it."""
    tilt = math.radians(rig.mount.tilt_deg)
    falling = (down * math.cos(tilt) + math.sin(tilt)) / rig.mount.height_m
    return np.asarray(np.maximum(falling, 1.0 / _WALL_M))
