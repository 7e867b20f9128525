"""Frames of a drive to staged frames: the heavy half of a build, in any shares and any process.

A share is a run of frames. Whoever stages one looks at the frame before it too, for the camera's
step to its first frame, so shares that are staged apart are what one run over the drive gives.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from typing import NamedTuple

from fieldgrid.core import RecordingError
from fieldgrid.geometry import Rig, Tilt
from fieldgrid.maps import StagedFrame, stage
from fieldgrid.perception import CameraStep, LocalGridder, OriginTrack, features
from fieldgrid.pipeline.report import BadFrame, StageTimes
from fieldgrid.pipeline.staging.perception import (
    CameraMotion,
    GridListener,
    Perception,
    StepOutcome,
    perceive_frame,
    side_by_side,
    taken_ns,
)
from fieldgrid.poses import Attitude
from fieldgrid.recordings import CloudFrame, Frame, FrameSource


class DriveWork(NamedTuple):
    """All that it takes to stage the frames of a drive: every `every`-th, `total` in all. `way` is
    the vehicle's, by which sweeps are carried to their stamps, None where that is not to be."""

    frames: FrameSource
    total: int
    gridder: LocalGridder
    attitude: Attitude | None
    way: OriginTrack | None
    every: int
    odometry: bool
    skips_bad: bool

    def taken(self, first: int, last: int) -> Iterator[Frame]:
        """The frames number `first` to before `last` of those that are taken."""
        start, stop = first * self.every, (last - 1) * self.every + 1
        frames = self.frames.frames(start, stop)
        return (frame for k, frame in enumerate(frames) if k % self.every == 0)


class FrameOutcome(NamedTuple):
    """What became of a frame: staged, or left out since it is bad."""

    staged: StagedFrame | None
    found: StepOutcome
    bad: BadFrame | None
    times: StageTimes


class FrameStager:
    """What becomes of the frames of a drive, in a build as in a live session: they are looked at
    side by side, in any thread, and then followed in their order.

    `tilt` and `way` tell how the vehicle leans at the time of a frame, and how it goes then; None
    where that is not known.
    """

    def __init__(
        self,
        gridder: LocalGridder,
        *,
        odometry: bool,
        tilt: Callable[[int], Tilt | None],
        way: Callable[[int], OriginTrack | None],
    ) -> None:
        self._gridder, self._odometry = gridder, odometry
        self._tilt, self._way = tilt, way
        self.motion = CameraMotion(gridder.rig)

    def look(self, frame: Frame, gridded: GridListener | None = None) -> Perception:
        """Read and perceive a frame; RecordingError where it cannot be read."""
        time_ns = taken_ns(frame, self._gridder.rig)
        return perceive_frame(
            frame,
            self._gridder,
            odometry=self._odometry,
            tilt=self._tilt(time_ns),
            way=self._way(time_ns) if isinstance(frame, CloudFrame) else None,
            gridded=gridded,
        )

    def follow(self, seen: Perception) -> tuple[StepOutcome, StageTimes]:
        """The camera's step to the next frame, and what that took in all."""
        start = time.thread_time()
        found = self.motion.add(seen.features)
        odometry_s = seen.odometry_s + time.thread_time() - start
        return found, StageTimes(seen.decode_s, seen.match_s, seen.grid_s, odometry_s)


def stage_frames(
    work: DriveWork, first: int, last: int, jobs: int
) -> Generator[FrameOutcome, None, None]:
    """Stage the frames number `first` to before `last`, in order, `jobs` at a time. Close it when
    it is not taken to its end: its threads end then.

    Raises RecordingError for a frame that cannot be read, unless the work skips those.
    """
    stager = FrameStager(
        work.gridder,
        odometry=work.odometry,
        tilt=lambda time_ns: None if work.attitude is None else work.attitude.tilt_at(time_ns),
        way=lambda _: work.way,
    )
    if work.odometry:
        _begin(work, first, stager.motion)

    def look(frame: Frame) -> tuple[Perception, StagedFrame] | BadFrame:
        try:
            seen = stager.look(frame)
        except RecordingError as problem:
            if not work.skips_bad:
                raise
            return BadFrame(frame.frame_id, str(problem))
        return seen, encoded(seen, work.gridder.rig)

    # A traceback that somebody keeps would keep its threads.
    with closing(side_by_side(look, work.taken(first, last), jobs)) as looks:
        for looked in looks:
            if isinstance(looked, BadFrame):
                yield FrameOutcome(None, None, looked, StageTimes())
            else:
                seen, staged = looked
                found, times = stager.follow(seen)
                yield FrameOutcome(staged, found, None, times)


def _begin(work: DriveWork, first: int, motion: CameraMotion) -> None:
    """Let the motion begin at the last frame before a share that can be read."""
    for number in range(first - 1, -1, -1):
        (frame,) = work.taken(number, number + 1)
        try:
            motion.add(features(work.gridder.rig.camera, *frame.images()))
        except RecordingError:
            if not work.skips_bad:
                raise
        else:
            return


def moved_m(found: StepOutcome) -> float:
    """How far the camera went in a step, metres; 0 where there is none."""
    return math.hypot(found.forward_m, found.right_m) if isinstance(found, CameraStep) else 0.0


def encoded(seen: Perception, rig: Rig) -> StagedFrame:
    """What a frame saw, as a map keeps it."""
    frame = seen.frame
    return stage(
        seen.grid,
        frame.frame_id,
        taken_ns(frame, rig),
        images=tuple(source.name for source in frame.sources),
        images_sha256=seen.sources_sha256,
        ground_found=seen.ground.refined,
        channels=seen.ground.channels(),
    )
