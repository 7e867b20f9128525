"""How far a figure may move: what another seed or another hour gives.

A figure falls under the first rule that fits it:

times      of runs: seconds, anything a second, and figures of `make bench` without unit: ±40 %
memory     MB and GB: ±15 %
ratios     of times, and shares in `make bench`: ±15 %
sizes      bytes and cells, angles and distances in `make bench`: 2 %
worst      of a sampled part, the worst of its drives: a fifth of its value, 10 points of a share
shares     of a sampled part: two standard errors of a share of its drives
counts     of a sampled part: two standard errors of a count, or a tenth
sampled    other figures of a sampled part: a fifth, and two steps of the last digit
counted    in other parts: 2 %
shares     in other parts: two steps of the last digit, and 2 % of the distance to 0 or 100 %
all others two steps of the last digit, and 2 %

Where the same benchmark is frozen with two seeds, the tolerance is at least their difference.
"""

from __future__ import annotations

import math
import re
from enum import Enum

from benchmarks.frozen_text import Figure

STEPS = 2.0
"""What the last digit that is printed may move."""

TIME, MEMORY, RATIO = 0.4, 0.15, 0.15
SAMPLED, COUNTED, FIXED = 0.2, 0.1, 0.02
WORST_POINTS = 10.0
STANDARD_ERRORS = 2.0

_TIME = re.compile(r"(s|ms|min)$|.*/s$")
_TIMED = re.compile(r"processor time|time in s\b")
_MEMORY = re.compile(r"(MB|GB)$")
_EXACT = ("°", "cm", "bytes", "cells")
_RATIO = re.compile(r"(x|%|times)$")


class Times(Enum):
    """Whether a part measures times. A second elsewhere is that of a clock, not of a run."""

    NONE = 0
    SOME = 1
    ALL = 2


def tolerance_of(figure: Figure, times: Times, cases: int | None) -> float:
    """The tolerance of a figure; `cases` is the number of random cases of its part, None where
    nothing is drawn."""
    size = abs(figure.value)
    step = STEPS * 10.0**-figure.decimals
    if times is not Times.NONE and (_TIME.match(figure.unit) or _TIMED.search(figure.name)):
        return step + TIME * size
    if times is Times.ALL:
        return _of_bench(figure, step)
    if cases is not None:
        return _of_samples(figure, step, figure.drives or cases)
    if figure.unit == "%":
        return step + FIXED * _from_the_end(size)
    return FIXED * size if figure.decimals == 0 else step + FIXED * size


def _of_bench(figure: Figure, step: float) -> float:
    size = abs(figure.value)
    if _MEMORY.match(figure.unit):
        return step + MEMORY * size
    if _RATIO.match(figure.unit):
        return step + RATIO * size
    return step + (FIXED if figure.unit in _EXACT else TIME) * size


def _of_samples(figure: Figure, step: float, cases: float) -> float:
    size = abs(figure.value)
    if figure.unit == "%":
        if "worst" in figure.name:
            return max(WORST_POINTS, SAMPLED * size)
        share = (size / 100.0 * cases + 1.0) / (cases + 2.0)
        return 100.0 * STANDARD_ERRORS * math.sqrt(max(share * (1.0 - share), 0.0) / cases)
    if figure.decimals == 0:
        return max(STANDARD_ERRORS * math.sqrt(size + 1.0), COUNTED * size)
    return step + SAMPLED * size


def _from_the_end(percent: float) -> float:
    return min(percent, abs(100.0 - percent))
