"""Times of messages put right: which clock, in which order, and what belongs to one moment."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np

from fieldgrid.core import MAX_TIME_NS, MIN_TIME_NS, Bool, Index, Int64, RecordingError

WINDOW = 16
"""How many messages of one topic wait for an earlier one at most; each may hold an image."""

MAX_APART_NS = 10_000_000
"""Two images of cameras that are triggered together are not stamped further apart."""

_TIMELESS_SHARE = 0.1
"""A topic that lacks more of its stamps than this has none that could be believed."""


class Clock(NamedTuple):
    """Times of all messages of a topic, 0 where there is none, and whether they are those of
    the recorder, for want of stamps."""

    time_ns: Int64
    received: bool


class OrderedMessages(NamedTuple):
    """Messages in order of time: their times, strictly increasing, and their places in the topic.

    `late` counts those that came after later ones had to be passed on, or again at the same
    time; `timeless` those without a time.
    """

    time_ns: Int64
    place: Int64
    late: int
    timeless: int


def is_utc(time_ns: Int64) -> Bool:
    """Whether times can be UTC: a clock that counts from the start of a machine is not."""
    return (time_ns >= MIN_TIME_NS) & (time_ns <= MAX_TIME_NS)


def clock(topic: str, stamp_ns: Int64, receive_ns: Int64, *, received: bool = False) -> Clock:
    """The header stamps of a topic, or the times of the recorder where those are no UTC.

    `received` asks for the recorder's. Raises RecordingError where neither is UTC.
    """
    utc = is_utc(stamp_ns)
    if not received and np.count_nonzero(~utc) <= _TIMELESS_SHARE * len(utc):
        return Clock(np.where(utc, stamp_ns, 0), False)
    known = is_utc(receive_ns)
    if not known.any():
        stamped, heard = (int(times.max(initial=0)) for times in (stamp_ns, receive_ns))
        raise RecordingError(
            f"The times of {topic} are no UTC: its header stamps go up to {stamped} ns and the "
            f"recorder's up to {heard} ns, so its messages cannot be brought together with fixes; "
            "record with the clock set, or say with --epoch 2026-05-14T07:30:00Z when the clock of "
            "a simulation began."
        )
    return Clock(np.where(known, receive_ns, 0), True)


def ordered(time_ns: Int64) -> OrderedMessages:
    """Messages with these times (0 for none) in order, as a reader can have them that holds at
    most :data:`WINDOW`: what comes later than that is left out."""
    place = np.flatnonzero(time_ns > 0)
    timeless = len(time_ns) - len(place)
    times_ns = time_ns[place]
    if np.all(np.diff(times_ns) > 0):
        return OrderedMessages(times_ns, place.astype(np.int64), 0, timeless)
    items = list(zip(times_ns.tolist(), place.tolist(), strict=True))
    waiting = items[:WINDOW]
    heapq.heapify(waiting)
    released = [heapq.heappushpop(waiting, item) for item in items[WINDOW:]]
    columns = np.array(released + sorted(waiting), dtype=np.int64)
    is_later = columns[1:, 0] > np.maximum.accumulate(columns[:-1, 0])
    kept = columns[np.append(True, is_later)]
    return OrderedMessages(kept[:, 0], kept[:, 1], len(items) - len(kept), timeless)


def pair(left_ns: Int64, right_ns: Int64) -> tuple[Index, Index]:
    """Places of the moments of two cameras, increasing each, that are one: the nearest to each
    other within a quarter of the usual interval and :data:`MAX_APART_NS`."""
    if not (len(left_ns) and len(right_ns)):
        none = np.zeros(0, dtype=np.intp)
        return none, none
    usual = [np.median(np.diff(times)) / 4 for times in (left_ns, right_ns) if len(times) > 1]
    of_left, of_right = _nearest(left_ns, right_ns), _nearest(right_ns, left_ns)
    near = np.abs(right_ns[of_left] - left_ns) <= min([MAX_APART_NS, *usual])
    left = np.flatnonzero(near & (of_right[of_left] == np.arange(len(left_ns))))
    return left, of_left[left]


def _nearest(times_ns: Int64, others_ns: Int64) -> Index:
    """Places of the nearest of the others, the earlier of two that are as near."""
    return np.searchsorted(others_ns[1:] + others_ns[:-1], 2 * times_ns)
