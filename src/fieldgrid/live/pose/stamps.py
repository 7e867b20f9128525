"""Whether what a source says is stamped with the time of all else: clocks jump, one by one.

A stamp far ahead would make all else too old to count. It is refused while other sources go on at
the old time; when nothing speaks against it any more, the new time is followed.
"""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np

from fieldgrid.live.pose.sensor_rows import Rows

FIXES, FRAMES = "fixes", "frames"

OFF_S, FRAME_OFF_S = 10.0, 3.0
"""Stamps that are further ahead of all else are refused. Frames are by less, where other sources
speak: one that is taken makes all that are stamped before it too late."""

TIMES_OFF = 10
"""Number of fixes in a row of another time after which the clock of the receiver is followed."""

FOLLOWED_S = 1.5
"""Time after which another source is followed that goes on at another time, with nobody at the old
one."""

BLIND_S = 60.0
"""Fixes that are further behind another source count for no pose: it is that source that is off."""

SAID_AGAIN_S = 5.0
"""Time after which it is said again that something goes on being refused."""


class StampVerdict(NamedTuple):
    """What becomes of a word: empty, or why it is refused. `is_first` where it is to be told. Where
    the time was put back, what `lost` sources said after `back_ns` does not count any more."""

    why: str = ""
    is_first: bool = False
    lost: frozenset[str] = frozenset()
    back_ns: int = 0


class _AheadRun(NamedTuple):
    """Words of a source ahead of all else, with none of another source at the old time between."""

    words: int
    first_ns: int
    last_ns: int


class Stamps:
    """Judges stamps as they come; safe from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, int] = {}
        self._ahead: dict[str, _AheadRun] = {}
        self._told_ns: dict[str, int] = {}
        self._behind = self._below = self._latest_fix_ns = 0
        self._is_alone = False
        self.refuted = 0
        """How often it came out that frames ahead of all else were of another time."""

    def forget(self) -> None:
        """Begin anew: what comes next may be of any time."""
        with self._lock:
            self._newest.clear()
            self._start_over()

    def fix(self, time_ns: int) -> StampVerdict:
        """A fix."""
        with self._lock:
            if why := self._is_ahead(FIXES, time_ns, OFF_S):
                return why
            behind_s = (self._newest.get(FIXES, time_ns) - time_ns) / 1e9
            self._behind = self._behind + 1 if behind_s > OFF_S else 0
            if 0 < self._behind < TIMES_OFF:
                how = f"{behind_s:.0f} s behind the newest"
                return StampVerdict(
                    f"A fix is stamped {how}, so poses do without it.", self._behind == 1
                )
            judged = StampVerdict()
            if self._behind:
                judged = StampVerdict("", False, frozenset({FIXES}), time_ns)
                del self._newest[FIXES]
                self._behind = 0
            if astray := self._astray(time_ns):
                judged = StampVerdict("", False, astray, time_ns)
            self._accept(FIXES, time_ns)
            return judged

    def frame(self, time_ns: int) -> StampVerdict:
        """A frame, by the receiver's clock. One that is refused may turn out to be right, where
        what comes next is of its time, too: not once `refuted` has changed."""
        with self._lock:
            # Where nobody else has spoken since the latest, frames may be far apart.
            judged = self._is_ahead(FRAMES, time_ns, OFF_S if self._is_alone else FRAME_OFF_S)
            if judged is None:
                self._accept(FRAMES, time_ns)
            return judged or StampVerdict()

    def rows(self, part: str, rows: Rows) -> tuple[Rows | None, StampVerdict]:
        """Rows of a sensor in any order, of which those are left out that are refused."""
        times_ns = np.sort(rows.time_ns)
        with self._lock:
            newest_ns = max(self._newest.values(), default=int(times_ns[0]))
            before_ns = np.maximum(np.append(newest_ns, times_ns[:-1]), newest_ns)
            wide = np.flatnonzero(times_ns - before_ns > OFF_S * 1e9)
            if not len(wide):
                self._accept(part, int(times_ns[-1]))
                return rows, StampVerdict()
            since_ns = int(times_ns[wide[0]])
            if wide[0] > 0:
                self._accept(part, int(times_ns[wide[0] - 1]))
            judged = self._is_ahead(part, since_ns, OFF_S)
            if judged is None:
                self._accept(part, int(times_ns[-1]))
                return rows, StampVerdict()
            self._ahead[part] = self._ahead[part]._replace(last_ns=int(times_ns[-1]))
        taken = rows.time_ns < since_ns
        if not taken.any():
            return None, judged
        return rows.where(taken), judged

    def _astray(self, time_ns: int) -> frozenset[str]:
        """Sources that were followed to a time that fixes, which go on as they did, are not of."""
        is_on = time_ns >= self._latest_fix_ns  # not a receiver whose clock was put back
        self._latest_fix_ns = max(self._latest_fix_ns, time_ns)
        late_ns = time_ns + round(BLIND_S * 1e9)
        astray = frozenset(part for part, ns in self._newest.items() if is_on and ns > late_ns)
        self._below = self._below + 1 if astray else 0
        if self._below < TIMES_OFF:
            return frozenset()
        for part in astray:
            del self._newest[part]
        return astray

    def _is_ahead(self, source: str, time_ns: int, off_s: float) -> StampVerdict | None:
        """Why a word is refused that is ahead of all else; None where it is not, or not any more:
        then all that was said before is of another time."""
        newest_ns = max(self._newest.values(), default=time_ns)
        ahead_s = (time_ns - newest_ns) / 1e9
        if ahead_s <= off_s:
            return None
        run = self._ahead.get(source)
        if run is None or time_ns < run.first_ns:
            run = _AheadRun(0, time_ns, time_ns)
        run = self._ahead[source] = _AheadRun(
            run.words + 1, run.first_ns, max(time_ns, run.last_ns)
        )
        if self._is_followed(source, run, newest_ns):
            self._newest.clear()
            self._start_over()
            return None
        is_first = newest_ns - self._told_ns.get(source, 0) > SAID_AGAIN_S * 1e9
        if is_first:
            self._told_ns[source] = newest_ns
        how = f"stamped {ahead_s:.0f} s ahead of all else"
        return StampVerdict(
            {
                FIXES: f"A fix is {how}, so poses do without it.",
                FRAMES: f"is {how}",
            }.get(source, f"Rows of {source} are {how}, so poses do without them."),
            is_first,
        )

    def _is_followed(self, source: str, run: _AheadRun, newest_ns: int) -> bool:
        """Whether a source that runs ahead has the time of all that still speak."""
        alive = {
            other
            for other, ns in self._newest.items()
            if other != source and ns >= newest_ns - OFF_S * 1e9
        }
        ahead = [self._ahead.get(other) for other in alive]
        agree = [
            other is not None and abs(other.last_ns - run.last_ns) <= OFF_S * 1e9 for other in ahead
        ]
        if alive and all(agree):
            return True
        if source == FIXES:
            return run.words >= TIMES_OFF
        return (run.last_ns - run.first_ns) / 1e9 >= FOLLOWED_S

    def _accept(self, source: str, time_ns: int) -> None:
        """A word of the old time, which speaks against all that is ahead of it."""
        self._newest[source] = max(time_ns, self._newest.get(source, time_ns))
        frames = self._ahead.get(FRAMES)
        if frames is not None and time_ns < frames.first_ns - FRAME_OFF_S * 1e9:
            self.refuted += 1
        self._ahead.clear()
        self._is_alone = source == FRAMES

    def _start_over(self) -> None:
        self._ahead.clear()
        self._told_ns.clear()
        self._behind = self._below = self._latest_fix_ns = 0
