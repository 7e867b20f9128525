"""Bushes and orchards: rows of single plants, seen from both sides or from one.

`python -m benchmarks.single_plants [FIRST:LAST [KIND...]]` (default 0:20, all kinds) makes fields
of each kind, a field of its number: spacing, size and distance of plants, missing plants, noise,
holes and cells vary. It prints rows that are right, false and missed (as `benchmarks.rows` counts
them), how far right rows lie off across (RMS, worst row, rows within three sigma) and how far
their ends are from the middle of the outermost plant that stands (median, 95 %, worst).
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from benchmarks.fields import Array
from benchmarks.planting import Planting, Sight, seen_view
from benchmarks.rows import match, offsets
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import lengths, project


class Kind(NamedTuple):
    """Ranges in metres: distance of rows, of plants, radius of a plant; the crop that is looked
    for; from how many sides rows are seen."""

    crop: str
    rows_m: tuple[float, float]
    plants_m: tuple[float, float]
    radius_m: tuple[float, float]
    sides: int


BUSHES = (1.5, 3.5), (0.7, 1.5), (0.25, 0.5)
TREES = (3.0, 7.0), (2.0, 4.8), (0.25, 0.6)
TRUNKS = (3.5, 6.0), (2.5, 4.0), (0.08, 0.2)
KINDS = {
    "bushes": Kind("bushes", *BUSHES, 2),
    "bushes from one side": Kind("bushes", *BUSHES, 1),
    "orchard": Kind("orchard", *TREES, 2),
    "orchard from one side": Kind("orchard", *TREES, 1),
    "trunks": Kind("orchard", *TRUNKS, 2),
    "trunks from one side": Kind("orchard", *TRUNKS, 1),
}


class Outcome(NamedTuple):
    """Of a field: rows right, false, missed; of the right ones the RMS offset, its mean over
    sigma, and how far both ends reach beyond the last plant; whether anything doubtful is told."""

    right: int
    false: int
    missed: int
    off_m: list[float]
    sigmas: list[float]
    ends_m: list[float]
    is_told: bool


class Stand(NamedTuple):
    """Rows through all places of plants, the holes between those that stand, and the rows from the
    first to the last of these."""

    rows: list[Array]
    missing: list[tuple[int, float, float]]
    true: list[Array]


def stand(kind: Kind, radius_m: float, rng: np.random.Generator) -> Stand:
    """Plants of a field: each up to some centimetres off its row, some of them missing."""
    apart_m, along_m = rng.uniform(*kind.rows_m), rng.uniform(*kind.plants_m)
    along_m = max(along_m, 1.2 * radius_m)
    count, length_m = int(rng.integers(4, 11)), rng.uniform(25.0, 70.0)
    lacking, slant = rng.choice([0.0, 0.05, 0.15]), rng.uniform(-0.3, 0.3)
    rows, missing, true = [], [], []
    for k in range(count):
        north = np.arange(0.0, length_m, along_m) + slant * k * apart_m
        east = k * apart_m + rng.normal(0.0, 0.04, len(north))
        places = np.column_stack([east, north])
        stands = rng.random(len(north)) >= lacking
        # Beyond the outermost plants the line goes on, so that their canopies are whole.
        row = np.array([places[0] - [0.0, along_m], *places, places[-1] + [0.0, along_m]])
        at = lengths(row)
        edges = [-1.0]
        for s in at[1:-1][stands]:
            edges += [s - radius_m, s + radius_m]
        edges.append(at[-1] + 1.0)
        holes = zip(edges[::2], edges[1::2], strict=True)
        missing += [(k, a, b) for a, b in holes if b > a]
        rows.append(row)
        kept = np.flatnonzero(stands)
        true.append(places[kept[0] : kept[-1] + 1])
    return Stand(rows, missing, true)


def outcome(name: str, seed: int) -> Outcome:
    """What is found of a field."""
    kind, rng = KINDS[name], np.random.default_rng(seed)
    radius_m = rng.uniform(*kind.radius_m)
    made = stand(kind, radius_m, rng)
    turn, corner = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-500.0, 500.0, 2)
    spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    rows, true = ([row @ spin + corner for row in lines] for lines in (made.rows, made.true))
    one = rng.choice(["left", "right", "any"])
    left = [bool(rng.random() < 0.5) if one == "any" else one == "left" for _ in rows]
    sight = Sight(
        [(True, True) if kind.sides == 2 else (is_left, not is_left) for is_left in left],
        seed=seed, noise_per_m2=float(rng.choice([0.02, 0.05, 0.2])),
        hole_share=rng.uniform(0.01, 0.15), fill=rng.uniform(0.4, 0.9),
    )  # fmt: skip
    cell_m = float(rng.choice([0.05, 0.1, 0.1, 0.2]))
    view = seen_view(Planting(rows, radius_m, made.missing), sight, cell_m)
    found = rows_of_view(view, crop=kind.crop)
    lines = [np.asarray(row.line.coords) for row in found.rows]
    matched = match(lines, true, [True] * len(true))
    off, sigmas, ends = [], [], []
    for k, t in matched.pairs:
        own = offsets(lines[k], true[t])
        off.append(float(np.sqrt((own**2).mean())))
        sigmas.append(float(abs(own.mean())) / found.rows[k].sigma_m)
        at, _ = project(lines[k], true[t])
        ends += [float(-at.min()), float(at.max() - lengths(true[t])[-1])]
    is_told = bool(found.doubts) or not found.rows
    return Outcome(len(matched.pairs), matched.false, matched.missed, off, sigmas, ends, is_told)


def main() -> None:
    """Print a line for each kind."""
    first, _, last = (sys.argv[1:] or ["0:20"])[0].rpartition(":")
    for name in sys.argv[2:] or KINDS:
        found = [outcome(name, seed) for seed in range(int(first or 0), int(last))]
        wrong = [one for one in found if one.false or one.missed]
        right, false, missed = (sum(o[k] for o in found) for k in range(3))
        off = np.array([value for one in found for value in one.off_m])
        sigmas = np.array([value for one in found for value in one.sigmas])
        ends = np.abs([value for one in found for value in one.ends_m])
        f1 = 2.0 * right / max(2 * right + false + missed, 1)
        print(
            f"{name}: {right} rows right, {false} false, {missed} missed, F1 {f1:.3f}; "
            f"{len(found) - len(wrong)} of {len(found)} fields right, of the others "
            f"{sum(o.is_told for o in wrong)} doubted; off {np.sqrt((off**2).mean()):.3f} m, worst "
            f"{off.max():.3f}, {(sigmas < 3.0).mean():.0%} within 3 sigma; ends "
            f"{np.median(ends):.2f} m, 95 % {np.quantile(ends, 0.95):.2f}, worst {ends.max():.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
