"""What sentences say about one time of day, put together into fixes.

Sentences of one epoch arrive in any order, and some of them late; those without a time of their
own belong to the epoch before them. An epoch is closed when enough later ones have begun.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from fieldgrid.geometry import Fix
from fieldgrid.poses.gnss.fields import number, of_day_ns
from fieldgrid.poses.gnss.nmea_statements import (
    GroundVelocity,
    Heading,
    Position,
    rmc_position,
    vtg_motion,
)


@dataclass(slots=True)
class NmeaCounts:
    """What was found in a stream of sentences so far.

    `sentences` counts the intact ones of any kind, `bad_checksum` the complete ones whose
    checksum is wrong, `broken` those that are cut, merged, or say nothing that can be.
    `no_position` counts sentences that say so where a position is due, `repeated` those of an
    epoch that has its position already, `no_geoid` fixes whose height lacks the geoid
    separation, `no_height` fixes that have no height at all, for which 0 stands. `undated`
    counts positions that wait for a date, or have waited in vain.
    """

    sentences: int = 0
    bad_checksum: int = 0
    broken: int = 0
    no_position: int = 0
    repeated: int = 0
    no_geoid: int = 0
    no_height: int = 0
    undated: int = 0


# Dates for fixes that know only the time of day.


DAY_NS = 86_400_000_000_000


class Calendar:
    """Dates fixes that come in the order of a log.

    A date holds until the next, across midnight, and serves the fixes before the first one,
    which wait for it: at most `max_waiting` do. With a `first_day` none has to wait.
    """

    def __init__(self, max_waiting: int, counts: NmeaCounts, first_day: int | None) -> None:
        self._counts = counts
        self._max_waiting = max_waiting
        self._waiting: deque[tuple[int, Fix]] = deque()
        self._last_ns: int | None = None
        self._day = 0  # since the first epoch, from the times of day alone
        self._shift = first_day  # from these to days since 1970

    def take(self, of_day_ns: int, unix_day: int | None, fix: Fix | None) -> list[Fix]:
        """The next epoch, whose fix has the time of day. Gives the fixes that have a date now."""
        # Half a day back is the next day. Nearly a whole day ahead is a straggler from before
        # midnight; less than that is a logger that was switched off.
        if self._last_ns is not None:
            ahead_ns = of_day_ns - self._last_ns
            self._day += (ahead_ns < -DAY_NS // 2) - (ahead_ns > 23 * DAY_NS // 24)
        self._last_ns = of_day_ns
        dated: list[Fix] = []
        if unix_day is not None:
            self._shift = unix_day - self._day
            dated = [_dated(early, day + self._shift) for day, early in self._waiting]
            self._counts.undated -= len(self._waiting)
            self._waiting.clear()
        if fix is None:
            return dated
        if self._shift is None:
            if len(self._waiting) >= self._max_waiting:
                self._waiting.popleft()
            self._counts.undated += 1
            self._waiting.append((self._day, fix))
        else:
            dated.append(_dated(fix, self._day + self._shift))
        return dated


def _dated(fix: Fix, unix_day: int) -> Fix:
    return Fix(unix_day * DAY_NS + fix.time_ns, *fix[1:])


_RMC_EPOCHS = 20  # a receiver that writes RMC at 20 Hz may write GGA at 1 Hz
_UNKNOWN_HEADING = Heading(-1, None)


@dataclass(slots=True)
class Epoch:
    """What the sentences of one time of day have said so far."""

    raw_time: bytes
    of_day_ns: int
    unix_day: int | None = None
    position: Position | None = None
    refused: int = -1  # the best source that has said that there is no position
    heading: Heading = _UNKNOWN_HEADING
    motion: GroundVelocity | None = None
    sigma_m: float | None = None
    solution: bytes = b""  # GSA's fix mode: 1 none, 2 flat, 3 with height
    # Fields that are read when the epoch is closed, if they are needed at all.
    vtg: list[bytes] | None = None
    rmc: list[bytes] | None = None
    gsa_hdop: bytes = b""


class EpochLog:
    """Collects epochs from sentences, and makes fixes of those that are closed.

    `current` is the epoch that untimed sentences belong to.
    """

    def __init__(self, late_epochs: int, calendar: Calendar, counts: NmeaCounts) -> None:
        self.counts = counts
        self._calendar = calendar
        self.current: Epoch | None = None
        self._late_epochs = late_epochs
        self._open: deque[Epoch] = deque()
        self._undecided: list[Epoch] = []
        self._better_than_rmc = self._rmc_suffices = False
        self._fixes: list[Fix] = []

    def at(self, raw_time: bytes) -> Epoch:
        """The epoch of a time of day `hhmmss.sss`: a recent one, or a new one."""
        current = self.current
        if current is not None and current.raw_time == raw_time:
            return current
        return self._at_ns(of_day_ns(raw_time), raw_time)

    def at_utc(self, unix_ns: int) -> Epoch:
        """The epoch of a full UTC time, nanoseconds since 1970, which also dates it."""
        day, of_day = divmod(unix_ns, DAY_NS)
        epoch = self._at_ns(of_day, b"")
        if epoch.unix_day is None:
            epoch.unix_day = day
        return epoch

    def place(self, epoch: Epoch, position: Position) -> None:
        """A position of an epoch: that of the best source is kept, the first of its kind."""
        self._better_than_rmc = True
        held = epoch.position
        if held is None or position.source > held.source:
            epoch.position = position
        elif position.source == held.source:
            self.counts.repeated += 1

    def refuse(self, epoch: Epoch | None, source: int) -> None:
        """A source says that it has no position, and no lesser source may have one then."""
        self._better_than_rmc = True
        self.counts.no_position += 1
        # Untimed sentences that follow must not be taken for the epoch before.
        self.current = epoch
        if epoch is not None:
            epoch.refused = max(epoch.refused, source)

    def fixes(self) -> list[Fix]:
        """The fixes of the epochs closed since the last call, as far as they have a date."""
        fixes, self._fixes = self._fixes, []
        return fixes

    def finish(self) -> None:
        """Close the epochs that are still open."""
        while self._open:
            self._close(self._open.popleft())
        self._decide()
        self.current = None

    def _at_ns(self, of_day_ns: int, raw_time: bytes) -> Epoch:
        for epoch in reversed(self._open):
            if epoch.of_day_ns == of_day_ns:
                self.current = epoch
                return epoch
        epoch = self.current = Epoch(raw_time, of_day_ns)
        self._open.append(epoch)
        if len(self._open) > self._late_epochs:
            self._close(self._open.popleft())
        return epoch

    def _close(self, epoch: Epoch) -> None:
        # A log of RMC alone has its positions there. In any other they are a coarse second copy
        # that must not stand in for a lost GGA, so the first ones wait until it is clear.
        if self._better_than_rmc or self._rmc_suffices:
            self._decide()
            self._date(epoch)
        elif epoch.rmc is not None or self._undecided:
            self._undecided.append(epoch)
            if len(self._undecided) >= _RMC_EPOCHS:
                self._decide()
        else:
            self._date(epoch)

    def _decide(self) -> None:
        if self._undecided:
            self._rmc_suffices = not self._better_than_rmc
            undecided, self._undecided = self._undecided, []
            for epoch in undecided:
                self._date(epoch)

    def _date(self, epoch: Epoch) -> None:
        position = self._position(epoch)
        fix = None if position is None else self._fix(epoch, position)
        self._fixes += self._calendar.take(epoch.of_day_ns, epoch.unix_day, fix)

    def _position(self, epoch: Epoch) -> Position | None:
        position = epoch.position
        try:
            if position is None and epoch.rmc is not None and not self._better_than_rmc:
                position = rmc_position(epoch.rmc)
        except ValueError:
            self.counts.broken += 1
        if position is None or position.source < epoch.refused:
            return None
        if epoch.solution == b"1":
            self.counts.no_position += 1
            return None
        return position

    def _fix(self, epoch: Epoch, position: Position) -> Fix:
        """The fix of an epoch; its time is still that of the day."""
        motion, heading = self._motion(epoch), epoch.heading
        self.counts.no_geoid += not position.has_geoid
        self.counts.no_height += position.height_m is None
        return Fix(
            epoch.of_day_ns,
            position.lat_deg,
            position.lon_deg,
            position.height_m or 0.0,
            position.quality,
            position.satellites,
            self._gsa_hdop(epoch) if position.hdop is None else position.hdop,
            position.age_s,
            position.sigma_m if epoch.sigma_m is None else epoch.sigma_m,
            motion.speed_mps,
            heading.deg,
            None if heading.deg is None else heading.sigma_deg,
            None if heading.deg is None else heading.quality,
            motion.course_deg,
            *((None, None, None) if heading.deg is None else heading[4:]),
        )

    def _motion(self, epoch: Epoch) -> GroundVelocity:
        motion = epoch.motion
        if epoch.vtg is None or (motion is not None and None not in motion):
            return motion or GroundVelocity()
        try:
            vtg = vtg_motion(epoch.vtg)
        except ValueError:
            self.counts.broken += 1
            return motion or GroundVelocity()
        if motion is None or motion.speed_mps is None:
            return vtg
        return GroundVelocity(motion.speed_mps, vtg.course_deg)

    def _gsa_hdop(self, epoch: Epoch) -> float | None:
        try:
            return number(epoch.gsa_hdop)
        except ValueError:
            self.counts.broken += 1
            return None
