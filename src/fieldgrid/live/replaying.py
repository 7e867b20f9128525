"""A recording pushed as if it were driven now, at its own pace or another."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from heapq import merge
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.geometry import Fix
from fieldgrid.live.given import GIVEN_ROWS, rows_of_body
from fieldgrid.live.pose.sensor_rows import PARTS, Rows
from fieldgrid.live.session import Live
from fieldgrid.recordings import Recording

BATCH_NS = 20_000_000
"""Rows of a sensor that are pushed together: a receiver or an IMU sends in such pieces."""


class _TimedPush(NamedTuple):
    """What is pushed at a time of the recording."""

    time_ns: int
    order: int
    push: Callable[[], Any]


def replay(
    live: Live,
    recording: Recording,
    *,
    rate: float | None = 1.0,
    stop: threading.Event | None = None,
) -> bool:
    """Push what a recording holds, in order of the times at which it was taken, `rate` times as
    fast as that; with None as fast as it is perceived, and no frame is dropped then.

    What a session that was ended has already is left out. Returns whether all was pushed: not when
    `stop` was set. A session for a recording with poses of another program is one that was begun
    with them (`poses=recording.pose_body`).
    """
    stop, began_s, began_ns = stop or threading.Event(), time.monotonic(), None
    for due in merge(*_streams(live, recording, wait=rate is None)):
        began_ns = due.time_ns if began_ns is None else began_ns
        if rate is not None:
            late_s = began_s + (due.time_ns - began_ns) / 1e9 / rate - time.monotonic()
            if late_s > 0.0:
                stop.wait(late_s)
        if stop.is_set():
            return False
        due.push()
    live.drain()
    return True


def _streams(live: Live, recording: Recording, *, wait: bool) -> Iterator[Iterator[_TimedPush]]:
    """Each stream of a recording, in order of time. Sensors go before a frame of the same time."""
    had = live.counts
    yield _fixes(live, list(recording.fixes())[had.fixes :])
    for order, part in enumerate(PARTS, 1):
        values = getattr(recording.motion(), part)
        if values is not None:
            rows = Rows(values[0], tuple(values[1:]))
            yield _rows(live, part, rows, had.rows.get(part, 0), order)
    if recording.body_poses is not None:
        rows, first = rows_of_body(recording.body_poses), had.rows.get(GIVEN_ROWS, 0)
        yield _rows(live, GIVEN_ROWS, rows, first, len(PARTS) + 1)
    yield _frames(live, recording, wait=wait)


def _fixes(live: Live, fixes: list[Fix]) -> Iterator[_TimedPush]:
    newest_ns = 0
    for fix in fixes:
        # A log that goes back in time goes on when it is its turn: the order is that of the log.
        newest_ns = max(newest_ns, fix.time_ns)
        yield _TimedPush(newest_ns, 0, partial(live.push_fix, fix))


def _rows(live: Live, part: str, rows: Rows, first: int, order: int) -> Iterator[_TimedPush]:
    while first < len(rows.time_ns):
        stop = int(np.searchsorted(rows.time_ns, rows.time_ns[first] + BATCH_NS, side="right"))
        piece = Rows(rows.time_ns[first:stop], tuple(c[first:stop] for c in rows.columns))
        yield _TimedPush(int(piece.time_ns[-1]), order, partial(live.push_rows, part, piece))
        first = stop


def _frames(live: Live, recording: Recording, *, wait: bool) -> Iterator[_TimedPush]:
    offset_ns, newest_ns = recording.rig.image_time_offset_ns, live.newest_frame_ns

    for frame in recording.frames():
        time_ns = frame.time_ns + offset_ns
        # The last one that is kept is pushed again: the camera's next step starts there.
        if newest_ns is None or time_ns >= newest_ns:
            yield _TimedPush(time_ns, len(PARTS) + 2, partial(live.push_frame, frame, wait=wait))
