"""The one pass over the frames: some are examined closely, visual odometry follows stretches."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, FieldgridError
from fieldgrid.geometry import Steps, StereoCamera
from fieldgrid.perception import Features, FrameGround, LocalGridder, features
from fieldgrid.pipeline.inspection.measures import ImageMeasures, PairMeasures
from fieldgrid.pipeline.staging.perception import CameraMotion, perceive_frame, side_by_side
from fieldgrid.recordings import Frame, Image, Recording

Tell = Callable[[int, int], None]
"""Is told how many frames of how many have been looked at."""


class UnreadFrame(NamedTuple):
    """A frame that could not be had, and the sentence that says why; `misfit` when its images
    are not those of the calibration."""

    frame_id: str
    problem: str
    misfit: bool


class FramePass(NamedTuple):
    """What the pass brought. `looks` are of pairs; `grounds` and `observed_shares` of every frame
    that was looked at closely, whatever its kind. `steps` are those of the stretches, out of
    `tried` pairs of neighbours; `followed` frames were looked at for them."""

    looks: tuple[PairMeasures, ...]
    grounds: tuple[FrameGround, ...]
    observed_shares: tuple[float, ...]
    unread: tuple[UnreadFrame, ...]
    steps: Steps | None
    tried: int
    followed: int


class _FollowedFrame(NamedTuple):
    """What was made of one frame: its features where it is followed, a look where it is due."""

    time_ns: int
    features: Features | None
    look: PairMeasures | None


def look_at(
    recording: Recording,
    gridder: LocalGridder,
    every: int,
    runs: Sequence[range],
    tell: Tell | None = None,
) -> FramePass:
    """Look at every `every`-th frame closely, and at the frames of `runs` for their motion.

    A frame that cannot be read is put down, and the others are looked at.
    """
    if isinstance(recording.rig.sensor, StereoCamera):
        return _pairs(recording, gridder, every, runs, tell)
    return _others(recording, gridder, every)


def _pairs(
    recording: Recording,
    gridder: LocalGridder,
    every: int,
    runs: Sequence[range],
    tell: Tell | None,
) -> FramePass:
    run_of = {index: k for k, run in enumerate(runs) for index in run}
    close = set(range(0, recording.frame_count, every))
    wanted = sorted(run_of.keys() | close)

    def work(item: tuple[int, Frame]) -> _FollowedFrame | UnreadFrame:
        index, frame = item
        try:
            left, right = frame.images()
            seen = features(gridder.rig.camera, left, right)
            look = _look(frame, left, right, seen, gridder) if index in close else None
            return _FollowedFrame(frame.time_ns, seen if index in run_of else None, look)
        except FieldgridError as problem:
            return UnreadFrame(frame.frame_id, str(problem), isinstance(problem, CalibrationError))

    offset_ns = recording.rig.image_time_offset_ns
    motions = [CameraMotion(recording.rig) for _ in runs]
    looks: list[PairMeasures] = []
    unread: list[UnreadFrame] = []
    followed = 0
    chosen = ((k, frame) for k, frame in enumerate(recording.frames()) if k in run_of or k in close)
    with closing(side_by_side(work, chosen, os.cpu_count() or 1)) as made:
        for done, found in enumerate(made):
            if tell is not None:
                tell(done + 1, len(wanted))
            if isinstance(found, UnreadFrame):
                unread.append(found)
                continue
            if found.look is not None:
                looks.append(found.look)
            if found.features is not None:  # what is made of the frames comes in their order
                motions[run_of[wanted[done]]].add(found.time_ns + offset_ns, found.features)
                followed += 1
    steps = None
    if motions:
        parts = zip(*(motion.steps() for motion in motions), strict=True)
        steps = Steps(*(np.concatenate(columns) for columns in parts))
    return FramePass(
        looks=tuple(looks),
        grounds=tuple(look.ground for look in looks),
        observed_shares=tuple(look.observed_share for look in looks),
        unread=tuple(unread),
        steps=steps,
        tried=sum(motion.tried for motion in motions),
        followed=followed,
    )


def _look(
    frame: Frame, left: Image, right: Image, seen: Features, gridder: LocalGridder
) -> PairMeasures:
    grid, ground = gridder(left, right)
    return PairMeasures(
        frame_id=frame.frame_id,
        time_ns=frame.time_ns,
        images=ImageMeasures.of(left, right, gridder.rig.camera),
        points=len(seen.blur_px),
        ground=ground,
        observed_share=float(grid.observed.mean()),
    )


def _others(recording: Recording, gridder: LocalGridder, every: int) -> FramePass:
    """Depth images and clouds: only their grids are made."""
    grounds: list[FrameGround] = []
    observed: list[float] = []
    unread: list[UnreadFrame] = []
    for index, frame in enumerate(recording.frames()):
        if index % every:
            continue
        try:
            seen = perceive_frame(frame, gridder)
        except FieldgridError as problem:
            unread.append(
                UnreadFrame(frame.frame_id, str(problem), isinstance(problem, CalibrationError))
            )
            continue
        grounds.append(seen.ground)
        observed.append(float(seen.grid.observed.mean()))
    return FramePass((), tuple(grounds), tuple(observed), tuple(unread), None, 0, 0)
