"""Frames to local grids and to the camera's own motion: the heavy half of a build, without pose."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from functools import lru_cache
from typing import NamedTuple, TypeVar

import cv2

from fieldgrid.core import BuildSettings, Float32, by_threads
from fieldgrid.geometry import GridSpec, LocalGrid, Rig, Steps, StereoCamera, Tilt, Trajectory
from fieldgrid.perception import (
    CameraStep,
    CodedDepth,
    Features,
    FrameGround,
    LocalGridder,
    OriginTrack,
    Refusal,
    Sweep,
    features,
    step,
    steps_of,
)
from fieldgrid.recordings import Frame, Image, Recording

_T = TypeVar("_T")
_Item = TypeVar("_Item")


GridInput = CodedDepth | Sweep
"""What a grid is made of: an image of depths, or the points of a cloud as they were read."""

StepOutcome = CameraStep | Refusal | None
"""The camera's step to a frame, or why there is none; None for the first and without odometry."""

GridListener = Callable[[LocalGrid, FrameGround], None]
"""Is told of a frame's grid as soon as it is made, before the rest of what is perceived."""


class Perception(NamedTuple):
    """One frame after perception, before it meets its pose; seconds by stage.

    `seen` is what the grid was made of. `is_level` is whether the grid's columns are vertical.
    `features` are those of visual odometry, None when it was not asked for. Only pairs are
    matched: of other frames `match_s` is 0.
    """

    frame: Frame
    seen: GridInput
    grid: LocalGrid
    ground: FrameGround
    is_level: bool
    features: Features | None
    sources_sha256: tuple[str, ...]
    decode_s: float
    match_s: float
    grid_s: float
    odometry_s: float


def taken_ns(frame: Frame, rig: Rig) -> int:
    """When a frame was taken, by the receiver's clock."""
    return frame.time_ns + rig.image_time_offset_ns


def perceive_frame(
    frame: Frame,
    gridder: LocalGridder,
    *,
    odometry: bool = False,
    tilt: Tilt | None = None,
    way: OriginTrack | None = None,
    gridded: GridListener | None = None,
) -> Perception:
    """One frame, read and perceived here; RecordingError where it cannot be read. With the
    vehicle's `tilt` the columns of its grid are vertical; by its `way` the points of a sweep are
    carried to its stamp."""
    start = time.thread_time()
    seen, decoded, pair = frame.read(_GridInputs(gridder))
    matched = decoded if pair is None else time.thread_time()
    grid, ground = grid_of(seen, taken_ns(frame, gridder.rig), gridder, tilt, way)
    done = time.thread_time()
    if gridded is not None:
        gridded(grid, ground)
    hashes = tuple(source.sha256() for source in frame.sources)
    hashed = time.thread_time()
    found = features(gridder.rig.camera, *pair) if odometry and pair is not None else None
    spent = decoded - start, matched - decoded, done - matched, time.thread_time() - hashed
    return Perception(frame, seen, grid, ground, tilt is not None, found, hashes, *spent)


class _GridInputs(NamedTuple):
    """What the grid of a frame is made of, when the frame was decoded, and its images if it is a
    pair."""

    gridder: LocalGridder

    def pair(self, left: Image, right: Image) -> tuple[GridInput, float, tuple[Image, Image]]:
        """A pair is matched."""
        decoded = time.thread_time()
        coded = self.gridder.coded(*self.gridder.matcher.disparity(left, right))
        return coded, decoded, (left, right)

    def depth(self, depth_m: Float32) -> tuple[GridInput, float, None]:
        """An image of depths."""
        decoded = time.thread_time()
        return self.gridder.coded_depth(depth_m), decoded, None

    def cloud(self, sweep: Sweep) -> tuple[GridInput, float, None]:
        """A cloud, as it was read."""
        return sweep, time.thread_time(), None


def follows_camera(rig: Rig, settings: BuildSettings) -> bool:
    """Whether the steps of the camera are worked out: if they are wanted, and it is a pair."""
    return settings.pose.uses_camera and isinstance(rig.sensor, StereoCamera)


class CameraMotion:
    """Visual odometry: give it the features of frames in their order."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._last: Features | None = None

    def add(self, seen: Features | None) -> StepOutcome:
        """The step to a frame from the one before; None for the first and without odometry."""
        before, self._last = self._last, seen
        return None if before is None or seen is None else step(before, seen, self._rig)


def visual_odometry(recording: Recording, jobs: int | None = None) -> Steps:
    """The steps of the camera from frame to frame of a recording; reads all of its images."""
    rig, motion = recording.rig, CameraMotion(recording.rig)
    times_ns, found = list[int](), list[StepOutcome]()

    def look(frame: Frame) -> tuple[int, Features]:
        return taken_ns(frame, rig), features(rig.camera, *frame.images())

    with closing(side_by_side(look, recording.frames(), jobs or os.cpu_count() or 1)) as looks:
        for time_ns, seen in looks:
            times_ns.append(time_ns)
            found.append(motion.add(seen))
    return steps_of(times_ns, [one for one in found if one is not None])


def side_by_side(
    work: Callable[[_Item], _T], items: Iterable[_Item], jobs: int
) -> Generator[_T, None, None]:
    """The work on frames, or on what else there is one of a frame, in their order, `jobs` at a
    time. Close it when it is not taken to its end: its threads end then."""
    threads_before = cv2.getNumThreads()
    # Whole frames side by side use the cores better than OpenCV's stripes of one frame.
    cv2.setNumThreads(1)
    try:
        yield from by_threads(work, items, jobs, jobs + 1)
    finally:
        cv2.setNumThreads(threads_before)


def grid_of(
    seen: GridInput, time_ns: int, gridder: LocalGridder, tilt: Tilt | None, way: OriginTrack | None
) -> tuple[LocalGrid, FrameGround]:
    """The grid of what a frame saw, and its ground. With the vehicle's `tilt` the columns are
    vertical; by its `way` the points of a sweep lie as they did at its stamp `time_ns`."""
    if isinstance(seen, CodedDepth):
        return gridder.from_coded(seen, tilt)
    points_m, rotation = seen.points_m, gridder.rig.mount.rotation()
    if way is not None:
        points_m = way.carried(seen, time_ns, rotation)
    return gridder.from_cloud(points_m, tilt)


@lru_cache(maxsize=8)
def _gridder(rig: Rig, settings: BuildSettings) -> LocalGridder:
    return LocalGridder(rig, GridSpec.of(settings.grid), settings.stereo, settings.density)


def local_grid(
    frame: Frame,
    rig: Rig,
    settings: BuildSettings | None = None,
    tilt: Tilt | None = None,
    trajectory: Trajectory | None = None,
) -> LocalGrid:
    """The vehicle-fixed local grid of one frame, a pair, a depth image or a cloud: read, decoded,
    matched and gridded here. With the vehicle's `tilt` its columns are vertical; with its
    `trajectory` the points of a sweep that have times are carried to its stamp."""
    gridder = _gridder(rig, settings or BuildSettings())
    way = None if trajectory is None else OriginTrack.of(trajectory)
    return perceive_frame(frame, gridder, tilt=tilt, way=way).grid
