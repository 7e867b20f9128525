"""Frames to local grids, several at a time: the heavy half of a build, which needs no pose."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import NamedTuple

import cv2

from fieldgrid.grids import LocalGrid
from fieldgrid.localgrid import FrameGround, LocalGridder
from fieldgrid.recording import Frame
from fieldgrid.rig import Rig
from fieldgrid.settings import BuildSettings


class Perceived(NamedTuple):
    """One frame after perception, before it meets its pose; seconds by stage."""

    frame: Frame
    grid: LocalGrid
    ground: FrameGround
    images_sha256: tuple[str, str]
    decode_s: float
    match_s: float
    grid_s: float


def perceive(frames: Iterable[Frame], gridder: LocalGridder, jobs: int) -> Iterator[Perceived]:
    """Local grids of frames, in order, `jobs` at a time; few more are ever held in memory."""
    threads_before = cv2.getNumThreads()
    # Whole frames side by side use the cores better than OpenCV's stripes of one frame.
    cv2.setNumThreads(1)
    pool = ThreadPoolExecutor(jobs, thread_name_prefix="fieldgrid")
    pending: deque[Future[Perceived]] = deque()
    try:
        for frame in frames:
            pending.append(pool.submit(_perceive_one, frame, gridder))
            if len(pending) > jobs + 1:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        cv2.setNumThreads(threads_before)


def _perceive_one(frame: Frame, gridder: LocalGridder) -> Perceived:
    start = time.thread_time()
    left, right = frame.images()
    hashes = frame.left.sha256(), frame.right.sha256()
    decoded = time.thread_time()
    disparity = gridder.matcher.disparity(left, right)
    matched = time.thread_time()
    grid, ground = gridder.from_disparity(disparity)
    done = time.thread_time()
    return Perceived(
        frame, grid, ground, hashes, decoded - start, matched - decoded, done - matched
    )


@lru_cache(maxsize=8)
def _gridder(rig: Rig, settings: BuildSettings) -> LocalGridder:
    return LocalGridder(rig, settings.grid.spec(), settings.stereo, settings.density)


def local_grid(frame: Frame, rig: Rig, settings: BuildSettings | None = None) -> LocalGrid:
    """The vehicle-fixed local grid of one frame: read, decoded, matched and gridded here."""
    grid, _ = _gridder(rig, settings or BuildSettings())(*frame.images())
    return grid
