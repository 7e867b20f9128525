"""Fields whose rows are hard to find: what is found of them, and whether a doubt says so.

`python -m benchmarks.odd_rows [FIRST:LAST [KIND...]]` (default 0:10, all kinds) makes fields of
each kind, a field of its number, in cells of 0.05 to 0.2 m, and prints rows that are right, false
and missed (as `benchmarks.rows` counts them), and of how many fields that are not all right a doubt
is told, or no row.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.fields import Array
from benchmarks.planting import Planting, Sight, seen_view
from benchmarks.rows import match
from fieldgrid.field.rows.find import rows_of_view


class Size(NamedTuple):
    """Of a field: rows, their length and distance, metres; what else is random comes from `rng`."""

    count: int
    length_m: float
    spacing_m: float
    rng: np.random.Generator


class Stand(NamedTuple):
    """Rows [n, 2], holes in them, the half width of their canopy, the crop to look for, and how
    many false cells there are."""

    rows: list[Array]
    missing: list[tuple[int, float, float]]
    half_m: float = 0.35
    crop: str = "vineyard"
    noise_per_m2: float = 0.05


def _straight(
    count: int, length: float, apart: float, at: tuple[float, float] = (0, 0)
) -> list[Array]:
    east, north = at
    return [
        np.array([[east + k * apart, north], [east + k * apart, north + length]])
        for k in range(count)
    ]


def _bent(radius_m: float) -> Callable[[Size], Stand]:
    def made(size: Size) -> Stand:
        turn = np.linspace(0.0, min(size.length_m / radius_m, 2.0), 60)
        circle = np.column_stack([np.cos(turn), np.sin(turn)])
        rows = [(radius_m + k * size.spacing_m) * circle for k in range(size.count)]
        return Stand(rows, [], size.rng.uniform(0.2, 0.4))

    return made


def _lacking(share: float) -> Callable[[Size], Stand]:
    """Stretches of 2 to 8 m are there, or not."""

    def made(size: Size) -> Stand:
        missing = []
        for row in range(size.count):
            at = 0.0
            while at < size.length_m:
                hole = size.rng.uniform(2.0, 8.0)
                if size.rng.random() < share:
                    missing.append((row, at, min(at + hole, size.length_m)))
                at += hole
        return Stand(_straight(*size[:3]), missing, size.rng.uniform(0.2, 0.4))

    return made


def _shifted(size: Size) -> Stand:
    half_m, apart = 0.5 * size.length_m, size.spacing_m
    rows = _straight(size.count, half_m, apart)
    rows += _straight(size.count, half_m, apart, (0.5 * apart, half_m + 1.5))
    return Stand(rows, [], size.rng.uniform(0.2, 0.4))


def _sown(size: Size) -> Stand:
    return Stand(_straight(14, 30.0, 0.75), [], 0.2, "arable")


def _trunks(size: Size) -> Stand:
    apart, along = size.rng.uniform(3.5, 6.0), size.rng.uniform(2.5, 4.0)
    firsts = np.arange(0.15, size.length_m, along)
    missing = [(row, at, min(at + along - 0.3, size.length_m)) for row in range(8) for at in firsts]
    return Stand(_straight(8, size.length_m, apart), missing, 0.15, "orchard")


def _noisy(size: Size) -> Stand:
    return Stand(_straight(*size[:3]), [], size.rng.uniform(0.2, 0.4), noise_per_m2=1.0)


KINDS: dict[str, Callable[[Size], Stand]] = {
    "bent to 60 m": _bent(60.0),
    "bent to 40 m": _bent(40.0),
    "bent to 25 m": _bent(25.0),
    "bent to 15 m": _bent(15.0),
    "30 % missing in long holes": _lacking(0.3),
    "50 % missing in long holes": _lacking(0.5),
    "two blocks half a row apart": _shifted,
    "sown 0.75 m apart, 0.4 m wide": _sown,
    "trunks of 0.3 m": _trunks,
    "a false cell a square metre": _noisy,
}


class Outcome(NamedTuple):
    """Rows of a field that are right, false and missed, and whether anything doubtful is told."""

    right: int
    false: int
    missed: int
    is_told: bool


def outcome(kind: str, seed: int) -> Outcome:
    """What is found of a field."""
    rng = np.random.default_rng(seed)
    size = Size(
        int(rng.integers(5, 14)), float(rng.uniform(30.0, 70.0)), float(rng.uniform(2.0, 3.2)), rng
    )
    cell_m = float(rng.choice([0.05, 0.1, 0.1, 0.2]))
    stand = KINDS[kind](size)
    if stand.crop == "arable":
        cell_m = min(cell_m, 0.1)
    turn = rng.uniform(0.0, 2.0 * np.pi)
    spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    corner = rng.uniform(-500.0, 500.0, 2)
    rows = [row @ spin + corner for row in stand.rows]
    sight = Sight(
        seed=seed, noise_per_m2=stand.noise_per_m2, hole_share=rng.uniform(0.01, 0.2),
        fill=rng.uniform(0.3, 0.9),
    )  # fmt: skip
    view = seen_view(Planting(rows, stand.half_m, stand.missing), sight, cell_m)
    found = rows_of_view(view, crop=stand.crop)
    lines = [np.asarray(row.line.coords) for row in found.rows]
    matched = match(lines, rows, [True] * len(rows))
    is_told = bool(found.doubts) or not found.rows
    return Outcome(len(matched.pairs), matched.false, matched.missed, is_told)


def main() -> None:
    """Print a line for each kind."""
    first, _, last = (sys.argv[1:] or ["0:10"])[0].rpartition(":")
    for kind in sys.argv[2:] or KINDS:
        found = [outcome(kind, seed) for seed in range(int(first or 0), int(last))]
        wrong = [one for one in found if one.false or one.missed]
        print(
            f"{kind}: {sum(o.right for o in found)} rows right, {sum(o.false for o in found)} "
            f"false, {sum(o.missed for o in found)} missed; {len(found) - len(wrong)} of "
            f"{len(found)} fields right, of the others {sum(o.is_told for o in wrong)} told "
            f"doubtful, of the right ones {sum(o.is_told for o in found if o not in wrong)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
