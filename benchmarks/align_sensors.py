"""`python -m benchmarks.align_sensors`: drives of other sensors and cell sizes, aligned.

June's drive over the rendered vineyard with its decimetre log, seen by another sensor or in other
cells, comes to a stereo drive with RTK: June's, which saw the same leaves, and August's. Data
beside the repository in ../shared/data are left out where they are absent.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.align import LATER, pose_errors
from benchmarks.other_sensors import clouds, of_clouds, of_depths
from fieldgrid.core import BuildSettings
from fieldgrid.field import align_map
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions

SF1, RTK = "gnss_sf1.nmea", "gnss_rtk.nmea"

OTHER_CELLS_M = 0.1, 0.2, 0.25

MAP_CELL_M = 0.25

SPARSE = 30
"""Of the points of a cloud one in so many is kept: some thousand, as a lidar of few beams has."""


def add(path: Path, name: str, drive: Path, log: str, cell_m: float = 0.05) -> None:
    """A drive becomes a session of the map, in local cells of some size."""
    settings = BuildSettings()
    grid = settings.grid.model_copy(update={"cell_m": cell_m})
    settings = settings.model_copy(
        update={"grid": grid, "map": settings.map.model_copy(update={"cell_m": MAP_CELL_M})}
    )
    options = DriveOptions(gnss=drive / "gnss" / log)
    build_map([drive], path, settings, options, append=path.exists(), name=name)


def recordings(folder: Path) -> Mapping[str, tuple[Path, float]]:
    """June's drive as other sensors have it: the recording, and the side of its local cells."""
    made = {"depth images": of_depths, "clouds": of_clouds, "sparse clouds": of_clouds}
    found = {"stereo": (EXAMPLE, 0.05)}
    for name, of in made.items():
        recording = folder / name
        found[name] = of(recording), 0.05
        shutil.copy(EXAMPLE / "gnss" / SF1, recording / "gnss")
    clouds(lambda flu: flu[::SPARSE])(folder / "sparse clouds")
    found["sparse clouds, cells of 0.20 m"] = folder / "sparse clouds", 0.2
    for cell_m in OTHER_CELLS_M:
        found[f"stereo, cells of {cell_m:.2f} m"] = EXAMPLE, cell_m
    return found


def report(path: Path, what: str, truth: Path) -> None:
    """A line: how far the drives lie apart before and after, and what is said."""
    drives = {"poor": EXAMPLE, "good": truth}
    with open_map(path, writable=True) as universal:
        before, after = {}, {}
        for name, drive in drives.items():
            before[name] = pose_errors(universal, name, drive)[:, :2].mean(axis=0)
        found = align_map(universal)
        universal.set_transforms(found.transforms)
        for name, drive in drives.items():
            after[name] = pose_errors(universal, name, drive)[:, :2].mean(axis=0)
    (pair,) = found.pairs
    off, left = (100.0 * np.hypot(*errors["poor"]) for errors in (before, after))
    moved = 100.0 * np.hypot(*(after["good"] - before["good"]))
    print(
        f"{what:47s} {off:5.1f} {left:5.1f}   {100.0 * pair.sigma_m:4.1f} cm   RTK moved "
        f"{moved:.1f} cm{'' if pair.doubt is None else f'; {pair.doubt}'}",
        flush=True,
    )


def main() -> None:
    """Print a line for each sensor, beside each stereo drive with RTK."""
    print(f"{'June SF1 by another sensor, off the truth (cm)':47s} before, after; said")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for what, (recording, cell_m) in recordings(folder).items():
            for season, drive in (("June", EXAMPLE), ("August", LATER)):
                if drive.exists():
                    path = folder / "map.gpkg"
                    path.unlink(missing_ok=True)
                    add(path, "good", drive, RTK)
                    add(path, "poor", recording, SF1, cell_m)
                    report(path, f"{what}; {season}'s stereo", drive)


if __name__ == "__main__":
    main()
