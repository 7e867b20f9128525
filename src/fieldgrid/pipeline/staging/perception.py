"""Frames to local grids and to the camera's own motion: the heavy half of a build, without pose."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from functools import lru_cache, partial
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


GridListener = Callable[[LocalGrid, FrameGround], None]
"""Is told of a frame's grid as soon as it is made, before the rest of what is perceived."""


class Perception(NamedTuple):
    """One frame after perception, before it meets its pose; seconds by stage.

    `seen` is what the grid was made of: an image of depths, or the points of a cloud as they were
    read. `features` are those of visual odometry, None when it was not asked for. Only pairs are
    matched: of other frames `match_s` is 0.
    """

    frame: Frame
    seen: CodedDepth | Sweep
    grid: LocalGrid
    ground: FrameGround
    features: Features | None
    sources_sha256: tuple[str, ...]
    decode_s: float
    match_s: float
    grid_s: float
    odometry_s: float


def perceive(
    frames: Iterable[Frame],
    gridder: LocalGridder,
    jobs: int,
) -> Generator[Perception, None, None]:
    """Local grids of frames, in order, `jobs` at a time; few more are ever held in memory. Close it
    when it is not taken to its end: its threads end then."""
    return side_by_side(partial(perceive_frame, gridder=gridder), frames, jobs)


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
    return frame.read(_Stages(frame, gridder, odometry, tilt, way, gridded))


def follows_camera(rig: Rig, settings: BuildSettings) -> bool:
    """Whether the steps of the camera are worked out: if they are wanted, and it is a pair."""
    return settings.pose.uses_camera and isinstance(rig.sensor, StereoCamera)


class CameraMotion:
    """Visual odometry over a drive: give it the frames in order, and take the steps.

    `distance_m` is the distance that the camera has moved until now.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._last: Features | None = None
        self._times_ns: list[int] = []
        self._found: list[CameraStep | Refusal] = []
        self.distance_m = 0.0

    def add(self, time_ns: int, seen: Features) -> CameraStep | Refusal | None:
        """The next frame, taken at `time_ns` by the receiver's clock; returns the step to it from
        the frame before, None for the first."""
        found: CameraStep | Refusal | None = None
        if self._last is not None:
            found = step(self._last, seen, self._rig)
            self._found.append(found)
            if isinstance(found, CameraStep):
                self.distance_m += math.hypot(found.forward_m, found.right_m)
        self._times_ns.append(time_ns)
        self._last = seen
        return found

    @property
    def tried(self) -> int:
        """How many pairs of neighbours there were."""
        return len(self._found)

    def steps(self) -> Steps:
        """The steps between the frames that were given."""
        return steps_of(self._times_ns, self._found)


def visual_odometry(recording: Recording, jobs: int | None = None) -> Steps:
    """The steps of the camera from frame to frame of a recording; reads all of its images."""
    motion = CameraMotion(recording.rig)
    camera, offset_ns = recording.rig.camera, recording.rig.image_time_offset_ns

    def look(frame: Frame) -> tuple[int, Features]:
        return frame.time_ns, features(camera, *frame.images())

    with closing(side_by_side(look, recording.frames(), jobs or os.cpu_count() or 1)) as looks:
        for time_ns, seen in looks:
            motion.add(time_ns + offset_ns, seen)
    return motion.steps()


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


class _Stages:
    """Makes what is perceived of one frame once it is read, and times it from here on."""

    def __init__(
        self,
        frame: Frame,
        gridder: LocalGridder,
        odometry: bool,
        tilt: Tilt | None,
        way: OriginTrack | None,
        gridded: GridListener | None,
    ) -> None:
        self._frame, self._gridder, self._odometry = frame, gridder, odometry
        self._tilt, self._way, self._tell = tilt, way, gridded or (lambda *_: None)
        self._start = time.thread_time()

    def pair(self, left: Image, right: Image) -> Perception:
        """What a pair gives: it is matched, gridded and, if that is wanted, its features are
        found."""
        gridder, hashes = self._gridder, self._hashes()
        decoded = time.thread_time()
        coded = gridder.coded(*gridder.matcher.disparity(left, right))
        matched = time.thread_time()
        grid, ground = gridder.from_coded(coded, self._tilt)
        gridded = time.thread_time()
        self._tell(grid, ground)
        seen = features(gridder.rig.camera, left, right) if self._odometry else None
        done = time.thread_time()
        return Perception(
            self._frame,
            coded,
            grid,
            ground,
            seen,
            hashes,
            decoded - self._start,
            matched - decoded,
            gridded - matched,
            done - gridded,
        )

    def depth(self, depth_m: Float32) -> Perception:
        """What an image of depths gives."""
        decoded = time.thread_time()
        coded = self._gridder.coded_depth(depth_m)
        return self._gridded(coded, self._gridder.from_coded(coded, self._tilt), decoded)

    def cloud(self, sweep: Sweep) -> Perception:
        """What a cloud gives, its points as they lay at its stamp where that is known."""
        decoded, rig = time.thread_time(), self._gridder.rig
        points_m = carried(sweep, taken_ns(self._frame, rig), rig, self._way)
        return self._gridded(sweep, self._gridder.from_cloud(points_m, self._tilt), decoded)

    def _gridded(
        self, seen: CodedDepth | Sweep, made: tuple[LocalGrid, FrameGround], decoded: float
    ) -> Perception:
        grid_s = time.thread_time() - decoded
        self._tell(*made)
        hashes, decode_s = self._hashes(), decoded - self._start
        return Perception(self._frame, seen, *made, None, hashes, decode_s, 0.0, grid_s, 0.0)

    def _hashes(self) -> tuple[str, ...]:
        return tuple(source.sha256() for source in self._frame.sources)


def carried(sweep: Sweep, time_ns: int, rig: Rig, way: OriginTrack | None) -> Float32:
    """The points [n, 3] of a sweep as they lay at its stamp by the vehicle's `way`, where that and
    their times are known."""
    return sweep.points_m if way is None else way.carried(sweep, time_ns, rig.mount.rotation())


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
