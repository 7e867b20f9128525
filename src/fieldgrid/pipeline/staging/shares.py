"""Frames of a drive to staged frames: the heavy half of a build, in any shares and any process.

A share is a run of frames. Whoever stages one looks at the frame before it too, for the camera's
step to its first frame, so shares that are staged apart are what one run over the drive gives.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from fieldgrid.core import RecordingError
from fieldgrid.geometry import Rig, Steps, Tilt
from fieldgrid.maps import StagedFrame, StagedFrames, StageEntry, StageFile, stage
from fieldgrid.perception import CameraStep, LocalGridder, OriginTrack, Refusal, features, steps_of
from fieldgrid.pipeline.report import BadFrame, StageTimes
from fieldgrid.pipeline.staging.perception import (
    CameraMotion,
    Perception,
    perceive_frame,
    side_by_side,
    taken_ns,
)
from fieldgrid.poses import Attitude
from fieldgrid.recordings import Frame

StepOutcome = CameraStep | Refusal | None
"""The camera's step to a frame, or why there is none; None for the first and without odometry."""


class FrameProvider(Protocol):
    """Where frames come from: a recording, or its source, which can be pickled."""

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Frames number `start` to before `stop`, unread."""


class DriveWork(NamedTuple):
    """All that it takes to stage the frames of a drive: every `every`-th, `total` in all. `way` is
    the vehicle's, by which sweeps are carried to their stamps, None where that is not to be."""

    frames: FrameProvider
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
    """What became of a frame: staged, or left out since it is bad. `moved_m` is how far the camera
    went since the frame before."""

    staged: StagedFrame | None
    found: StepOutcome
    bad: BadFrame | None
    moved_m: float
    times: StageTimes


@dataclass(slots=True)
class StagedDrive:
    """The frames of a drive, or of a share of it, staged in order, without those that are bad."""

    frames: StagedFrames
    entries: Sequence[StageEntry]
    found: list[StepOutcome] = field(default_factory=list)
    bad: list[BadFrame] = field(default_factory=list)
    times: StageTimes = field(default_factory=StageTimes)

    def steps(self) -> tuple[Steps, Counter[str]]:
        """The camera's steps, and why there is none between other neighbours."""
        found = [one for one in self.found[1:] if one is not None]
        refused = Counter(one.value for one in found if isinstance(one, Refusal))
        return steps_of([entry.time_ns for entry in self.entries], found), refused


Tell = Callable[[float], None]
"""Is told of each frame that is done, with how far the camera went since the one before, metres."""


def collect(looks: Iterable[FrameOutcome], file: StageFile, tell: Tell) -> StagedDrive:
    """Write frames to a file as they come."""
    staged = StagedDrive(file, file.entries)
    for looked in looks:
        start = time.thread_time()
        staged.times.add(looked.times)
        if looked.staged is not None:
            file.append(looked.staged)
        if looked.bad is not None:
            staged.bad.append(looked.bad)
        else:
            staged.found.append(looked.found)
        staged.times.map_s += time.thread_time() - start
        tell(looked.moved_m)
    return staged


def stage_frames(
    work: DriveWork, first: int, last: int, jobs: int
) -> Generator[FrameOutcome, None, None]:
    """Stage the frames number `first` to before `last`, in order, `jobs` at a time. Close it when
    it is not taken to its end: its threads end then.

    Raises RecordingError for a frame that cannot be read, unless the work skips those.
    """
    motion = CameraMotion(work.gridder.rig) if work.odometry else None
    if motion is not None:
        _begin(work, first, motion)

    def look(frame: Frame) -> tuple[Perception, StagedFrame] | BadFrame:
        attitude, time_ns = work.attitude, taken_ns(frame, work.gridder.rig)
        tilt = None if attitude is None else attitude.tilt_at(time_ns)
        try:
            return stage_frame(frame, work.gridder, odometry=work.odometry, tilt=tilt, way=work.way)
        except RecordingError as problem:
            if not work.skips_bad:
                raise
            return BadFrame(frame.frame_id, str(problem))

    # A traceback that somebody keeps would keep its threads.
    with closing(side_by_side(look, work.taken(first, last), jobs)) as looks:
        for looked in looks:
            if isinstance(looked, BadFrame):
                yield FrameOutcome(None, None, looked, 0.0, StageTimes())
                continue
            seen, staged = looked
            start, found, moved_m = time.thread_time(), None, 0.0
            if motion is not None and seen.features is not None:
                before_m = motion.distance_m
                found = motion.add(staged.time_ns, seen.features)
                moved_m = motion.distance_m - before_m
            times = StageTimes(
                seen.decode_s,
                seen.match_s,
                seen.grid_s,
                seen.odometry_s + time.thread_time() - start,
            )
            yield FrameOutcome(staged, found, None, moved_m, times)


def _begin(work: DriveWork, first: int, motion: CameraMotion) -> None:
    """Let the motion begin at the last frame before a share that can be read."""
    for number in range(first - 1, -1, -1):
        (frame,) = work.taken(number, number + 1)
        try:
            seen = features(work.gridder.rig.camera, *frame.images())
        except RecordingError:
            if not work.skips_bad:
                raise
            continue
        motion.add(taken_ns(frame, work.gridder.rig), seen)
        return


def stage_frame(
    frame: Frame,
    gridder: LocalGridder,
    *,
    odometry: bool,
    tilt: Tilt | None = None,
    way: OriginTrack | None = None,
) -> tuple[Perception, StagedFrame]:
    """One frame, read, perceived and encoded here; RecordingError where it cannot be read."""
    seen = perceive_frame(frame, gridder, odometry=odometry, tilt=tilt, way=way)
    return seen, encoded(seen, gridder.rig)


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
