"""Small maps of terrain for the tests: drives over ground that is nowhere level, with steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray
from fieldgrid.geometry import (
    GROUND_CHANNEL,
    NO_GROUND_CM,
    STEP_CHANNEL,
    Datum,
    GridSpec,
    LocalGrid,
    Pose,
    Window,
)
from fieldgrid.maps import Readable, create_map
from tests.maps.file.maps import DATUM

LAYERS = ("ground", "ground_sigma", "slope", "roughness", "step", "height", "traversability")
SPEC = GridSpec(width_m=2.0, length_m=3.0, cell_m=0.05)


def write_drives(
    path: Path, drives: dict[str, float], *, datum: Datum = DATUM, cell_m: float = 0.05
) -> Path:
    """A new map of drives past the datum, each with its heading."""
    with create_map(path, datum, cell_m=cell_m) as universal:
        for name, heading_deg in drives.items():
            with universal.add_session(name) as session:
                for k in range(5):
                    session.add(*frame(k, heading_deg), frame_id=str(k), channels=relief(k))
    return path


def frame(k: int, heading_deg: float) -> tuple[LocalGrid, Pose]:
    """A frame of a drive: no two are of one height, and none sees the edges of its grid."""
    observed = np.zeros(SPEC.shape, np.bool_)
    observed[3:-4, 2:-5] = True
    phi, along_m = np.radians(heading_deg), 1.1 * k - 2.0
    pose = Pose(
        time_ns=1_000_000_000 * k,
        east_m=-1.31 + along_m * np.sin(phi),
        north_m=0.73 + along_m * np.cos(phi),
        up_m=0.7 - 0.31 * k + heading_deg / 100.0,
        heading_deg=heading_deg + k,
        position_sigma_m=0.02 + 0.01 * k,
        heading_sigma_deg=0.3,
        speed_mps=1.0,
    )
    return LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), observed), pose


def relief(seed: int) -> dict[str, AnyArray]:
    """Ground that rises away from the vehicle, with holes; steps in three fifths of it."""
    random = np.random.default_rng(seed)
    rise = np.rint(10.0 * SPEC.centres_m()[1])[:, None] + random.integers(0, 9, SPEC.shape)
    rise[random.random(SPEC.shape) > 0.9] = NO_GROUND_CM
    steps = np.where(random.random(SPEC.shape) > 0.4, random.integers(10, 60, SPEC.shape), 0)
    return {GROUND_CHANNEL: rise.astype(np.int16), STEP_CHANNEL: steps.astype(np.uint8)}


def assert_parts_are_those_of_the_whole(
    of: Readable,
    cell_m: float | None = None,
    *,
    count: int = 40,
    most_cells: int = 6,
    **how: Any,
) -> None:
    """Small windows of a view, some of them single cells, have what the whole has there."""
    whole, random = of.read(cell_m=cell_m, layers=LAYERS, **how), np.random.default_rng(7)
    rows, columns = np.nonzero(whole.observed)
    for k in random.integers(0, rows.size, count):
        place = whole.window.i0 + int(columns[k]), whole.window.j0 + int(rows[k])
        part = Window(*place, *random.integers(1, most_cells + 1, 2).tolist())
        part = part.intersect(whole.window)
        assert part is not None
        found = of.read(whole.lattice.bounds(part), cell_m, layers=LAYERS, **how)
        assert found.window == part
        for name in ("density", "observed", *LAYERS):
            there = whole.layer(name)[whole.window.slices_of(part)]
            np.testing.assert_array_equal(found.layer(name), there, f"{name} of {part}")
