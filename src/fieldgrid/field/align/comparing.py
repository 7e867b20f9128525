"""Comparing a submap with others: work that threads or the workers of a cluster do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.field.align.matches import Match
from fieldgrid.field.align.pairs import SubmapPair
from fieldgrid.field.align.score import Scores, SubmapCorrelator, peak, turn_peak
from fieldgrid.field.align.submaps import SubmapImage


class SubmapGroup(NamedTuple):
    """A submap and those that it is compared with, of each the pictures of all turns."""

    pairs: Sequence[SubmapPair]
    a: SubmapImage
    b: Sequence[Sequence[SubmapImage]]


def whole_scores(reach_m: float, group: SubmapGroup) -> list[tuple[SubmapPair, Scores]]:
    """The scores of a submap with others over all shifts up to `reach_m`, for those pairs that
    share obstacles."""
    against = SubmapCorrelator(group.a, reach_m)
    return [
        (pair, scores)
        for pair, (own,) in zip(group.pairs, group.b, strict=True)
        if (scores := against.scores(own)) is not None
    ]


def fine_matches(reach_m: float, group: SubmapGroup) -> list[tuple[SubmapPair, Match]]:
    """The matches of a submap with others, by shifts up to `reach_m` and turns, for those pairs
    that share obstacles."""
    against = SubmapCorrelator(group.a, reach_m)
    found = []
    for pair, (straight, less, more) in zip(group.pairs, group.b, strict=True):
        score = against.scores(straight)
        if score is not None:
            turned = turn_peak(against, less, score, more) if pair.a != pair.b else (0.0, 0.0)
            found.append((pair, Match(*pair, *peak(score, np.zeros(2)), *turned)))
    return found
