"""Whether a row stands out from the ground beside it, or is a line through noise.

Lines can be drawn through obstacle cells that are scattered over a field, and some of them hold
more cells than others. A row holds several times as many as the ground half-way to the next one,
all along: its difference is tested plant by plant (Student's t), so that one heap does not make a
row. Of many candidates some pass such a test by chance: as in the procedure of Benjamini and
Hochberg, the fewer of them pass, the less chance is left to each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc, stdtr  # scipy.stats takes ten times as long to import

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.field.rows.crops import Crop
from fieldgrid.maps import OBSTACLE, UNSEEN, Evidence, Strip

_STEP_M = 0.1
_CORE = 0.7
"""Share of a canopy's half width that is taken for the row: shoots make its face ragged."""

_FLANK = 0.8
"""Ground from this share of the way to the middle between two rows is beside the row."""

_CLEAR = 2.5
"""Parts beside a row begin at this number of half widths of its core from its middle."""

_SEEN = 0.5
_LEAST_BESIDE = 30
_LEAST_RATIO = 3.0
_LEAST_SEEN = 0.2
_CHANCE = 1e-4


class Contrast(NamedTuple):
    """How a line stands out: the probability that noise has as many more obstacle cells on it than
    half-way to the next row, 1 where there are not several times as many.

    Of single plants also the numbers of obstacle cells in parts of the line, each long enough for
    a plant, and in parts of the same size beside it.
    """

    chance: float
    on: Int64
    beside: Int64


def contrast(
    evidence: Evidence, line: Float64, half_width_m: float, reach_m: float, crop: Crop
) -> Contrast:
    """The contrast of a line [n, 2] with canopies of `half_width_m` to either side; half-way to the
    next row is `reach_m`."""
    strip = evidence.strip(line, reach_m, reach_m, _STEP_M)
    beside_m = np.abs(strip.across_m)
    core_m = max(_CORE * half_width_m, evidence.cell_m)
    core = strip.cells[:, beside_m < core_m]
    flank = strip.cells[:, beside_m > _FLANK * reach_m]
    # What was not seen of the ground beside a row may be as noisy as what was.
    seen = max(float((flank != UNSEEN).mean()), _LEAST_SEEN)
    parts_m = [max(0.5 * crop.plant_spacing_m, 0.5)]
    if crop.are_single:
        # Between trunks every other such part is bare, as it is not in longer ones.
        parts_m.append(crop.plant_spacing_m)
    chances = [_chance(core == OBSTACLE, flank == OBSTACLE, seen, part_m) for part_m in parts_m]
    # The best of some tests is that often a chance.
    chance = min(1.0, len(chances) * min(chances))
    none = np.zeros(0, dtype=np.int64)
    is_tested = crop.are_single and chance < 1.0
    counts = _counts(strip, core_m, crop.plant_spacing_m) if is_tested else (none, none)
    return Contrast(chance, *counts)


def _counts(strip: Strip, core_m: float, part_m: float) -> tuple[Int64, Int64]:
    """Obstacle cells in parts of a row, and in seen parts as wide and long to both sides of it."""
    per = round(part_m / _STEP_M)
    count = len(strip.cells) // per
    inside = np.flatnonzero(np.abs(strip.across_m) < core_m)
    wide, clear_m = len(inside), _CLEAR * core_m
    columns = np.flatnonzero(np.abs(strip.across_m) > clear_m)
    left, right = (columns[np.sign(strip.across_m[columns]) == side] for side in (1, -1))
    windows = [side[k : k + wide] for side in (left, right) for k in range(0, len(side), wide)]
    parts = strip.cells[: count * per].reshape(count, per, -1)
    on = (parts[:, :, inside] == OBSTACLE).sum(axis=(1, 2))
    beside = [
        (part == OBSTACLE).sum(axis=(1, 2))[(part != UNSEEN).mean(axis=(1, 2)) > _SEEN]
        for part in (parts[:, :, window] for window in windows if len(window) == wide)
    ]
    return on, np.concatenate(beside) if beside else on[:0]


def chances_of_noise(contrasts: Sequence[Contrast]) -> Float64:
    """How likely each of the lines of a map [n] is noise.

    Of single plants each part of a line has a rank among all parts beside lines: a tree has more
    cells than nearly all of these, and a heap is only one part. Fisher's method joins the ranks.
    """
    beside = np.sort(np.concatenate([np.zeros(0, np.int64), *(one.beside for one in contrasts)]))
    chances = np.array([one.chance for one in contrasts])
    if len(beside) < _LEAST_BESIDE:
        return chances
    for k, one in enumerate(contrasts):
        if len(one.on):
            ranks = (1.0 + (len(beside) - np.searchsorted(beside, one.on))) / (1.0 + len(beside))
            chance = float(gammaincc(len(ranks), -np.log(ranks).sum()))
            chances[k] = min(1.0, 1.5 * min(chances[k], 2.0 * chance))
    return chances


def _chance(core: Bool, flank: Bool, seen: float, part_m: float) -> float:
    """The probability that noise has as many more obstacle cells [n, m] on a row than beside it;
    `seen` is the share of the ground beside it that was seen. Both are counted in parts of
    `part_m`."""
    count = int(len(core) * _STEP_M / part_m)
    if count < 2:
        return 1.0
    on, off = _shares(core, count), _shares(flank, count) / seen
    if on.mean() <= _LEAST_RATIO * off.mean():
        return 1.0
    error = float((on - off).std(ddof=1)) / np.sqrt(count)
    return float(stdtr(count - 1, (off - on).mean() / max(error, 1e-9)))


def _shares(is_in: Bool, count: int) -> Float64:
    """The share that is true of flags [n, m], in each of `count` stretches."""
    k = np.arange(count + 1)
    # The first ones are longer by one where it does not come out even.
    edges = k * (len(is_in) // count) + np.minimum(k, len(is_in) % count)
    sums = np.add.reduceat(is_in.sum(axis=1), edges[:-1])
    return np.asarray(sums / (np.diff(edges) * is_in.shape[1]))


def stand_out(chances: Float64) -> Bool:
    """Which of all candidates of a map are rows, by their chances [n] to be noise.

    The k smallest of n are accepted when the largest of them is at most `_CHANCE` (k / n)²: the
    square, as a candidate is already the densest line near it.
    """
    order = np.argsort(chances)
    share = np.arange(1, len(chances) + 1) / max(len(chances), 1)
    good = np.flatnonzero(chances[order] <= _CHANCE * share**2)
    found = np.zeros(len(chances), dtype=np.bool_)
    found[order[: good[-1] + 1 if len(good) else 0]] = True
    return found
