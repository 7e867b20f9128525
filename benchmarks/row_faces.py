"""`python -m benchmarks.row_faces`: whether one row, seen from the lanes on both sides of it, tells
how the slow error of a single drive differs between these lanes.

Either lane sees its own face of the row, so that the two lie apart by the thickness of the canopy,
which nothing else tells. If that were the same all along the row, what it changes by would be the
slow error. At poses of RTK the thickness is measured itself, in parts of the row; at those of the
decimetre log of the same drive, of which the true errors are known, what it would tell. Data beside
the repository in ../shared/data.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.align import LATER, SLOPE, built, frames_of, pose_errors
from fieldgrid.core import Float64
from fieldgrid.maps import open_map, to_universal

OBSTACLE, BESIDE_M, FEWEST = 100, 0.9, 30
"""Cells of so much density, so near the middle between the lanes, are of the row; a part of it is
seen from a lane in so many of them at least."""

PARTS_M = 2.0, 4.0, 8.0


class Seen(NamedTuple):
    """What one lane shows of the row, by cells [n]: how far along and across it lies, its density,
    and how far the pose was off across the row."""

    along_m: Float64
    across_m: Float64
    weight: Float64
    error_m: Float64


def lanes_of(made: Path, drive: Path) -> list[Seen]:
    """What the two lanes of a drive show of the row between them: first the lane on its right."""
    with open_map(made) as universal:
        frames = frames_of(universal, "a")
        errors_m = pose_errors(universal, "a", drive)[:, :2]
        heading = np.radians([frame.driven.heading_deg for frame in frames])
        turn = 0.5 * np.angle(np.exp(2j * heading).sum())
        along = np.array([np.sin(turn), np.cos(turn)])
        right = np.array([along[1], -along[0]])
        places_m = np.array([(f.driven.east_m, f.driven.north_m) for f in frames]) - errors_m
        ways = [np.flatnonzero(way * np.cos(heading - turn) > 0.9) for way in (1.0, -1.0)]
        ways.sort(key=lambda way: -float(np.median(places_m[way] @ right)))
        middle_m = np.mean([np.median(places_m[way] @ right) for way in ways])
        lanes = []
        for way in ways:
            cells = []
            for n in way:
                grid = frames[n].grid()
                x, y = np.meshgrid(*grid.spec.centres_m())
                full = grid.density >= OBSTACLE
                place_m = np.column_stack(to_universal(x[full], y[full], frames[n].driven))
                across_m = place_m @ right - middle_m
                error_m = np.full(len(place_m), errors_m[n] @ right)
                cell = np.column_stack([place_m @ along, across_m, grid.density[full], error_m])
                cells.append(cell[np.abs(across_m) < BESIDE_M])
            lanes.append(Seen(*np.concatenate(cells).T))
    return lanes


def apart_m(lanes: list[Seen], start_m: float, long_m: float) -> tuple[float, float]:
    """How far apart the two see a part of the row, and how far apart the poses put it."""
    middles, errors = [], []
    for seen in lanes:
        here = (seen.along_m >= start_m) & (seen.along_m < start_m + long_m)
        if np.count_nonzero(here) < FEWEST:
            return np.nan, np.nan
        weight = seen.weight[here]
        middles.append(np.average(seen.across_m[here], weights=weight))
        errors.append(np.average(seen.error_m[here], weights=weight))
    return float(middles[0] - middles[1]), float(errors[0] - errors[1])


def report(folder: Path, drive: Path) -> None:
    """A line for each length of the parts."""
    logs = [
        lanes_of(
            built(folder / f"{drive.name}-{log}.gpkg", {"a": (drive, f"gnss_{log}.nmea")}), drive
        )
        for log in ("rtk", "sf1")
    ]
    ends = np.array([np.percentile(seen.along_m, [1.0, 99.0]) for seen in logs[0]])
    start_m, stop_m = ends[:, 0].max(), ends[:, 1].min()
    for long_m in PARTS_M:
        starts = np.arange(start_m, stop_m - long_m / 2.0, long_m)
        found = 100.0 * np.array([[apart_m(of, at, long_m) for of in logs] for at in starts])
        found = found[np.isfinite(found).all(axis=(1, 2))]
        thick = found[:, 0, 0] - found[:, 0, 1]
        told, true = found[:, 1].T
        left = (told - told.mean()) - (true - true.mean())
        print(
            f"{drive.name:24s} {len(found):3d} of {long_m:.0f} m   {thick.mean():5.1f} ± "
            f"{thick.std():3.1f}   {true.mean():+5.1f} ± {true.std():3.1f}   {left.std():4.1f}",
            flush=True,
        )


def main() -> None:
    """Print the table."""
    print(f"{'parts of the row':38s} thickness    lanes apart     left of its change (cm)")
    with tempfile.TemporaryDirectory() as folder:
        for drive in (EXAMPLE, LATER, SLOPE):
            if drive.exists():
                report(Path(folder), drive)


if __name__ == "__main__":
    main()
