"""The frames of a bag: planned by the stamps of their topics, read as a stream.

Which message belongs to which frame is known before one is read. So an image is held only until
its partner comes, and what belongs to no frame is not held at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Int64, RecordingError
from fieldgrid.recordings.bag.order import WINDOW, clock, ordered, pair
from fieldgrid.recordings.bag.sensors.images import MessageSource
from fieldgrid.recordings.frames.frames import Frame
from fieldgrid.recordings.ros.bag import Bag
from fieldgrid.recordings.ros.model import Message

MOST_HELD = 2 * WINDOW
"""How many frames wait for what is missing of them at most."""

Taken = tuple[Message, int]
"""A message of a frame, and its time."""


class Plan(NamedTuple):
    """The frames [n]: of each of the `topics` [k] the time and the place among its messages of what
    a frame takes from it, [n, k], times increasing. `notes` are remarks, a sentence each."""

    topics: tuple[str, ...]
    message_ns: Int64
    places: Int64
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class BagFrames:
    """The frames of a bag (a `FrameSource`), of a `kind`: their messages are of these `roles` and
    read by these `sources`; `common` is what all frames have. Images stay in the bag; a frame holds
    the bytes of its own messages."""

    bag: Bag
    plan: Plan
    kind: Callable[..., Frame]
    roles: tuple[str, ...]
    sources: tuple[Callable[[Message, int], MessageSource], ...]
    common: tuple[Any, ...] = ()

    @property
    def times_ns(self) -> Int64:
        """Times of the frames, increasing."""
        return self.plan.message_ns[:, 0]

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Some of the frames, images undecoded; the bag is read from where they are."""
        plan = self.plan._replace(
            message_ns=self.plan.message_ns[start:stop], places=self.plan.places[start:stop]
        )
        for number, taken in enumerate(read_frames(self.bag, plan), start):
            yield self.frame(number, taken)

    def frame(self, number: int, taken: Sequence[Taken]) -> Frame:
        """The frame that is made of a message of each topic."""
        sources = [read(*one) for read, one in zip(self.sources, taken, strict=True)]
        return self.kind(f"{number:06d}", taken[0][1], *sources, *self.common)


def plan_frames(bag: Bag, *topics: str) -> Plan:
    """A frame for each message of a topic that has a time of its own, or for each pair of messages
    of two topics that are of one moment. Raises RecordingError without any."""
    stamps = {topic: bag.stamps(topic) for topic in topics}
    received = any(clock(topic, *times).received for topic, times in stamps.items())
    # Two clocks would not pair.
    clocks = [clock(topic, *times, received=received) for topic, times in stamps.items()]
    found = [ordered(one.time_ns) for one in clocks]
    notes = []
    for topic, one, messages in zip(topics, clocks, found, strict=True):
        told = {
            "the recorder's times are taken, since header stamps are no UTC; they are later by "
            "what a message takes": one.received,
            f"{messages.timeless} messages without a time skipped": messages.timeless,
            f"{messages.late} messages skipped that repeat a time or come after later ones": (
                messages.late
            ),
        }
        notes += [f"{topic}: {what}." for what, is_so in told.items() if is_so]
    counts = [len(messages.time_ns) for messages in found]
    rows = [np.arange(counts[0])]
    if len(topics) > 1:
        rows = [*pair(*(messages.time_ns for messages in found))]
    if not len(rows[0]):
        raise RecordingError(
            f"{bag.path}: no image of {topics[0]} ({counts[0]}) is of the moment of one of "
            f"{topics[1]} ({counts[1]}), to 10 ms; give the two topics of one stereo camera, "
            "and trigger both sides together."
            if len(topics) > 1
            else f"{bag.path}: {topics[0]} has no message with a time; record it again."
        )
    chosen = list(zip(found, rows, strict=True))
    message_ns = np.column_stack([messages.time_ns[row] for messages, row in chosen])
    places = np.column_stack([messages.place[row] for messages, row in chosen])
    apart_ns = np.ptp(message_ns, axis=1).max()
    if apart_ns:
        notes.append(f"Left and right are up to {apart_ns / 1e6:.3g} ms apart.")
    alone = [count - len(places) for count in counts]
    if any(alone):
        notes.append(f"{alone[0]} left and {alone[1]} right images without a partner skipped.")
    return Plan(topics, message_ns, places, tuple(notes))


def read_frames(bag: Bag, plan: Plan) -> Iterator[tuple[Taken, ...]]:
    """What the frames take, in order of time. A few messages of a topic are held at most.

    All topics are read in one pass as long as what belongs together lies together. Some programs
    write one topic after the other; then each is read by itself, at the cost of a pass for each.
    """
    if not len(plan.places):
        return
    done = 0
    numbers = range(len(plan.topics))
    for taken in _read_topics(bag, plan, numbers):
        yield taken
        done += 1
    if done < len(plan.places):
        streams = [_read_topics(bag, plan, [k]) for k in numbers]
        for parts in islice(zip(*streams, strict=True), done, None):
            yield tuple(taken for (taken,) in parts)
            done += 1
    if done < len(plan.places):
        raise RecordingError(
            f"{bag.path} has fewer messages of {' and '.join(plan.topics)} than when it was "
            "opened; leave it alone while it is read."
        )


def _read_topics(bag: Bag, plan: Plan, numbers: Sequence[int]) -> Iterator[tuple[Taken, ...]]:
    """What the frames take from some of the topics, until more than a few frames wait for what is
    missing of several topics."""
    topics = {plan.topics[k]: k for k in numbers}
    where = {k: bag.places(plan.topics[k]) for k in numbers}
    start = min(int(where[k][plan.places[:, k].min()]) for k in numbers)
    seen = {k: int(np.searchsorted(where[k], start)) for k in numbers}
    frames = {k: {place: n for n, place in enumerate(plan.places[:, k].tolist())} for k in numbers}
    waiting: dict[int, dict[int, Taken]] = {}
    done = 0
    for message in bag.messages(tuple(topics), start):
        k = topics[message.topic]
        frame = frames[k].get(seen[k])
        seen[k] += 1
        if frame is None:
            continue
        waiting.setdefault(frame, {})[k] = message, int(plan.message_ns[frame, k])
        while len(waiting.get(done, ())) == len(numbers):
            found = waiting.pop(done)
            yield tuple(found[k] for k in numbers)
            done += 1
        if done == len(plan.places) or (len(numbers) > 1 and len(waiting) > MOST_HELD):
            return
