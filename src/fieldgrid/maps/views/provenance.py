"""Where the value of a cell comes from: the frames that observed it, and what each said."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fieldgrid.geometry import Bounds, Lattice, Pose, Window
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.transfer import CELL_WEIGHT, MeanFold, Transfer


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
    total = MeanFold(lattice, cell, transfer)
    for frame in frames:
        grid, alone = frame.grid(), MeanFold(lattice, cell, transfer)
        total.add(grid, frame.pose)
        alone.add(grid, frame.pose)
        weight, weighted = (int(value) for value in alone.sums[:, 0, 0])
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
    density, observed = total.density()
    value = int(density[0, 0]) if observed[0, 0] else None
    return Provenance(east_m, north_m, lattice.bounds(cell), value, tuple(found))
