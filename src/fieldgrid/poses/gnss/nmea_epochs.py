"""What sentences say about one time of day, put together into fixes.

Sentences of one epoch arrive in any order, and some of them late; those without a time of their
own belong to the epoch before them. An epoch is closed when enough later ones have begun.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from fieldgrid.geometry import Fix
from fieldgrid.poses.gnss.fields import DAY_NS, StreamCounts, UnsaidError
from fieldgrid.poses.gnss.nmea_sentences import (
    COARSE,
    FALLBACK,
    HEADING,
    MOTION,
    POSITION,
    SIGMA,
    SOLUTION,
    Sentence,
)


@dataclass(slots=True)
class NmeaCounts(StreamCounts):
    """Of a stream of sentences.

    `sentences` counts the intact ones of any kind; those that are cut or merged are broken, too.
    `no_geoid` counts fixes whose height lacks the geoid separation, `no_height` fixes that have no
    height at all, for which 0 stands. `undated` counts positions that wait for a date, or have
    waited in vain.
    """

    sentences: int = 0
    no_geoid: int = 0
    no_height: int = 0
    undated: int = 0


_RMC_EPOCHS = 20  # a receiver that writes RMC at 20 Hz may write GGA at 1 Hz


@dataclass(slots=True)
class Epoch:
    """What the sentences of one time of day have said so far: of each subject the trust in the most
    trusted statement, and its fields of the fix, None where it denies them."""

    of_day_ns: int
    unix_day: int | None
    said: dict[str, tuple[int, dict[str, Any] | None]]


class EpochLog:
    """Collects epochs from sentences, and makes fixes of those that are closed.

    A date holds until the next, across midnight, and serves the fixes before the first one, which
    wait for it: at most `max_undated` do. With a `first_day` none has to wait.
    """

    def __init__(
        self, late_epochs: int, max_undated: int, first_day: int | None, counts: NmeaCounts
    ) -> None:
        self.counts = counts
        self._late_epochs = late_epochs
        self._current: Epoch | None = None  # the one that untimed sentences belong to
        self._open: dict[int, Epoch] = {}  # by their time, the oldest first
        self._undecided: list[Epoch] = []
        self._better_than_rmc = self._rmc_suffices = False
        self._last_ns: int | None = None
        self._day = 0  # since the first epoch, from the times of day alone
        self._shift = first_day  # from these to days since 1970
        self._waiting: deque[Fix] = deque(maxlen=max_undated)
        self._fixes: list[Fix] = []

    def hear(self, sentence: Sentence, fields: list[bytes]) -> None:
        """Take in a sentence. ValueError for one that says what cannot be."""
        moment, says = sentence
        unix_day = None
        if moment is not None:
            try:
                of_day_ns, unix_day = moment(fields)
                self._current = self._at(of_day_ns)
            except UnsaidError:
                if all(subject is not POSITION for subject, _ in says):
                    return
                # Untimed sentences that follow must not be taken for the epoch before.
                self._current = None
                self.counts.no_position += 1
        epoch = self._current
        if epoch is None:
            return
        said = epoch.said
        for (subject, trust), read in says.items():
            if subject is COARSE and self._better_than_rmc:
                continue
            try:
                stated = read(fields)
            except UnsaidError:
                stated = None
                self.counts.no_position += subject is POSITION
            held = said.get(subject)
            if held is None or (trust, stated is not None) > (held[0], held[1] is not None):
                said[subject] = trust, stated
            elif subject is POSITION:
                self.counts.repeated += stated is not None and trust == held[0]
            if subject is POSITION:
                self._better_than_rmc = True
        epoch.unix_day = unix_day if epoch.unix_day is None else epoch.unix_day

    def fixes(self) -> list[Fix]:
        """The fixes of the epochs closed since the last call, as far as they have a date."""
        fixes, self._fixes = self._fixes, []
        return fixes

    def finish(self) -> None:
        """Close the epochs that are still open."""
        while self._open:
            self._close_oldest()
        self._decide()
        self._current = None

    def _at(self, of_day_ns: int) -> Epoch:
        """The epoch of a time of day: a recent one, or a new one."""
        epoch = self._open.get(of_day_ns)
        if epoch is None:
            epoch = self._open[of_day_ns] = Epoch(of_day_ns, None, {})
            if len(self._open) > self._late_epochs:
                self._close_oldest()
        return epoch

    def _close_oldest(self) -> None:
        # A log of RMC alone has its positions there. In any other they are a coarse second copy
        # that must not stand in for a lost GGA, so the first ones wait until it is clear.
        self._undecided.append(self._open.pop(next(iter(self._open))))
        self._rmc_suffices |= len(self._undecided) >= _RMC_EPOCHS
        waits = not (self._better_than_rmc or self._rmc_suffices)
        if not (waits and COARSE in self._undecided[0].said):
            self._decide()

    def _decide(self) -> None:
        for epoch in self._undecided:
            self._date(epoch)
        self._undecided.clear()

    def _date(self, epoch: Epoch) -> None:
        """Give the epoch its day, and its fix, if it has one, to those that have a date."""
        # Half a day back is the next day. Nearly a whole day ahead is a straggler from before
        # midnight; less than that is a logger that was switched off.
        last_ns = epoch.of_day_ns if self._last_ns is None else self._last_ns
        ahead_ns = epoch.of_day_ns - last_ns
        self._day += (ahead_ns < -DAY_NS // 2) - (ahead_ns > 23 * DAY_NS // 24)
        self._last_ns = epoch.of_day_ns
        if epoch.unix_day is not None:
            self._shift = epoch.unix_day - self._day
            for early in self._waiting:
                self._fixes.append(early._replace(time_ns=early.time_ns + self._shift * DAY_NS))
            self.counts.undated -= len(self._waiting)
            self._waiting.clear()
        fix = self._fix(epoch, (self._day + (self._shift or 0)) * DAY_NS + epoch.of_day_ns)
        if fix is None:
            return
        dated = self._shift is not None
        self.counts.undated += not dated
        (self._fixes if dated else self._waiting).append(fix)

    def _fix(self, epoch: Epoch, time_ns: int) -> Fix | None:
        """The fix of an epoch, if it has one."""
        said = {subject: stated for subject, (_, stated) in epoch.said.items()}
        position = said.get(POSITION) or (None if self._better_than_rmc else said.get(COARSE))
        if not position:
            return None
        if said.get(SOLUTION, {}) is None:
            self.counts.no_position += 1
            return None
        self.counts.no_geoid += not position.pop("has_geoid", True)
        self.counts.no_height += "height_m" not in position
        told = {"height_m": 0.0, **position}
        for subject in (HEADING, MOTION, SIGMA):
            told |= said.get(subject) or {}
        for subject in (SOLUTION, FALLBACK):
            for name, value in (said.get(subject) or {}).items():
                if told.get(name) is None:
                    told[name] = value
        return Fix(time_ns, **told)
