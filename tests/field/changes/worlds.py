"""Worlds of boxes, and what a drive through them sees: ground up to the first box in each line of
sight, and the face of that box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import GridSpec, LocalGrid, Pose
from fieldgrid.maps import Transfer, create_map, to_universal
from tests.maps.file.maps import DATUM

SPEC = GridSpec(width_m=5.0, length_m=6.0, cell_m=0.1)
WIDE = GridSpec(width_m=10.0, length_m=4.0, cell_m=0.1)
DEPTH_M = 0.35
"""How deep a face is seen."""


class Box(NamedTuple):
    west_m: float
    south_m: float
    east_m: float
    north_m: float

    def holds(
        self, east_m: npt.NDArray[np.float64], north_m: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.bool_]:
        return np.asarray(
            (east_m >= self.west_m)
            & (east_m < self.east_m)
            & (north_m >= self.south_m)
            & (north_m < self.north_m)
        )


def pose(
    east_m: float, north_m: float, heading_deg: float, *, sigma_m: float = 0.02, time_ns: int = 0
) -> Pose:
    return Pose(time_ns, east_m, north_m, 0.0, heading_deg, sigma_m, 0.1, 1.0)


def lane(
    east_m: float, start: int = 0, *, sigma_m: float = 0.02, count: int = 6, step_m: float = 1.03
) -> list[Pose]:
    """Poses north along a lane."""
    return [
        pose(east_m, 0.013 + step_m * k, 0.0, sigma_m=sigma_m, time_ns=10**9 * (start + k))
        for k in range(count)
    ]


def seen(
    world: Sequence[Box], at: Pose, spec: GridSpec = SPEC, *, beneath: bool = False
) -> LocalGrid:
    """What a frame sees; with `beneath` also ground under what stands, and behind it, by rays that
    pass under it: at less than a fifth of the camera's height."""
    east_m, north_m = to_universal(*np.meshgrid(*spec.centres_m()), at)
    shares = np.linspace(0.0, 1.0, 45)[:, None, None]
    along_e = at.east_m + shares * (east_m - at.east_m)
    along_n = at.north_m + shares * (north_m - at.north_m)
    left_m = (1.0 - shares) * np.hypot(east_m - at.east_m, north_m - at.north_m)
    stands, blocked, over = np.zeros((3, *spec.shape), dtype=np.bool_)
    for box in world:
        inside = box.holds(along_e, along_n)
        stands |= box.holds(east_m, north_m)
        blocked |= (inside & (left_m > DEPTH_M)).any(axis=0)
        over |= (inside & (shares < 0.8)).any(axis=0)
    observed = ~blocked | (beneath & ~over)
    return LocalGrid(spec, np.where(stands & ~blocked, 200, 0).astype(np.uint8), observed)


Drive = tuple[Sequence[Box], Sequence[Pose]]


def world_map(
    path: Path,
    drives: Mapping[str, Drive],
    *,
    off_m: Mapping[str, tuple[float, float]] | None = None,
    spec: GridSpec = SPEC,
    beneath: bool = False,
    transfer: Transfer = Transfer.CENTRE,
) -> Path:
    """A map of drives by name: the world of each, and the poses. A drive that is `off_m` keeps
    poses that are so far east and north of where its frames were taken."""
    with create_map(path, DATUM, cell_m=0.1, transfer=transfer) as universal:
        for name, (world, poses) in drives.items():
            east_m, north_m = (off_m or {}).get(name, (0.0, 0.0))
            with universal.add_session(name) as session:
                for k, at in enumerate(poses):
                    kept = replace(at, east_m=at.east_m + east_m, north_m=at.north_m + north_m)
                    grid = seen(world, at, spec, beneath=beneath)
                    session.add(grid, kept, frame_id=f"{k:04d}")
    return path
