"""Drives over a textured field, rendered for a pair of cameras of which everything is known.

The vehicle follows its unsteered axle, pitches and rolls a little from frame to frame, and may
have walls of leaves on both sides. Nothing of the package is used but its records.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import LeverArm, Lidar, Mount, Rig, StereoCamera
from fieldgrid.perception import Sweep
from fieldgrid.recordings import CloudFrame, Frame, Recording, StereoFrame

_Float64 = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

CAMERA = StereoCamera(480, 360, 420.0, 239.5, 179.5, 0.2)
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 500_000_000
WALL_M, WALL_HEIGHT_M = 1.6, 2.2
AXLE_AHEAD_M = 1.2

NO_MOUNT = Mount(1.0, 0.0)


@dataclass(frozen=True)
class Memory:
    """An image or a cloud that is there already."""

    name: str
    values: npt.NDArray[np.generic]

    def read(self) -> npt.NDArray[np.generic]:
        return self.values

    def sweep(self) -> Sweep:
        return Sweep(self.values)  # type: ignore[arg-type]

    def encoded(self) -> bytes:
        return b""

    def sha256(self) -> str:
        return ""


@dataclass(frozen=True)
class MemoryFrames:
    """Frames that are there already."""

    shots: tuple[Frame, ...]
    roles: tuple[str, ...] = ("left", "right")

    @property
    def times_ns(self) -> npt.NDArray[np.int64]:
        return np.array([shot.time_ns for shot in self.shots], dtype=np.int64)

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        return iter(self.shots[start:stop])


def in_memory(rig: Rig, shots: Iterable[Frame]) -> Recording:
    """A recording without files."""
    return Recording(
        path=Path("rendered"), name="rendered", rig=rig, source=MemoryFrames(tuple(shots))
    )


@cache
def rendered(
    mount: Mount,
    *,
    step_m: float = 0.9,
    frames: int = 18,
    curvature_per_m: float = 0.0,
    sway_deg: float = 0.25,
    walls: bool = False,
    textured: bool = True,
) -> Recording:
    """A drive of a camera that really hangs as `mount` says, while its rig says `NO_MOUNT`.

    A negative step is reverse. The drive is made once: copy what you change.
    """
    random = np.random.default_rng(5)
    texture = _texture() if textured else np.full((1024, 1024), 128, dtype=np.uint8)
    shots: list[Frame] = []
    x, y, heading = 0.0, 0.0, 0.0  # of the axle: right, forward of its start; clockwise
    for k in range(frames):
        pitch, roll = random.normal(0.0, sway_deg, 2)
        pair = [
            _view(texture, mount, (x, y, heading), (pitch, roll), side, walls) for side in (-1, 1)
        ]
        left, right = (Memory(f"{side} {k}", image) for side, image in zip("lr", pair, strict=True))
        time_ns = START_NS + k * PERIOD_NS
        size_px = (CAMERA.width_px, CAMERA.height_px)
        shots.append(StereoFrame(f"{k:04d}", time_ns, left, right, size_px))  # type: ignore[arg-type]
        middle = heading + step_m * curvature_per_m / 2.0
        x, y = x + step_m * math.sin(middle), y + step_m * math.cos(middle)
        heading += step_m * curvature_per_m
    return in_memory(Rig(CAMERA, NO_MOUNT, LeverArm(0.0, 0.0, 2.0)), shots)


def _texture() -> Image:
    random = np.random.default_rng(1)
    fine = random.integers(0, 256, (1024, 1024)).astype(np.float32)
    layers = [cv2.GaussianBlur(fine, (0, 0), sigma) for sigma in (1.0, 3.0, 9.0)]
    mixed = sum((layer - layer.mean()) / layer.std() for layer in layers)
    return np.clip(128.0 + 28.0 * mixed, 0, 255).astype(np.uint8)


def _view(
    texture: Image,
    mount: Mount,
    axle: tuple[float, float, float],
    sway_deg: tuple[float, float],
    side: int,
    walls: bool,
) -> Image:
    """What the left (-1) or right (1) camera sees."""
    x, y, heading = axle
    pitch, roll = np.radians(sway_deg)
    cos, sin = math.cos(heading), math.sin(heading)
    R_field_nose = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    # Nose up, then right side down, about the axle on the ground.
    nosed = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, math.cos(pitch), -math.sin(pitch)],
            [0.0, math.sin(pitch), math.cos(pitch)],
        ]
    )
    rolled = np.array(
        [
            [math.cos(roll), 0.0, math.sin(roll)],
            [0.0, 1.0, 0.0],
            [-math.sin(roll), 0.0, math.cos(roll)],
        ]
    )
    R_field_vehicle = R_field_nose @ nosed @ rolled
    R = R_field_vehicle @ mount.rotation()
    eye = np.array([x, y, 0.0]) + R_field_vehicle @ [0.0, AXLE_AHEAD_M, mount.height_m]
    eye = eye + R @ [side * CAMERA.baseline_m / 2.0, 0.0, 0.0]
    v, u = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px].astype(np.float64)
    ray = np.tensordot(
        R,
        np.stack(
            [
                (u - CAMERA.cx_px) / CAMERA.focal_px,
                (v - CAMERA.cy_px) / CAMERA.focal_px,
                np.ones_like(u),
            ]
        ),
        axes=1,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(ray[2] < 0.0, -eye[2] / ray[2], np.inf)
        a, b = eye[0] + depth * ray[0], eye[1] + depth * ray[1]
        if walls:
            for wall_x in (-WALL_M, WALL_M):
                to_wall = (wall_x - eye[0]) / ray[0]
                height = eye[2] + to_wall * ray[2]
                hit = (
                    (to_wall > 0.0) & (to_wall < depth) & (height < WALL_HEIGHT_M) & (height > 0.0)
                )
                depth = np.where(hit, to_wall, depth)
                a = np.where(hit, 40.0 + height, a)
                b = np.where(hit, eye[1] + to_wall * ray[1], b)
    seen = np.isfinite(depth) & (depth < 60.0)
    per_m = 60.0  # texture pixels in a metre
    grey = cv2.remap(
        texture,
        np.where(seen, a * per_m, 0.0).astype(np.float32) % 1024.0,
        np.where(seen, b * per_m, 0.0).astype(np.float32) % 1024.0,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )
    return np.where(seen, grey, 200).astype(np.uint8)


def swept(mount: Mount, *, sweeps: int = 5) -> Recording:
    """A lidar over flat ground with posts, standing still."""
    random = np.random.default_rng(3)
    shots: list[Frame] = []
    for k in range(sweeps):
        ground = np.column_stack([*random.uniform(-9.0, 9.0, (2, 6000)), np.zeros(6000)])
        posts = np.column_stack([*random.uniform(-6.0, 6.0, (2, 1500)), random.uniform(0, 2, 1500)])
        points = np.concatenate([ground, posts]) - [0.0, 0.0, mount.height_m]
        points += random.normal(0.0, 0.01, points.shape)
        in_sensor = (points @ mount.rotation()).astype(np.float32)
        cloud = Memory(f"sweep {k}", in_sensor)
        shots.append(CloudFrame(str(k), START_NS + k * PERIOD_NS, cloud))  # type: ignore[arg-type]
    return in_memory(Rig(Lidar(1000.0), NO_MOUNT, LeverArm(0.0, 0.0, 2.0)), shots)
