"""Gaps in rows whose plants are missing one by one: precision and recall of gaps of 1.5 m and more.

`python -m benchmarks.missing_plants [FIRST:LAST]` (default 0:20) makes fields with plants 0.8 to
3 m apart of which 5 to 40 % are missing, each on its own, seen from one side or from both, in cells
of 0.05 to 0.2 m, and prints for each share what of the gaps was found. A gap is the ground between
the canopies of two plants. One that was found is right when it lies on a true one by more than half
of both.
"""

from __future__ import annotations

import itertools
import sys
from typing import NamedTuple

import numpy as np

from benchmarks.fields import Array
from benchmarks.planting import Planting, Sight, seen_view
from benchmarks.rows import match
from fieldgrid.field import Planting as Found
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import lengths, project

SHARES = (0.05, 0.15, 0.3, 0.4)
LEAST_M = 1.5


class Stand(NamedTuple):
    """Rows [n, 2], the holes in them (row, from, to), how they are seen, the spacing of plants."""

    rows: list[Array]
    missing: list[tuple[int, float, float]]
    sight: Sight
    cell_m: float
    plants_m: float
    half_m: float


class Outcome(NamedTuple):
    """Gaps found and true, how many of each are right, rows right, false, missed; ends of those
    that are right, how many are over 1 m too short and too long; doubts."""

    found: int
    true: int
    precise: int
    recalled: int
    rows: tuple[int, int, int]
    ends: tuple[int, int, int]
    told: tuple[str, ...]


def stand_of(share: float, seed: int) -> Stand:
    """A field of which such a share of the plants is missing."""
    rng = np.random.default_rng(seed)
    plants_m, spacing_m = float(rng.uniform(0.8, 3.0)), float(rng.uniform(2.0, 3.5))
    count, length_m = int(rng.integers(4, 12)), float(rng.uniform(30.0, 70.0))
    # Canopies on wires fill the place of a plant, or most of it.
    half_plant_m = 0.5 * plants_m * float(rng.uniform(0.7, 1.0))
    rows, missing = [], []
    for k in range(count):
        places = np.arange(half_plant_m, length_m, plants_m)
        stands = rng.random(len(places)) > share
        stands[[0, -1]] = True
        edges = [(p - half_plant_m, p + half_plant_m) for p in places[stands]]
        missing += [(k, a, b) for (_, a), (b, _) in itertools.pairwise(edges) if b - a > 0.01]
        rows.append(np.array([[k * spacing_m, 0.0], [k * spacing_m, edges[-1][1]]]))
    turn = rng.uniform(0.0, 2.0 * np.pi)
    spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corner = rng.uniform(-500.0, 500.0, 2)
    sides = [(True, True)] * count
    if rng.random() < 0.5:
        sides = [(True, False) if rng.random() < 0.5 else (True, True) for _ in range(count)]
    sight = Sight(
        sides, seed=seed, noise_per_m2=0.05, hole_share=rng.uniform(0.01, 0.15),
        fill=rng.uniform(0.3, 0.9),
    )  # fmt: skip
    cell_m = float(rng.choice([0.05, 0.1, 0.1, 0.2]))
    return Stand(
        [row @ spin + corner for row in rows], missing, sight, cell_m, plants_m,
        float(rng.uniform(0.2, 0.4)),
    )  # fmt: skip


def outcome(share: float, seed: int) -> Outcome:
    """What is found of the gaps of a field."""
    stand = stand_of(share, seed)
    view = seen_view(Planting(stand.rows, stand.half_m, stand.missing), stand.sight, stand.cell_m)
    found = rows_of_view(view)
    lines = [np.asarray(row.line.coords) for row in found.rows]
    rows = match(lines, stand.rows, [True] * len(stand.rows))
    beyond = []
    for k, t in rows.pairs:
        at, _ = project(lines[k], stand.rows[t])
        beyond += [-float(at.min()), float(at.max() - lengths(stand.rows[t])[-1])]
    ends = len(beyond), sum(b < -1.0 for b in beyond), sum(b > 1.0 for b in beyond)
    return Outcome(*_gaps(found, stand), (len(rows.pairs), rows.false, rows.missed), ends,
                   tuple(d.kind for d in found.doubts))  # fmt: skip


def _gaps(found: Found, stand: Stand) -> tuple[int, int, int, int]:
    """Found, true, found that are right, true that are found."""
    spans = []
    for gap in found.gaps:
        line = np.asarray(gap.line.coords)
        at, off = zip(*(project(line, row) for row in stand.rows), strict=True)
        row = int(np.argmin([np.abs(o).max() for o in off]))
        spans.append((row, float(at[row].min()), float(at[row].max())))

    def shared(one: tuple[int, float, float], other: tuple[int, float, float]) -> float:
        return min(one[2], other[2]) - max(one[1], other[1]) if one[0] == other[0] else 0.0

    def is_same(one: tuple[int, float, float], other: tuple[int, float, float]) -> bool:
        longer = max(one[2] - one[1], other[2] - other[1])
        return shared(one, other) > 0.5 * longer

    # What is 0.2 m about the least length may be told or not.
    judged = [s for s in spans if s[2] - s[1] >= LEAST_M]
    sure = [t for t in stand.missing if t[2] - t[1] >= LEAST_M]
    loose = [t for t in stand.missing if t[2] - t[1] >= LEAST_M - 0.2]
    loosely = [s for s in spans if s[2] - s[1] >= LEAST_M - 0.2]
    precise = sum(any(is_same(s, t) for t in loose) for s in judged)
    recalled = sum(any(is_same(s, t) for s in loosely) for t in sure)
    return len(judged), len(sure), precise, recalled


def main() -> None:
    """Print a line for each share."""
    first, _, last = (sys.argv[1:] or ["0:20"])[0].rpartition(":")
    for share in SHARES:
        found = [outcome(share, seed) for seed in range(int(first or 0), int(last))]
        sums = np.array([o[:4] for o in found]).sum(axis=0)
        rows = np.array([o.rows for o in found]).sum(axis=0)
        ends = np.array([o.ends for o in found]).sum(axis=0)
        wrong = [o for o in found if o.rows[1] or o.rows[2]]
        print(
            f"{share:.0%} missing: {sums[1]} true gaps, recall {sums[3] / max(sums[1], 1):.3f}; "
            f"{sums[0]} found, precision {sums[2] / max(sums[0], 1):.3f}; rows {rows[0]} right, "
            f"{rows[1]} false, {rows[2]} missed; of {ends[0]} ends {ends[1]} over 1 m too short, "
            f"{ends[2]} too long; fields with a doubt {sum(bool(o.told) for o in found)} of "
            f"{len(found)}, of {len(wrong)} that are not all right "
            f"{sum(bool(o.told) for o in wrong)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
