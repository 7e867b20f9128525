"""Dates for fixes that know only the time of day."""

from __future__ import annotations

from collections import deque

from fieldgrid.fixes import Fix

DAY_NS = 86_400_000_000_000


class Calendar:
    """Dates fixes that come in the order of a log.

    A date holds until the next, across midnight, and serves the fixes before the first one,
    which wait for it: at most `max_waiting` do, and `lost` counts those that waited in vain.
    """

    def __init__(self, max_waiting: int) -> None:
        self.lost = 0
        self._max_waiting = max_waiting
        self._waiting: deque[tuple[int, Fix]] = deque()
        self._last_ns: int | None = None
        self._day = 0  # since the first epoch, from the times of day alone
        self._shift: int | None = None  # from these to days since 1970

    @property
    def waiting(self) -> int:
        """How many fixes wait for a date."""
        return len(self._waiting)

    def take(self, of_day_ns: int, unix_day: int | None, fix: Fix | None) -> list[Fix]:
        """The next epoch, whose fix has the time of day. Gives the fixes that have a date now."""
        self._count_day(of_day_ns)
        dated: list[Fix] = []
        if unix_day is not None:
            self._shift = unix_day - self._day
            dated = [_dated(early, day + self._shift) for day, early in self._waiting]
            self._waiting.clear()
        if fix is None:
            return dated
        if self._shift is None:
            self._wait(fix)
        else:
            dated.append(_dated(fix, self._day + self._shift))
        return dated

    def _count_day(self, now_ns: int) -> None:
        # Half a day back is the next day. Nearly a whole day ahead is a straggler from before
        # midnight; less than that is a logger that was switched off.
        if self._last_ns is not None:
            ahead_ns = now_ns - self._last_ns
            self._day += (ahead_ns < -DAY_NS // 2) - (ahead_ns > 23 * DAY_NS // 24)
        self._last_ns = now_ns

    def _wait(self, fix: Fix) -> None:
        if len(self._waiting) >= self._max_waiting:
            self._waiting.popleft()
            self.lost += 1
        self._waiting.append((self._day, fix))


def _dated(fix: Fix, unix_day: int) -> Fix:
    return Fix(unix_day * DAY_NS + fix.time_ns, *fix[1:])
