"""Where the value of a cell comes from: the frames that observed it, and what each said."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fieldgrid.geometry import Bounds, Lattice, Pose, Window
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.transfer import CELL_WEIGHT, MeanFold, Transfer, mean_density


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one frame said of a cell.

    `cells` is how many of its local cells fell into it (parts of cells by the area rule);
    `density` is their mean.
    """

    session: str
    frame_id: str
    density: float
    cells: float
    pose: Pose
    quality: int | None
    images: tuple[str, ...]
    images_sha256: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Provenance:
    """A universal cell, the point that was asked for, and the frames that observed the cell.

    `density` is None where nothing was observed.
    """

    east_m: float
    north_m: float
    bounds: Bounds
    density: int | None
    contributions: tuple[Contribution, ...]


def trace(
    east_m: float,
    north_m: float,
    lattice: Lattice,
    transfer: Transfer,
    frames: Iterable[FrameRecord],
) -> Provenance:
    """The contributions of frames, in the order given, to the cell that holds a point."""
    i, j = (int(index) for index in lattice.index(east_m, north_m))
    cell = Window(i, j, 1, 1)
    found: list[Contribution] = []
    total = np.zeros((2, 1), np.uint64)
    for frame in frames:
        alone = MeanFold(lattice, cell, transfer)
        alone.add(frame.grid(), frame.pose)
        total += alone.sums[:, 0]
        weight, weighted = alone.sums[:, 0, 0].tolist()
        if weight:
            found.append(
                Contribution(
                    session=frame.session,
                    frame_id=frame.frame_id,
                    density=weighted / weight,
                    cells=weight / CELL_WEIGHT,
                    pose=frame.pose,
                    quality=frame.quality,
                    images=frame.images,
                    images_sha256=frame.images_sha256,
                )
            )
    density, observed = mean_density(*total)
    value = int(density[0]) if observed[0] else None
    return Provenance(east_m, north_m, lattice.bounds(cell), value, tuple(found))
