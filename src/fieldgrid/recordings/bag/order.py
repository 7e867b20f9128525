"""Times of messages put right: which clock, in which order, and what belongs to one moment."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
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


class PairMatch(NamedTuple):
    """Which of `left` belongs to which of `right`, both increasing; how far apart they are at
    most, and how many of either are left over."""

    left: Index
    right: Index
    apart_ns: int
    unpaired: tuple[int, int]


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
        raise RecordingError(
            f"The times of {topic} are no UTC: its header stamps are like "
            f"{_example(stamp_ns)} ns and the recorder's like {_example(receive_ns)} ns, so its "
            "messages cannot be brought together with fixes; record with the clock set, or say "
            "with --epoch 2026-05-14T07:30:00Z when the clock of a simulation began."
        )
    return Clock(np.where(known, receive_ns, 0), True)


def _example(time_ns: Int64) -> int:
    return int(time_ns[0]) if len(time_ns) else 0


def ordered(time_ns: Int64) -> OrderedMessages:
    """Messages with these times (0 for none) in order, as a reader can have them that holds at
    most :data:`WINDOW`: what comes later than that is left out."""
    place = np.flatnonzero(time_ns > 0)
    timeless = len(time_ns) - len(place)
    times_ns = time_ns[place]
    if np.all(np.diff(times_ns) > 0):
        return OrderedMessages(times_ns, place.astype(np.int64), 0, timeless)
    kept: list[tuple[int, int]] = []
    for first in _released(zip(times_ns.tolist(), place.tolist(), strict=True)):
        if not kept or first[0] > kept[-1][0]:
            kept.append(first)
    columns = np.array(kept, dtype=np.int64).reshape(-1, 2)
    return OrderedMessages(columns[:, 0], columns[:, 1], len(times_ns) - len(kept), timeless)


def _released(items: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Items in the order in which they leave a heap that holds a few."""
    waiting: list[tuple[int, int]] = []
    for item in items:
        heapq.heappush(waiting, item)
        if len(waiting) > WINDOW:
            yield heapq.heappop(waiting)
    yield from sorted(waiting)


def pair(left_ns: Int64, right_ns: Int64) -> PairMatch:
    """Moments of two cameras, increasing each, that are one: equal stamps first, then the
    nearest of the rest within a quarter of the usual interval and :data:`MAX_APART_NS`."""
    _, left, right = np.intersect1d(left_ns, right_ns, assume_unique=True, return_indices=True)
    rest_left = np.setdiff1d(np.arange(len(left_ns)), left)
    rest_right = np.setdiff1d(np.arange(len(right_ns)), right)
    usual = [np.median(np.diff(times)) / 4 for times in (left_ns, right_ns) if len(times) > 1]
    within_ns = int(min([MAX_APART_NS, *usual]))
    near = _nearest(left_ns[rest_left], right_ns[rest_right], within_ns)
    near_left, near_right = rest_left[near[0]], rest_right[near[1]]
    # Of the rest, two pairs cannot cross: each would be the nearer one of the other's partner. One
    # that crosses an equal pair is none.
    ahead = np.searchsorted(left, near_left) == np.searchsorted(right, near_right)
    left = np.sort(np.concatenate([left, near_left[ahead]]))
    right = np.sort(np.concatenate([right, near_right[ahead]]))
    apart = np.abs(left_ns[left] - right_ns[right])
    return PairMatch(
        left,
        right,
        int(apart.max()) if len(apart) else 0,
        (len(left_ns) - len(left), len(right_ns) - len(right)),
    )


def _nearest(left_ns: Int64, right_ns: Int64, within_ns: int) -> tuple[Index, Index]:
    """Places of the pairs that are the nearest to each other on either side."""
    if not (len(left_ns) and len(right_ns)):
        none = np.zeros(0, dtype=np.intp)
        return none, none
    of_left = _nearest_one(left_ns, right_ns)
    of_right = _nearest_one(right_ns, left_ns)
    here = np.arange(len(left_ns))
    mutual = (of_right[of_left] == here) & (np.abs(right_ns[of_left] - left_ns) <= within_ns)
    return here[mutual], of_left[mutual]


def _nearest_one(times_ns: Int64, others_ns: Int64) -> Index:
    after = np.clip(np.searchsorted(others_ns, times_ns), 0, len(others_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(times_ns - others_ns[before]) <= np.abs(others_ns[after] - times_ns)
    return np.where(is_before, before, after)
