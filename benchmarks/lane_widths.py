"""The clear width of lanes in made fields beside the true one, by the size of cells.

`python -m benchmarks.lane_widths [FIRST:LAST]` (default 0:40) makes fields with rows 1.8 to 3.2 m
apart, seen from one side or from both, with noise, holes and, in half of them, a thing in a lane,
and prints how far the clear width is off the least width of all that stands, and of how many lanes
it is within three sigma.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from benchmarks.planting import Planting, Sight, seen_view
from benchmarks.rows import true_widths
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.maps import Evidence


class Told(NamedTuple):
    """Of a lane: the side of the cells, how much the clear width is too large, and its sigma."""

    cell_m: float
    error_m: float
    sigma_m: float


def lanes_of(seed: int) -> list[Told]:
    """The lanes of a field; of one without a clear width both are NaN."""
    rng = np.random.default_rng(seed)
    count, length_m = int(rng.integers(3, 8)), float(rng.uniform(20.0, 45.0))
    spacing_m, half_m = float(rng.uniform(1.8, 3.2)), float(rng.uniform(0.2, 0.45))
    cell_m, turn = float(rng.choice([0.05, 0.1, 0.1, 0.2])), rng.uniform(0.0, 2.0 * np.pi)
    spin = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    rows = [
        np.array([[k * spacing_m, 0.0], [k * spacing_m, length_m]]) @ spin for k in range(count)
    ]
    things = []
    if rng.random() < 0.5:
        across = spacing_m * (rng.integers(count - 1) + rng.uniform(0.3, 0.7))
        east_m, north_m = np.array([across, rng.uniform(3.0, length_m - 3.0)]) @ spin
        things = [(float(east_m), float(north_m), float(rng.uniform(0.15, 0.3)))]
    both = [(True, True)] * count
    sides = both
    if rng.random() < 0.4:
        sides = [(bool(rng.random() < 0.7), True) for _ in range(count)]
    stand = Planting(rows, half_m, (), things)
    view = seen_view(
        stand,
        Sight(
            sides, hole_share=float(rng.uniform(0.01, 0.15)), fill=float(rng.uniform(0.3, 0.9)),
            seed=seed, margin_m=6.0, headland_m=6.0,
        ),
        cell_m,
    )  # fmt: skip
    # The same canopies, all of them seen.
    whole = Sight(
        both, depth_m=1e6, fill=1.0, noise_per_m2=0.0, hole_share=0.0, seed=seed, margin_m=6.0,
        headland_m=6.0,
    )  # fmt: skip
    truth = Evidence.of(seen_view(stand, whole, cell_m))
    return [
        Told(
            cell_m,
            lane.clear_width_m - float(true_widths(truth, lane.line).min()),
            lane.clear_sigma_m,
        )
        for lane in rows_of_view(view).lanes
    ]


def main() -> None:
    """Print a line for each size of cells."""
    first, _, last = (sys.argv[1:] or ["0:40"])[0].rpartition(":")
    found = [one for seed in range(int(first or 0), int(last)) for one in lanes_of(seed)]
    for cell_m in sorted({one.cell_m for one in found}):
        lanes = [one for one in found if one.cell_m == cell_m]
        told = [one for one in lanes if np.isfinite(one.error_m)]
        errors = np.array([one.error_m for one in told])
        within = sum(abs(one.error_m) <= 3.0 * one.sigma_m for one in told)
        print(
            f"cells of {cell_m} m: {len(told)} of {len(lanes)} lanes have a clear width, {within} "
            f"within three sigma; off by {np.median(errors):+.2f} m (median), {errors.min():+.2f} "
            f"to {errors.max():+.2f} m; sigma {np.median([one.sigma_m for one in told]):.2f} m "
            f"(median)",
            flush=True,
        )


if __name__ == "__main__":
    main()
