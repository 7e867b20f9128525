"""Messages of several topics that are of one moment, as they come."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from fieldgrid.recordings import MAX_APART_NS, Taken

MOST_WAITING = 16
"""Messages of one topic that wait for the others of their moment; the oldest of more is left
out."""

Waiting = deque[Taken]


def together(parts: Sequence[Waiting]) -> Iterator[list[Taken]]:
    """The messages of one moment, one of each topic, out of those that wait."""
    while all(parts):
        first = min(parts, key=_time_ns)
        if max(map(_time_ns, parts)) - _time_ns(first) > MAX_APART_NS:
            first.popleft()
        else:
            yield [part.popleft() for part in parts]
    for part in parts:
        while len(part) > MOST_WAITING:
            part.popleft()


def _time_ns(part: Waiting) -> int:
    return part[0][1]
