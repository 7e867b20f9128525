"""A field that was seen from lanes: rows of plants, each plant of its own, or all alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldgrid.core import Bool, Float64
from fieldgrid.geometry import Datum, GridSpec, LocalGrid, Pose
from fieldgrid.maps import Transform, create_map, to_universal

DATUM = Datum(41.6, -4.7, 700.0)
SPEC = GridSpec(width_m=6.0, length_m=10.0, cell_m=0.1)
SPACING_M, LENGTH_M = 2.6, 44.0

Drive = Sequence[tuple[LocalGrid, Pose]]


class Field:
    """Rows that run north at east = ±SPACING_M / 2, ±3 SPACING_M / 2 ... of plants `wide_m` wide.

    Plants are half a metre to a metre long with gaps between, drawn with a seed; `even` rows are
    walls without an end.
    """

    def __init__(self, seed: int = 0, *, even: bool = False, wide_m: float = 0.5) -> None:
        self._wide_m = wide_m
        self._random = np.random.default_rng(seed)
        self._even = even
        self._edges = {
            row: np.cumsum(self._random.uniform(0.25, 1.1, 160)) - 20.0 for row in range(-8, 8)
        }

    def is_plant(self, east_m: Float64, north_m: Float64) -> Bool:
        """Whether points lie in a plant."""
        row = np.floor(east_m / SPACING_M).astype(np.int64)
        across = np.abs(east_m - (row + 0.5) * SPACING_M)
        found = across < self._wide_m / 2.0
        if self._even:
            return found
        found &= (north_m > 0.0) & (north_m < LENGTH_M)
        for number, edges in self._edges.items():
            here = row == number
            # Every other interval is a plant.
            found[here] &= np.searchsorted(edges, north_m[here]) % 2 == 1
        return found

    def seen_from(self, pose: Pose, random: np.random.Generator) -> LocalGrid:
        """What a frame sees ahead: some cells are missed, a few are wrong."""
        x, y = np.meshgrid(*SPEC.centres_m())
        east, north = to_universal(x, y, pose)
        plant = self.is_plant(east, north)
        seen = (y > 2.0) & (np.abs(x) < 0.35 * y) & (random.random(x.shape) < 0.8)
        density = np.where(plant, random.integers(120, 240, x.shape), 0)
        density = np.where(random.random(x.shape) < 0.01, 200 - density.clip(0, 200), density)
        return LocalGrid(SPEC, np.where(seen, density, 0).astype(np.uint8), seen)

    def drive(
        self,
        lanes: Sequence[float],
        *,
        by: Transform | None = None,
        sigma_m: float = 0.35,
        seed: int = 1,
        start_s: float = 0.0,
    ) -> Drive:
        """Frames every 1.5 m along lanes at these easts, up the first, down the next; poses are off
        by a transform."""
        random = np.random.default_rng(seed)
        frames, time_s = [], start_s
        for number, east in enumerate(lanes):
            up = number % 2 == 0
            norths = np.arange(-4.0, LENGTH_M - 4.0, 1.5)
            for north in norths if up else LENGTH_M - norths:
                pose = Pose(
                    int(1e9 * time_s), float(east), float(north), 0.0, 0.0 if up else 180.0,
                    sigma_m, 0.3, 1.5,
                )  # fmt: skip
                said = pose if by is None else by.pose(pose)
                frames.append((self.seen_from(pose, random), said))
                time_s += 1.0
        return frames


def write_field(path: Path, drives: Mapping[str, Drive], cell_m: float = 0.25) -> Path:
    """A map of drives."""
    with create_map(path, DATUM, cell_m=cell_m) as universal:
        for name, frames in drives.items():
            with universal.add_session(name) as session:
                for grid, pose in frames:
                    session.add(grid, replace(pose))
    return path


def along_one_lane(names: Sequence[str]) -> dict[str, Drive]:
    """Drives of good receivers along one lane."""
    field = Field()
    return {
        name: field.drive([0.0], sigma_m=0.02, seed=seed, start_s=1e5 * seed)
        for seed, name in enumerate(names)
    }


def mixed(frames: Drive, by: Transform, sigma_m: float, part: slice) -> Drive:
    """Frames of which some lie elsewhere and state another error."""
    some = set(range(len(frames))[part])
    return [
        (grid, replace(by.pose(pose), position_sigma_m=sigma_m) if k in some else pose)
        for k, (grid, pose) in enumerate(frames)
    ]


def left_m(
    found: Mapping[str, Transform], drives: Mapping[str, Drive], true: Mapping[str, Drive]
) -> Float64:
    """Where the frames of each drive lie after transforms, less where they were: [drives, 2]."""
    off = []
    for name, frames in drives.items():
        moved = [found.get(name, Transform()).pose(pose) for _, pose in frames]
        were = [pose for _, pose in true[name]]
        off.append(
            np.mean(
                [
                    (p.east_m - q.east_m, p.north_m - q.north_m)
                    for p, q in zip(moved, were, strict=True)
                ],
                axis=0,
            )
        )
    return np.array(off)
