"""The frames of a bag: planned by the stamps of their topics, read as a stream.

Which message belongs to which frame is known before one is read. So an image is held only until
its partner comes, and what belongs to no frame is not held at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice
from typing import ClassVar, NamedTuple

import numpy as np

from fieldgrid.core import Int64, RecordingError
from fieldgrid.recordings.bag.order import WINDOW, Clock, OrderedMessages, clock, ordered, pair
from fieldgrid.recordings.bag.sensors.clouds import MessageCloud
from fieldgrid.recordings.bag.sensors.images import (
    CompressedImage,
    DepthImage,
    DisparityImage,
    RawImage,
)
from fieldgrid.recordings.bag.sensors.packed_depth import PackedDepthImage
from fieldgrid.recordings.frames.frames import (
    CloudFrame,
    DepthFrame,
    Frame,
    PairRectifier,
    StereoFrame,
)
from fieldgrid.recordings.ros.bag import Bag
from fieldgrid.recordings.ros.model import Message

MOST_HELD = 2 * WINDOW
"""How many frames wait for what is missing of them at most."""


class Plan(NamedTuple):
    """The frames: their times, increasing, and for each topic the time and the place among its
    messages of what a frame takes from it. `notes` are remarks, a sentence each."""

    time_ns: Int64
    topics: tuple[str, ...]
    message_ns: tuple[Int64, ...]
    places: tuple[Int64, ...]
    notes: tuple[str, ...]

    def part(self, start: int, stop: int) -> Plan:
        """The plan of some of the frames."""
        chosen = slice(start, stop)
        return self._replace(
            time_ns=self.time_ns[chosen],
            message_ns=tuple(times[chosen] for times in self.message_ns),
            places=tuple(places[chosen] for places in self.places),
        )


class Taken(NamedTuple):
    """A message of a frame, and its time."""

    message: Message
    time_ns: int


@dataclass(frozen=True, slots=True)
class PairMaker:
    """Makes pairs for a calibration of `size_px`; of 16 bits the cameras fill the lower `bits`."""

    roles: ClassVar[tuple[str, ...]] = ("left", "right")
    size_px: tuple[int, int]
    rectifier: PairRectifier | None
    compressed: tuple[bool, ...]
    bits: int

    def frame(self, number: int, time_ns: int, taken: tuple[Taken, ...]) -> Frame:
        """The pair, its images undecoded."""
        left, right = (
            CompressedImage(*one) if packed else RawImage(*one, self.bits)
            for one, packed in zip(taken, self.compressed, strict=True)
        )
        return StereoFrame(f"{number:06d}", time_ns, left, right, self.size_px, self.rectifier)


@dataclass(frozen=True, slots=True)
class DepthMaker:
    """Makes images of depths of messages that `kind` reads."""

    roles: ClassVar[tuple[str, ...]] = ("depth",)
    kind: Callable[[Message, int], DepthImage | DisparityImage | PackedDepthImage]
    size_px: tuple[int, int]

    def frame(self, number: int, time_ns: int, taken: tuple[Taken, ...]) -> Frame:
        """The image of depths, undecoded."""
        return DepthFrame(f"{number:06d}", time_ns, self.kind(*taken[0]), self.size_px)


@dataclass(frozen=True, slots=True)
class CloudMaker:
    """Makes clouds whose axes `R`, by row, turns into right, down, forward; `corrected` are those
    whose points were carried to one instant already."""

    roles: ClassVar[tuple[str, ...]] = ("cloud",)
    R: tuple[float, ...]
    corrected: bool = False

    def frame(self, number: int, time_ns: int, taken: tuple[Taken, ...]) -> Frame:
        """The cloud, undecoded."""
        return CloudFrame(f"{number:06d}", time_ns, MessageCloud(*taken[0], self.R, self.corrected))


FrameMaker = PairMaker | DepthMaker | CloudMaker
"""How the frames of a bag are made of their messages; it can be pickled."""


@dataclass(frozen=True, slots=True)
class BagFrames:
    """The frames of a bag (a `FrameSource`). Images stay in the
    bag; a frame holds the bytes of its own messages."""

    bag: Bag
    plan: Plan
    maker: FrameMaker

    @property
    def times_ns(self) -> Int64:
        """Times of the frames, increasing."""
        return self.plan.time_ns

    @property
    def roles(self) -> tuple[str, ...]:
        """What the messages of a frame are."""
        return self.maker.roles

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Some of the frames, images undecoded; the bag is read from where they are."""
        plan = self.plan.part(start, stop)
        times_ns = plan.time_ns.tolist()
        for k, taken in enumerate(read_frames(self.bag, plan)):
            yield self.maker.frame(start + k, times_ns[k], taken)


