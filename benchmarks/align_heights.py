"""`python -m benchmarks.align_heights [SUBMAPS [DRIVES [BLOCK_M]]]`: time and memory of the heights
of many drives over one field, all lanes of which every drive goes along; over and over, where the
field is a square block.

What the drives saw is made: the ground of each submap of 8 m, with the error of its receiver.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from benchmarks.peak import peak_mb
from fieldgrid.field.align import heights
from fieldgrid.field.align.drives import Role, SubmapDrive
from fieldgrid.field.align.submaps import SUBMAP_M
from fieldgrid.maps import Transform

LANE_M, LANES_APART_M = 200.0, 3.0

AHEAD_M, WIDE_M, SEEN = 20.0, 15.0, 0.6
"""What a submap sees of the ground, and of that this share of the places."""

SCATTER_M = 0.05


def drive_of(submaps: int, number: int) -> SubmapDrive:
    """A drive, but for what its frames saw."""
    time_ns = number * 10**14 + np.arange(submaps, dtype=np.int64) * 8 * 10**9
    none = np.zeros((submaps, 2))
    transform = Transform()
    return SubmapDrive(
        f"{number}", Role.MOVES, (), transform, 0.25, 0.2, time_ns, none, none[0], 0.25
    )


def places_of(submap: int, random: np.random.Generator, block_m: float | None) -> np.ndarray:
    """The places that a submap of a drive saw the ground of, as whole numbers."""
    of_lane = int((block_m or LANE_M) / SUBMAP_M)
    lane, along = divmod(submap, of_lane)
    if lane % 2:
        along = of_lane - 1 - along
    if block_m is not None:
        lane %= int(block_m / LANES_APART_M)
    east, north = lane * LANES_APART_M, along * SUBMAP_M
    i, j = (
        np.arange(
            round((middle - reach) / heights.PLACE_M), round((middle + reach) / heights.PLACE_M)
        )
        for middle, reach in ((east, WIDE_M / 2.0), (north, AHEAD_M / 2.0))
    )
    places = (((i + 1000) << 32)[:, None] + (j + 1000)).ravel()
    return places[random.random(len(places)) < SEEN]


def main() -> None:
    """Print a line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("submaps", nargs="?", type=int, default=heights.MOST_SUBMAPS)
    parser.add_argument("drives", nargs="?", type=int, default=10)
    parser.add_argument("block_m", nargs="?", type=float)
    given = parser.parse_args()
    random = np.random.default_rng(0)
    each = given.submaps // given.drives
    count = each * given.drives
    error_m = np.concatenate(
        [random.normal(0.0, 0.5) + np.cumsum(random.normal(0.0, 0.02, each))
         for _ in range(given.drives)]
    )  # fmt: skip
    places = [places_of(n % each, random, given.block_m) for n in range(count)]
    submap = np.repeat(np.arange(count), [*map(len, places)])
    _, place = np.unique(np.concatenate(places), return_inverse=True)
    up_m = error_m[submap] + random.normal(0.0, SCATTER_M, len(submap))
    seen = heights._Seen(submap, place, up_m)
    drives = [drive_of(each, n) for n in range(given.drives)]
    parts = np.split(np.arange(count), given.drives)
    shared = heights._pairs_that_share(seen, count)
    start = time.process_time()
    found_m, _ = heights._solve(seen, drives, np.full(count, 0.5), parts)
    spent_s, left_m = time.process_time() - start, found_m + error_m
    print(
        f"{count} submaps of {given.drives} drives, {count * SUBMAP_M / 1000:.0f} km, "
        f"{len(submap) / 1e6:.1f} M heights, {shared / 1e6:.1f} M times two submaps share ground "
        f"(at most {heights.MOST_SHARED / 1e6:.0f}): {spent_s:.1f} s of processor time, peak "
        f"{peak_mb():.0f} MB; "
        f"{1000.0 * left_m.std():.1f} mm left between them"
    )


if __name__ == "__main__":
    main()
