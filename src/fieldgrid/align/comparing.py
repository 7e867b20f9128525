"""Comparing a submap with others: work that threads or the workers of a cluster do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fieldgrid.align.matches import Match
from fieldgrid.align.pairs import SubmapPair
from fieldgrid.align.score import Against, Scores, TurnPeak, peak, turn_peak
from fieldgrid.align.submaps import SubmapImage


class SubmapGroup(NamedTuple):
    """A submap and those that it is compared with, of each the pictures of all turns."""

    pairs: Sequence[SubmapPair]
    a: SubmapImage
    b: Sequence[Sequence[SubmapImage]]


@dataclass(frozen=True, slots=True)
class Wholes:
    """Compares a submap with others over all shifts in reach."""

    reach_m: float

    def __call__(self, group: SubmapGroup) -> list[tuple[SubmapPair, Scores]]:
        """The scores of those pairs that share obstacles."""
        against = Against(group.a, self.reach_m)
        return [
            (pair, scores)
            for pair, (own,) in zip(group.pairs, group.b, strict=True)
            if (scores := against.scores(own)) is not None
        ]


@dataclass(frozen=True, slots=True)
class Matching:
    """Matches a submap with others, shifts and turns."""

    reach_m: float

    def __call__(self, group: SubmapGroup) -> list[tuple[SubmapPair, Match]]:
        """The matches of those pairs that share obstacles."""
        against = Against(group.a, self.reach_m)
        return [
            (pair, match)
            for pair, of_turns in zip(group.pairs, group.b, strict=True)
            if (match := self._match(pair, against, *of_turns)) is not None
        ]

    @staticmethod
    def _match(
        p: SubmapPair, against: Against, b: SubmapImage, less: SubmapImage, more: SubmapImage
    ) -> Match | None:
        score = against.scores(b)
        if score is None:
            return None
        turned = TurnPeak(0.0, 0.0)
        if p.a != p.b:
            turned = turn_peak(against, less, score, more)
        return Match(*p, *peak(score, np.zeros(2)), *turned)
