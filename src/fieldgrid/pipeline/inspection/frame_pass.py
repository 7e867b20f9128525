"""The one pass over the frames: some are examined closely, visual odometry follows stretches."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, FieldgridError
from fieldgrid.geometry import Steps, StereoCamera
from fieldgrid.perception import Features, FrameGround, LocalGridder, features, steps_of
from fieldgrid.pipeline.inspection.measures import ImageMeasures, PairMeasures
from fieldgrid.pipeline.staging.perception import (
    CameraMotion,
    StepOutcome,
    perceive_frame,
    side_by_side,
)
from fieldgrid.recordings import Frame, Recording

Tell = Callable[[int, int], None]
"""Is told how many frames of how many have been looked at."""


class UnreadFrame(NamedTuple):
    """Why a frame could not be had, as a sentence; `misfit` when its images are not those of the
    calibration."""

    problem: str
    misfit: bool


class FramePass(NamedTuple):
    """What the pass brought. `looks` are of pairs; `grounds` of every frame that was looked at
    closely, whatever its kind. `steps` are those of the stretches, out of `tried` pairs of
    neighbours; `followed` frames were looked at for them."""

    looks: list[PairMeasures]
    grounds: list[FrameGround]
    unread: list[UnreadFrame]
    steps: Steps
    tried: int
    followed: int


class _SeenFrame(NamedTuple):
    """What was made of one frame: the features of a pair; its ground, and what a pair is like,
    where it is looked at closely."""

    time_ns: int
    features: Features | None = None
    ground: FrameGround | None = None
    look: PairMeasures | None = None


def look_at(
    recording: Recording,
    gridder: LocalGridder,
    every: int,
    runs: Sequence[range],
    tell: Tell | None = None,
) -> FramePass:
    """Look at every `every`-th frame closely, and at the frames of `runs` for their motion, which
    pairs alone tell; of depth images and clouds only the grids are made.

    A frame that cannot be read is put down, and the others are looked at.
    """
    rig = recording.rig
    run_of = {index: k for k, run in enumerate(runs) for index in run}
    close = set(range(0, recording.frame_count, every))
    wanted = sorted(run_of.keys() | close)

    def work(item: tuple[int, Frame]) -> _SeenFrame | UnreadFrame:
        index, frame = item
        try:
            if not isinstance(rig.sensor, StereoCamera):
                return _SeenFrame(frame.time_ns, ground=perceive_frame(frame, gridder).ground)
            left, right = frame.images()
            seen = features(rig.sensor, left, right)
            if index not in close:
                return _SeenFrame(frame.time_ns, seen)
            grid, ground = gridder(left, right)
            look = PairMeasures(
                frame_id=frame.frame_id,
                time_ns=frame.time_ns,
                images=ImageMeasures.of(left, right, rig.sensor),
                points=len(seen.blur_px),
                ground=ground,
                observed_share=float(grid.observed.mean()),
            )
            return _SeenFrame(frame.time_ns, seen, ground, look)
        except FieldgridError as problem:
            return UnreadFrame(str(problem), isinstance(problem, CalibrationError))

    motions = [CameraMotion(rig) for _ in runs]
    times_ns, steps = [list[int]() for _ in runs], [list[StepOutcome]() for _ in runs]
    looks, grounds = list[PairMeasures](), list[FrameGround]()
    unread = list[UnreadFrame]()
    chosen = ((k, frame) for k, frame in enumerate(recording.frames()) if k in run_of or k in close)
    with closing(side_by_side(work, chosen, os.cpu_count() or 1)) as made:
        for done, found in enumerate(made):
            if tell is not None:
                tell(done + 1, len(wanted))
            if isinstance(found, UnreadFrame):
                unread.append(found)
                continue
            run = run_of.get(wanted[done])  # what is made of the frames comes in their order
            if run is not None:
                times_ns[run].append(found.time_ns + rig.image_time_offset_ns)
                steps[run].append(motions[run].add(found.features))
            if found.ground is not None:
                grounds.append(found.ground)
            if found.look is not None:
                looks.append(found.look)
    tried = [[one for one in run if one is not None] for run in steps]
    parts = [steps_of([], []), *map(steps_of, times_ns, tried)]
    return FramePass(
        looks=looks,
        grounds=grounds,
        unread=unread,
        steps=Steps(*map(np.concatenate, zip(*parts, strict=True))),
        tried=sum(map(len, tried)),
        followed=sum(map(len, steps)),
    )
