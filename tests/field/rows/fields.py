"""Small plantings of which everything is known, and how their rows are judged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.planting import Planting, Sight, seen_view
from fieldgrid.field import Planting as Found
from fieldgrid.geometry import GridSpec, LocalGrid, Pose, project, resampled
from fieldgrid.maps import MapView, create_map

Array = npt.NDArray[np.float64]
QUIET = Sight(noise_per_m2=0.02, hole_share=0.01, margin_m=6.0, headland_m=6.0)


def straight(
    count: int,
    length_m: float,
    spacing_m: float = 2.5,
    heading_deg: float = 0.0,
    at: tuple[float, float] = (0.0, 0.0),
) -> list[Array]:
    """Rows from left to right, as one who looks along the heading sees them."""
    phi = np.radians(heading_deg)
    ahead, right = np.array([np.sin(phi), np.cos(phi)]), np.array([np.cos(phi), -np.sin(phi)])
    first = [np.asarray(at) + k * spacing_m * right for k in range(count)]
    return [np.array([place, place + length_m * ahead]) for place in first]


def view_of(
    rows: Sequence[Array],
    sight: Sight = QUIET,
    *,
    cell_m: float = 0.1,
    half_width_m: float = 0.35,
    missing: Sequence[tuple[int, float, float]] = (),
    things: Sequence[tuple[float, float, float]] = (),
) -> MapView:
    """What a map of these rows would hold."""
    return seen_view(Planting(rows, half_width_m, missing, things), sight, cell_m)


def line_of(found: Found, true: Array) -> Array:
    """The line of the found row that lies on a true one; there must be exactly one."""
    lines = [np.asarray(row.line.coords) for row in found.rows]
    near = [line for line in lines if np.abs(project(line, true)[1]).mean() < 0.5]
    assert len(near) == 1, (len(near), len(lines))
    return near[0]


def rms_m(found: Array, true: Array) -> float:
    """Root mean square of how far off a true row the points of a found one lie."""
    return float(np.sqrt((project(resampled(found, 0.5), true)[1] ** 2).mean()))


BLOCK_M = 8.0
START_NS = 1_775_210_400_000_000_000


def write_map(path: Path, view: MapView, name: str = "june-03") -> Path:
    """A map file that holds a view: squares of 8 m are its frames, a drive of 5 s a frame."""
    cell_m, bounds = view.lattice.cell_m, view.bounds
    spec = GridSpec(width_m=BLOCK_M, length_m=BLOCK_M, cell_m=cell_m)
    side = round(BLOCK_M / cell_m)
    height, width = view.density.shape
    density = np.pad(view.density, ((0, -height % side), (0, -width % side)))
    observed = np.pad(view.observed, ((0, -height % side), (0, -width % side)))
    with create_map(path, view.datum, cell_m=cell_m) as universal:
        poses = [
            Pose(
                START_NS + 5_000_000_000 * n, bounds.west_m + (i + 0.5 * side) * cell_m,
                bounds.south_m + j * cell_m, 0.0, 0.0, 0.02, 0.5, 1.0,
            )
            for n, (j, i) in enumerate(np.ndindex(len(density) // side, density.shape[1] // side))
            for j, i in [(j * side, i * side)]
        ]  # fmt: skip
        with universal.add_session(name, source="made up") as session:
            places = np.ndindex(len(density) // side, density.shape[1] // side)
            for pose, (j, i) in zip(poses, places, strict=True):
                square = np.s_[j * side : (j + 1) * side, i * side : (i + 1) * side]
                session.add(LocalGrid(spec, density[square], observed[square]), pose)
    return path
