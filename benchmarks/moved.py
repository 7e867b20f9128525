"""What moved within a drive, where nothing did and where crates did: `python -m benchmarks.moved`.

The rendered drives show fields in which nothing moves, so each cell that is said to have moved is
false. Then crates of half a metre are put into the frames of the same drives, on ground that was
seen free, and taken away halfway through the frames that see their place. The data lie beside the
repository in ../shared/data.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.changes import EARLY, LATE, RTK, SF1, build
from benchmarks.heading_scores import DATA
from fieldgrid.core import Bool
from fieldgrid.geometry import Lattice, LocalGrid, Pose, Window
from fieldgrid.maps import (
    GROUPS,
    FrameCells,
    Transfer,
    WindowFold,
    footprint,
    land,
    open_map,
    to_universal,
)

DRIVES = (
    (EARLY, RTK),
    (EARLY, SF1),
    (LATE, RTK),
    (LATE, SF1),
    ("vineyard_slope", RTK),
)
"""Recordings, and the logs of their receivers."""

CRATE_M, TRIED, LEAST_LOOKS = 0.5, 300, 4
"""Side of the crates, how many places are tried in a drive, and the frames that must see one."""

Frames = Sequence[tuple[LocalGrid, Pose]]


def main() -> None:
    """Print a line a drive."""
    if not DATA.is_dir():
        print(f"{DATA}: not at hand, left out")
        return
    with tempfile.TemporaryDirectory() as folder:
        for recording, log in DRIVES:
            path = build(Path(folder) / f"{recording}-{log}.gpkg", [("drive", recording, log)])
            for line in score(path, f"{recording} {log}"):
                print(line, flush=True)


def score(path: Path, what: str) -> Iterator[str]:
    """What is said to have moved in a drive as it is, and of crates in it."""
    with open_map(path) as universal:
        lattice, transfer = Lattice(universal.cell_m), universal.transfer
        records = [f for f in universal.frames("drive", with_grid=True) if f.accepted]
        records.sort(key=lambda f: f.pose.time_ns)
        frames = [(f.grid(), f.pose) for f in records]
    window = around(frames, lattice)
    false, stands, seen = told(frames, lattice, window, transfer)
    yield (
        f"{what:<36} obstacles {stands.sum() * lattice.cell_m**2:6.1f} m²  "
        f"moved {false.sum() * lattice.cell_m**2:6.3f} m²"
    )
    clear_m = ndimage.distance_transform_edt(~stands) * lattice.cell_m - CRATE_M / 2.0
    random = np.random.default_rng(7)
    found: dict[str, list[float]] = {"beyond 1 m": [], "0.4 to 1 m": []}
    beside_m2 = 0.0
    for j, i in random.permutation(np.argwhere(seen & (clear_m > 0.4)))[:TRIED]:
        place = (i + window.i0 + 0.5) * lattice.cell_m, (j + window.j0 + 0.5) * lattice.cell_m
        one = with_crate(frames, place, lattice, transfer)
        if one is not None:
            found["beyond 1 m" if clear_m[j, i] > 1.0 else "0.4 to 1 m"].append(one[0])
            beside_m2 = max(beside_m2, one[1])
    for name, shares in found.items():
        if shares:
            yield (
                f"    {len(shares):3d} crates {name} from all else: told by half of their cells "
                f"{np.mean(np.array(shares) >= 0.5):4.0%}, of cells {np.median(shares):4.0%} "
                f"(median), worst {min(shares):4.0%}"
            )
    yield f"    beside a crate at most {beside_m2:.3f} m² said to have moved"


def around(frames: Frames, lattice: Lattice) -> Window:
    """The window of all frames."""
    places = [footprint(grid.spec, pose, lattice) for grid, pose in frames]
    i0, j0 = min(p.i0 for p in places), min(p.j0 for p in places)
    return Window(
        i0, j0, max(p.i0 + p.width for p in places) - i0, max(p.j0 + p.height for p in places) - j0
    )


def told(
    frames: Frames, lattice: Lattice, window: Window, transfer: Transfer
) -> tuple[Bool, Bool, Bool]:
    """The cells of a window that are said to have moved, those with a mean above 100, and those
    that were seen."""
    fold = WindowFold(lattice, window, transfer, (GROUPS["density"], GROUPS["moved"]))
    for grid, pose in frames:
        fold.add(FrameCells(grid, {}), pose)
    cells = fold.cells()
    stands = cells["sum"] > np.uint64(100) * cells["weight"]
    return cells["moved_drives"] > 0, stands, cells.observed


def with_crate(
    frames: Frames, place: tuple[float, float], lattice: Lattice, transfer: Transfer
) -> tuple[float, float] | None:
    """With a crate at a place in the first half of the frames that see it: the share of its cells
    that is told, and the square metres around it that are; None where few frames see it free."""
    sees = []
    for k, (grid, pose) in enumerate(frames):
        if np.hypot(pose.east_m - place[0], pose.north_m - place[1]) > grid.spec.reach_m:
            continue
        inside = crate_in(grid, pose, place)
        if inside.any() and grid.observed[inside].mean() > 0.5:
            if (grid.density[inside] > 50).any():
                return None
            sees.append(k)
    if len(sees) < LEAST_LOOKS:
        return None
    i, j = (int(value) for value in lattice.index(*place))
    around_m = round(2.0 / lattice.cell_m)
    window, changed = Window(i - around_m, j - around_m, 2 * around_m, 2 * around_m), list(frames)
    painted = np.zeros(window.shape, dtype=np.bool_)
    for k in sees[: len(sees) // 2]:
        grid, pose = frames[k]
        inside = crate_in(grid, pose, place) & grid.observed
        crate = LocalGrid(grid.spec, np.where(inside, 200, grid.density), grid.observed)
        changed[k] = crate, pose
        cell = land(crate, pose, lattice, window, Transfer.CENTRE).cell
        painted.reshape(-1)[cell[inside & (cell >= 0)]] = True
    moved, _, _ = told(changed, lattice, window, transfer)
    beside = moved & ~ndimage.binary_dilation(painted, iterations=2)
    return float(moved[painted].mean()), float(beside.sum() * lattice.cell_m**2)


def crate_in(grid: LocalGrid, pose: Pose, place: tuple[float, float]) -> Bool:
    """The local cells of a frame that a crate covers."""
    east_m, north_m = to_universal(*np.meshgrid(*grid.spec.centres_m()), pose)
    half_m = CRATE_M / 2.0
    return np.asarray((abs(east_m - place[0]) <= half_m) & (abs(north_m - place[1]) <= half_m))


if __name__ == "__main__":
    main()
