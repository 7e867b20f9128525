"""Drives over made-up fields, grids as real ones are: for maps larger than any recording here."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache, partial

import numpy as np

from benchmarks import EXAMPLE
from fieldgrid.geometry import Datum, GridSpec, LocalGrid, Pose
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline.staging.perception import perceive_frame, side_by_side
from fieldgrid.recordings import open_recording

DATUM = Datum(41.65, -4.72, 787.4)
START_NS = 1_780_272_000_000_000_000


@lru_cache
def real_grids(width_m: float = 10.0, length_m: float = 15.0) -> tuple[LocalGrid, ...]:
    """The local grids of the example's frames."""
    with open_recording(EXAMPLE, "gnss_rtk.nmea") as recording:
        gridder = LocalGridder(recording.rig, GridSpec(width_m, length_m))
        return tuple(
            perceived.grid
            for perceived in side_by_side(
                partial(perceive_frame, gridder=gridder), recording.frames(), 2
            )
        )


def pose_at(east_m: float, north_m: float, heading_deg: float, k: int) -> Pose:
    """A good pose, of the k-th frame."""
    time_ns = START_NS + k * 1_000_000_000
    return Pose(time_ns, east_m, north_m, 0.0, heading_deg, 0.02, 0.4, 1.5)


def rows(
    frames: int, side_m: float, step_m: float, row_m: float, west_m: float, south_m: float
) -> Iterator[Pose]:
    """Poses up and down parallel rows over a square, as a field is worked."""
    per_row = max(1, int(side_m / step_m))
    for k in range(frames):
        row, along = divmod(k, per_row)
        up = row % 2 == 0
        north = south_m + (along if up else per_row - along) * step_m
        heading = 0.0 if up else 180.0
        # Not just along the lattice: a vehicle sways.
        heading += 2.0 * math.sin(0.7 * k)
        yield pose_at(west_m + row * row_m + 0.03 * math.cos(k), north, _wrapped(heading), k)


def full_grid(spec: GridSpec, seed: int) -> LocalGrid:
    """A grid in which every cell is seen, mostly free, with some obstacles."""
    random = np.random.default_rng(seed)
    obstacle = random.random(spec.shape) < 0.1
    density = np.where(obstacle, random.integers(1, 256, spec.shape), 0).astype(np.uint8)
    return LocalGrid(spec, density, np.ones(spec.shape, dtype=np.bool_))


def _wrapped(heading_deg: float) -> float:
    return (heading_deg + 180.0) % 360.0 - 180.0
