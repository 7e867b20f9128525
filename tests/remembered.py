"""What a process has worked out before is not worked out again.

Matching a pair, finding its corners and smoothing a drive take most of the time of a build, and
hundreds of tests that are about something else do that with the same few images and logs of the
example. All of it depends on nothing but its arguments.
"""

from __future__ import annotations

import hashlib
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from fieldgrid import stereo
from fieldgrid.build import doubt, perception, staging
from fieldgrid.inspection import frame_pass
from fieldgrid.live import perceiver
from fieldgrid.mounting import frame_probe
from fieldgrid.odometry import features, step
from fieldgrid.pose import clock_search, drive
from fieldgrid.settings import StereoSettings
from fieldgrid.smoother import refine, smooth
from fieldgrid.vertical import vertical_shifts

KEPT_BYTES = 200 << 20

USES: tuple[tuple[Callable[..., Any], tuple[object, ...]], ...] = (
    (features, (doubt, frame_probe, frame_pass, perception, staging)),
    (step, (perceiver, perception)),
    (vertical_shifts, (doubt, frame_pass)),
    (smooth, (drive,)),
    (refine, (clock_search, drive)),
)
"""Functions that give the same for the same arguments, and the modules that call them."""

_make_matcher = stereo.make_matcher


class Memory:
    """Results by what they were worked out from, the oldest forgotten first; for all threads."""

    def __init__(self, most_bytes: int = KEPT_BYTES) -> None:
        self._most_bytes = most_bytes
        self._known: dict[bytes, bytes] = {}
        self._bytes = 0
        self._lock = threading.Lock()

    def of(self, work: Callable[..., Any], about: object, *arguments: Any, **named: Any) -> Any:
        """What `work` makes of its arguments, which with `about` tell all that it depends on.

        Each caller has a result of its own, to do with what it likes.
        """
        key = hashlib.sha256(pickle.dumps((about, arguments, named), 5)).digest()
        kept = self._known.get(key)
        if kept is None:
            kept = pickle.dumps(work(*arguments, **named), 5)
            with self._lock:
                self._bytes += len(kept) - len(self._known.pop(key, b""))
                self._known[key] = kept
                while self._bytes > self._most_bytes:
                    self._bytes -= len(self._known.pop(next(iter(self._known))))
        return pickle.loads(kept)

    def remembered(self, work: Callable[..., Any]) -> Callable[..., Any]:
        """The same function with this memory."""

        def recall(*arguments: Any, **named: Any) -> Any:
            return self.of(work, work.__qualname__, *arguments, **named)

        return recall


class Matcher:
    """What `stereo.make_matcher` makes, with a memory."""

    def __init__(self, memory: Memory, settings: StereoSettings, num_disparities: int) -> None:
        self._memory = memory
        self._about = "matcher", settings.model_dump_json(), num_disparities
        self._matcher = _make_matcher(settings, num_disparities)

    def compute(self, left: Any, right: Any) -> Any:
        return self._memory.of(self._matcher.compute, self._about, left, right)


MEMORY = Memory()
"""That of this process."""


@contextmanager
def worked_out_once(memory: Memory = MEMORY) -> Iterator[None]:
    """Within it, this process remembers; processes that it starts do not know."""

    def make_matcher(settings: StereoSettings, num_disparities: int) -> Matcher:
        return Matcher(memory, settings, num_disparities)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stereo, "make_matcher", make_matcher)
        for work, users in USES:
            for user in users:
                patch.setattr(user, work.__name__, memory.remembered(work))
        yield