def plan_single(bag: Bag, topic: str) -> Plan:
    """A frame for each message of a topic that has a time of its own."""
    times = clock(topic, *bag.stamps(topic))
    found = ordered(times.time_ns)
    if not len(found.time_ns):
        raise RecordingError(f"{bag.path}: {topic} has no message with a time; record it again.")
    notes = _notes(topic, times, found)
    return Plan(found.time_ns, (topic,), (found.time_ns,), (found.place,), tuple(notes))


def plan_pairs(bag: Bag, left: str, right: str) -> Plan:
    """A frame for each pair of messages of one moment. Raises RecordingError without any."""
    stamps = {topic: bag.stamps(topic) for topic in (left, right)}
    clocks = {topic: clock(topic, *stamps[topic]) for topic in (left, right)}
    if any(one.received for one in clocks.values()):  # two clocks would not pair
        clocks = {topic: clock(topic, *stamps[topic], received=True) for topic in (left, right)}
    first, second = (ordered(clocks[topic].time_ns) for topic in (left, right))
    notes = _notes(left, clocks[left], first) + _notes(right, clocks[right], second)
    of_left, of_right = pair(first.time_ns, second.time_ns)
    if not len(of_left):
        raise RecordingError(
            f"{bag.path}: no image of {left} ({len(first.time_ns)}) is of the moment of one of "
            f"{right} ({len(second.time_ns)}), to 10 ms; give the two topics of one stereo camera, "
            "and trigger both sides together."
        )
    left_ns, right_ns = first.time_ns[of_left], second.time_ns[of_right]
    apart_ns = np.abs(left_ns - right_ns).max()
    if apart_ns:
        notes.append(f"Left and right are up to {apart_ns / 1e6:.3g} ms apart.")
    alone = [len(first.time_ns) - len(of_left), len(second.time_ns) - len(of_left)]
    if any(alone):
        notes.append(f"{alone[0]} left and {alone[1]} right images without a partner skipped.")
    places = first.place[of_left], second.place[of_right]
    return Plan(left_ns, (left, right), (left_ns, right_ns), places, tuple(notes))


def _notes(topic: str, times: Clock, found: OrderedMessages) -> list[str]:
    told = (
        (
            times.received,
            "the recorder's times are taken, since header stamps are no UTC; they are later by "
            "what a message takes",
        ),
        (found.timeless, f"{found.timeless} messages without a time skipped"),
        (found.late, f"{found.late} messages skipped that repeat a time or come after later ones"),
    )
    return [f"{topic}: {what}." for is_so, what in told if is_so]


def read_frames(bag: Bag, plan: Plan) -> Iterator[tuple[Taken, ...]]:
    """What the frames take, in order of time. A few messages of a topic are held at most.

    All topics are read in one pass as long as what belongs together lies together. Some programs
    write one topic after the other; then each is read by itself, at the cost of a pass for each.
    """
    if not len(plan.time_ns):
        return
    done = 0
    for taken in _read_topics(bag, plan, range(len(plan.topics))):
        yield taken
        done += 1
    if done < len(plan.time_ns):
        streams = [_read_topics(bag, plan, [k]) for k in range(len(plan.topics))]
        for parts in islice(zip(*streams, strict=True), done, None):
            yield tuple(taken for (taken,) in parts)
            done += 1
    if done < len(plan.time_ns):
        raise RecordingError(
            f"{bag.path} has fewer messages of {' and '.join(plan.topics)} than when it was "
            "opened; leave it alone while it is read."
        )


def _read_topics(bag: Bag, plan: Plan, numbers: Sequence[int]) -> Iterator[tuple[Taken, ...]]:
    """What the frames take from some of the topics, until more than a few frames wait for what is
    missing of several topics."""
    where = {k: bag.places(plan.topics[k]) for k in numbers}
    start = min(int(where[k][plan.places[k].min()]) for k in numbers)
    of_topic = {plan.topics[k]: k for k in numbers}
    seen = {k: int(np.searchsorted(where[k], start)) for k in numbers}
    frames = {k: dict(zip(plan.places[k].tolist(), count())) for k in numbers}
    waiting: dict[int, dict[int, Taken]] = {}
    done = 0
    for message in bag.messages(tuple(of_topic), start):
        k = of_topic[message.topic]
        frame = frames[k].get(seen[k])
        seen[k] += 1
        if frame is None:
            continue
        taken = Taken(message, int(plan.message_ns[k][frame]))
        waiting.setdefault(frame, {})[k] = taken
        while len(waiting.get(done, ())) == len(numbers):
            found = waiting.pop(done)
            yield tuple(found[k] for k in numbers)
            done += 1
        if done == len(plan.time_ns) or (len(numbers) > 1 and len(waiting) > MOST_HELD):
            return
