"""Submaps: what a session saw along some metres of its drive, as pictures that can be compared.

Within a submap the poses are trusted: over some metres camera, gyro and receiver are good to
centimetres, while the slow error of a receiver moves a submap as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, UInt8
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import (
    GROUP,
    Cells,
    FrameCells,
    FrameRecord,
    Transfer,
    Transform,
    WindowFold,
    footprint,
)

SUBMAP_M = 8.0
"""Metres of driving after which a submap ends."""

PAUSE_NS = 30_000_000_000
"""A submap also ends where nothing was seen for this time: a receiver wanders meanwhile."""

FULL = 150.0
"""Densities from here on say obstacle with full weight; half of it is a potential obstacle."""


@dataclass(frozen=True, slots=True)
class Submap:
    """Frames of one session that follow each other."""

    session: str
    frames: tuple[FrameRecord, ...]

    @property
    def time_ns(self) -> int:
        """The middle of its time."""
        return (self.frames[0].driven.time_ns + self.frames[-1].driven.time_ns) // 2

    def driven_m(self) -> Float64:
        """The middle of its poses as driven [2], east and north."""
        points = np.array([[f.driven.east_m, f.driven.north_m] for f in self.frames])
        return np.asarray(points.mean(axis=0))


class SubmapImage(NamedTuple):
    """The obstacles of a submap over a window of a lattice: `value` 0..255, 0 where not `seen`;
    `track_m` are the places of its poses [n, 2], east and north, `facing` [2] the way that they
    look, a unit vector; `cells` is how many were seen."""

    lattice: Lattice
    window: Window
    value: UInt8
    seen: Bool
    track_m: Float64
    facing: Float64
    cells: int


def cut(session: str, frames: Sequence[FrameRecord]) -> Iterator[Submap]:
    """The submaps of a session, from its accepted frames in the order of time."""
    part: list[FrameRecord] = []
    driven_m = 0.0
    for frame in frames:
        if part:
            last, here = part[-1].driven, frame.driven
            driven_m += float(np.hypot(here.east_m - last.east_m, here.north_m - last.north_m))
            late = here.time_ns - last.time_ns
            # Frames of one moment stay together: submaps follow each other in time.
            if late > 0 and (driven_m > SUBMAP_M or late > PAUSE_NS):
                yield Submap(session, tuple(part))
                part, driven_m = [], 0.0
        part.append(frame)
    if part:
        yield Submap(session, tuple(part))


def draw(
    submap: Submap, transform: Transform, lattice: Lattice, turns_deg: Sequence[float] = (0.0,)
) -> list[SubmapImage]:
    """What the frames of a submap saw, each at its pose as driven, transformed; a picture for each
    turn about the middle of the submap."""
    poses = [transform.pose(frame.driven) for frame in submap.frames]
    grids = [frame.grid() for frame in submap.frames]
    east_m, north_m = np.mean([(pose.east_m, pose.north_m) for pose in poses], axis=0).tolist()
    pictures = []
    for turn_deg in turns_deg:
        turn = Transform(0.0, 0.0, turn_deg, east_m, north_m)
        turned = [turn.pose(pose) for pose in poses] if turn_deg else poses
        specs = (frame.spec for frame in submap.frames)
        windows = [footprint(spec, at, lattice) for spec, at in zip(specs, turned, strict=True)]
        window = reduce(Window.union, windows)
        # By their centres cells leave holes in cells that are hardly larger.
        local_m = max(frame.spec.cell_m for frame in submap.frames)
        rule = Transfer.CENTRE if lattice.cell_m >= np.sqrt(2.0) * local_m else Transfer.AREA
        fold = WindowFold(lattice, window, rule, [GROUP])
        for grid, pose in zip(grids, turned, strict=True):
            fold.add(FrameCells(grid, {}), pose)
        cells = fold.cells()
        # The part that was seen; one cell where none was.
        rows, columns = (np.flatnonzero(cells.observed.any(axis=axis)) for axis in (1, 0))
        j0, j1 = (int(rows[0]), int(rows[-1])) if len(rows) else (0, 0)
        i0, i1 = (int(columns[0]), int(columns[-1])) if len(columns) else (0, 0)
        window = Window(window.i0 + i0, window.j0 + j0, i1 - i0 + 1, j1 - j0 + 1)
        cells = Cells({k: of[j0 : j1 + 1, i0 : i1 + 1] for k, of in cells.items()})
        weight, seen = cells["weight"], cells.observed
        density = cells["sum"] / np.maximum(weight, np.uint64(1))
        value = np.minimum(density * (255.0 / FULL), 255.0).astype(np.uint8)
        track = np.array([[pose.east_m, pose.north_m] for pose in turned])
        heading = np.radians([pose.heading_deg for pose in turned])
        facing = np.array([np.sin(heading).sum(), np.cos(heading).sum()])
        facing /= max(float(np.hypot(*facing)), 1e-9)
        pictures.append(
            SubmapImage(lattice, window, value, seen, track, facing, int(np.count_nonzero(seen)))
        )
    return pictures
