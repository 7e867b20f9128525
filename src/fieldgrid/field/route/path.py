"""A way to drive."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import heading_from_yaw_rad


class Path(NamedTuple):
    """Poses of the reference point in the order of driving, arrays [n].

    Metres east and north, heading of the nose in degrees clockwise from north, gear (1 or -1) and
    curvature (1/m, positive to the left of the nose) of the stretch that begins at each pose. Where
    the gear changes, two poses are the same.
    """

    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    gear: Int64
    curvature_1pm: Float64

    @classmethod
    def of_samples(cls, samples: Float64, west_m: float, south_m: float) -> Path:
        """From rows of x, y, yaw, gear, curvature, metres from a corner."""
        return cls(
            samples[:, 0] + west_m,
            samples[:, 1] + south_m,
            heading_from_yaw_rad(samples[:, 2]),
            samples[:, 3].astype(np.int64),
            samples[:, 4].copy(),
        )

    @property
    def steps_m(self) -> Float64:
        """Metres from each pose to the next [n - 1]."""
        return np.hypot(np.diff(self.east_m), np.diff(self.north_m))


def joined(parts: list[Float64]) -> Float64:
    """Rows of x, y, yaw, gear, curvature of ways that follow each other; the gear of the last row
    of each is the one that arrives there. A pose between two is written once, but for a change of
    gear."""
    kept = [part for part in parts if len(part) > 1]
    cut = [
        part[:-1] if part[-1, 3] == after[0, 3] else part
        for part, after in itertools.pairwise(kept)
    ]
    return np.concatenate([*cut, kept[-1]])
