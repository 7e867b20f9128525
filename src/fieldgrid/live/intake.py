"""How sources of a live session run: each in a thread of its own, begun again when it is lost."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from statistics import median_low
from typing import NamedTuple, Protocol

from fieldgrid.core import Closing, FieldgridError
from fieldgrid.geometry import Fix
from fieldgrid.live.results import What
from fieldgrid.live.session import Live
from fieldgrid.poses import explanation
from fieldgrid.recordings import Frame

JOIN_S = 6.0
"""Time for which a source is waited for at the end: a connection that is being made takes up to
5 s."""

CLOCKS_APART_S = 1.0
"""Stamps of images and fixes that come together are said to differ when they do by more: what a
receiver and a camera take until they tell is less."""

CLOCK_SAMPLES = 10


class Pauses(NamedTuple):
    """How long is waited, seconds: before a source that was lost is opened again, at first and at
    most; until one that is silent is told; until its link is opened again; until it is told that
    bytes come and no fix."""

    first_s: float = 0.5
    most_s: float = 10.0
    silent_s: float = 5.0
    dead_s: float = 15.0
    no_fix_s: float = 10.0


class SourceEndedError(Exception):
    """A source has come to its end; nothing more will come from it."""


class InputSource(Protocol):
    """Where fixes or frames come from."""

    @property
    def name(self) -> str:
        """What events call it."""

    def run(self, intake: Intake) -> None:
        """Open it and give what comes, until `intake.stop` is set. OSError or FieldgridError where
        it is lost, SourceEndedError at its end."""

    def finish(self, intake: Intake) -> None:
        """Give what is still open when it is not run any more."""


class Intake:
    """What one source has of the session: where to push, and what to tell. Rows and poses go to the
    session (`live`) itself."""

    def __init__(
        self,
        live: Live,
        source: InputSource,
        clocks: _Clocks,
        pauses: Pauses,
        stop: threading.Event,
    ) -> None:
        self.pauses, self.stop = pauses, stop
        self.live, self._source, self._clocks = live, source, clocks
        self._lost = ""
        self._pause_s = pauses.first_s

    def push_fix(self, fix: Fix) -> None:
        """Take a fix that came just now."""
        self.live.push_fix(fix)
        self._compare(self._clocks.fix(fix.time_ns))

    def push_frame(self, frame: Frame, *, wait: bool = False) -> None:
        """Take a frame that came just now."""
        self.live.push_frame(frame, wait=wait)
        self._compare(self._clocks.frame(frame.time_ns + self.live.rig.image_time_offset_ns))

    def _compare(self, problem: str) -> None:
        if problem:
            self.live.tell(What.INPUT, problem)

    def tell(self, text: str) -> None:
        """Say something about the source."""
        self.live.tell(What.INPUT, f"{self._source.name} {text}")

    def arrived(self) -> None:
        """Something came: the source is there."""
        self._pause_s = self.pauses.first_s
        if self._lost:
            self._lost = ""
            self.tell("is there again.")

    def keep_running(self) -> None:
        """Run the source until the end, again and again."""
        while not self.stop.is_set():
            try:
                self._source.run(self)
            except SourceEndedError as end:
                self.tell(str(end))
                break
            except Exception as error:  # noqa: BLE001 - no source ends the mapping
                if not self.stop.is_set():
                    self._is_lost(error)
        try:
            self._source.finish(self)
        except (OSError, FieldgridError) as error:
            self.tell(f"could not be finished: {error}")

    def _is_lost(self, error: Exception) -> None:
        known = isinstance(error, OSError | FieldgridError)
        why = (getattr(error, "strerror", None) or str(error)) if known else repr(error)
        if why != self._lost:
            self._lost = why
            self.tell(f"is not there ({why.removesuffix('.')}); it is tried again and again.")
        self.stop.wait(self._pause_s)
        self._pause_s = min(2.0 * self._pause_s, self.pauses.most_s)


class Sources(Closing):
    """Sources that push into a session until they are closed, which is to be done before the
    session ends. None of them stops the mapping or another."""

    def __init__(
        self, live: Live, sources: Sequence[InputSource], pauses: Pauses | None = None
    ) -> None:
        self._stop = threading.Event()
        clocks = _Clocks(live.rig.image_time_offset_ns / 1e9)
        self._threads = []
        for source in sources:
            intake = Intake(live, source, clocks, pauses or Pauses(), self._stop)
            run = threading.Thread(target=intake.keep_running, name="fieldgrid-source", daemon=True)
            self._threads.append(run)
        for thread in self._threads:
            thread.start()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until all sources have come to their end; False when that takes longer for one."""
        for thread in self._threads:
            thread.join(timeout_s)
        return not any(thread.is_alive() for thread in self._threads)

    def close(self) -> None:
        """Take nothing more."""
        self._stop.set()
        for thread in self._threads:
            thread.join(JOIN_S)


class _Clocks:
    """Compares the stamps of images and fixes that come at the same time.

    What comes late is stamped before it comes, so of a stamp less its time of arrival a part is the
    clock of whoever made it, and a part the way here. The time of arrival serves for this alone. It
    tells nothing of a recording that comes as fast as it is read.
    """

    def __init__(self, offset_s: float) -> None:
        self._offset_s = offset_s
        self._lock = threading.Lock()
        self._fixes: deque[float] = deque(maxlen=CLOCK_SAMPLES)
        self._frames: deque[float] = deque(maxlen=CLOCK_SAMPLES)
        self._told_s: float | None = None

    def fix(self, time_ns: int) -> str:
        """A fix came; what is to be told, mostly nothing."""
        return self._compare(self._fixes, time_ns)

    def frame(self, time_ns: int) -> str:
        """A frame came, by the receiver's clock; what is to be told, mostly nothing."""
        return self._compare(self._frames, time_ns)

    def _compare(self, stamps: deque[float], time_ns: int) -> str:
        with self._lock:
            stamps.append(time_ns / 1e9 - time.monotonic())
            if min(len(self._fixes), len(self._frames)) < CLOCK_SAMPLES:
                return ""
            both = self._fixes, self._frames
            if any(max(offsets) - min(offsets) > CLOCKS_APART_S for offsets in both):
                return ""
            apart_s = median_low(self._frames) - median_low(self._fixes)
            known_s = self._told_s or 0.0
            if abs(apart_s - known_s) <= CLOCKS_APART_S:
                return ""
            self._told_s = apart_s
        if abs(apart_s) <= CLOCKS_APART_S:
            return "Images and fixes that come together are stamped alike again."
        why = explanation(-apart_s, time_ns)
        return (
            f"Images are stamped {apart_s:+.1f} s against the fixes that come with them"
            f"{f' ({why})' if why else ''}, and nothing is moved by that; set the camera's clock, "
            f"or begin again with --time-offset {self._offset_s - apart_s:.1f}."
        )
