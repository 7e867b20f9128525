"""Transforms on the topics of a bag: the tree of those that never change, and the way of the
vehicle by those that do."""

from __future__ import annotations

import re
from array import array
from typing import Any

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import WheelSpeed
from fieldgrid.recordings.bag.listeners import TopicListener
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import stream_frame
from fieldgrid.recordings.bag.transforms import Transforms, place_of, told
from fieldgrid.recordings.ros.bag import Bag

_MOST_TREES = 10_000
_ALL_OF_FIRST, _THEN_EVERY = 200, 50

CHORD_NS, LONGEST_NS = 100_000_000, 1_000_000_000
"""The speed is told over so long a way: over less, the digits of a transform make noise. Over a
longer one than the second, nothing is told."""

JUMP_MPS = 30.0
"""Faster is no vehicle: what finds its place in a map again moves its frame at once."""

_BASE = re.compile(r"(?:.*/)?base_(?:footprint|link)")
_WORLD = {"odom": 0, "map": 1, "world": 2}
"""Frames in which a vehicle moves, the smoothest first."""


class Trees(TopicListener):
    """Static transforms."""

    def __init__(self, name: str, type_: str) -> None:
        super().__init__(name, type_)
        self.transforms = Transforms()

    def _wants(self, place: int) -> bool:
        return place < _MOST_TREES

    def _add(self, message: Any, place: int) -> None:
        self.transforms.add(message)


class StreamPlace(Trees):
    """The place of a stream on a topic of RealSense's recorder, which ends in the number of what it
    is seen from."""

    def _add(self, message: Any, place: int) -> None:
        at = place_of(message)
        if at is not None:
            self.transforms.put(stream_frame(self.name), self.name.rpartition("/")[2], at)


class MovingTrees(Trees):
    """Transforms on /tf: the way of the vehicle, as long as nothing else tells it (`is_whole`), and
    those that never change, which some robots publish there, too."""

    is_whole = True

    def __init__(self, name: str, type_: str) -> None:
        super().__init__(name, type_)
        self._ways: dict[tuple[str, str], tuple[array[int], array[float]]] = {}

    def _wants(self, place: int) -> bool:
        return self.is_whole or _is_sample(place)

    def _add(self, message: Any, place: int) -> None:
        if _is_sample(place):
            self.transforms.add(message)
        for one, child, parent, at in told(message):
            if parent.rpartition("/")[2] in _WORLD and _BASE.fullmatch(child):
                stamp = one.header.stamp
                times, values = self._ways.setdefault((parent, child), (array("q"), array("d")))
                times.extend((place, stamp.sec * 1_000_000_000 + stamp.nanosec))
                values.extend((*at.at_m, *at.R[:, 0]))

    def speed(self, bag: Bag, *, is_mapped: bool) -> tuple[str, WheelSpeed] | None:
        """Whose speed the transforms tell, and in which frame, and that speed: in `odom`, which has
        no jumps, before others. None where there is none, or of several vehicles, or not all was
        heard. In a `map` that lies on the globe (`is_mapped`) it was found by the fixes, and says
        nothing beside them."""
        moving = [
            (_WORLD[parent.rpartition("/")[2]], parent, child)
            for (parent, child), (_, values) in self._ways.items()
            if np.ptp(np.array(values).reshape(-1, 6)[:, :3], axis=0).max() > 0.0  # at two places
        ]
        moving = [one for one in moving if not (is_mapped and one[0] == _WORLD["map"])]
        found = [one for one in moving if one[0] == min(moving)[0]]
        if not self.is_whole or len(found) != 1:
            return None
        _, parent, child = found[0]
        times, values = self._ways[parent, child]
        place, stamp_ns = np.array(times, dtype=np.int64).reshape(-1, 2).T
        time_ns = clock(self.name, bag.dated(stamp_ns), bag.stamps(self.name)[1][place]).time_ns
        columns = np.array(values, dtype=np.float64).reshape(-1, 6)[time_ns > 0]
        told_ns, speed_mps = forward_speeds(time_ns[time_ns > 0], columns[:, :3], columns[:, 3:])
        return f"{child} in {parent}", WheelSpeed(told_ns, speed_mps)


def forward_speeds(time_ns: Int64, at_m: Float64, forward: Float64) -> tuple[Int64, Float64]:
    """Times in the middle of chords of a tenth of a second, and the speed along the vehicle's x
    axis on each, negative in reverse, by its places [n, 3] and the directions of that axis [n, 3].
    """
    order = np.unique(time_ns, return_index=True)[1]
    time_ns, at_m, forward = time_ns[order], at_m[order], forward[order]
    knots = [0]
    while knots[-1] < len(time_ns) - 1:  # a stamp may be a little early
        later = np.searchsorted(time_ns, time_ns[knots[-1]] + CHORD_NS - CHORD_NS // 20)
        knots.append(min(int(later), len(time_ns) - 1))
    first, last = np.array(knots[:-1], dtype=np.intp), np.array(knots[1:], dtype=np.intp)
    took_ns = time_ns[last] - time_ns[first]
    ahead = forward[first] + forward[last]
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)[:, None]
    speed_mps = np.einsum("ni,ni->n", ahead, at_m[last] - at_m[first]) / (took_ns / 1e9)
    told_here = (took_ns <= LONGEST_NS) & (np.abs(speed_mps) < JUMP_MPS)
    return (time_ns[first] + took_ns // 2)[told_here], speed_mps[told_here]


def _is_sample(place: int) -> bool:
    return place < _ALL_OF_FIRST or (place < _MOST_TREES and place % _THEN_EVERY == 0)
