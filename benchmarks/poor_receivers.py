"""`python -m benchmarks.poor_receivers [TRIALS]`: two drives of decimetre receivers, neither of
which knows the place: what lies between them after alignment, along the rows and across.

The slow errors are made: a shift, a turn of the whole and a Gauss-Markov wander of 1 to 5 minutes
for each drive, with another seed in each run. The parts tell what it is that remains: with other
halves of a drive other lanes are shared. Data beside the repository in ../shared/data.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.align import LATER, SLOPE, Placed, built, displaced, frames_of, map_of
from fieldgrid.field import MapAlignment, align_map
from fieldgrid.field.align import pairs, score
from fieldgrid.field.align.alignment import FINE_M, FINE_REACH_M
from fieldgrid.field.align.pairs import overlapping, placed
from fieldgrid.field.align.score import SubmapCorrelator, peak
from fieldgrid.field.align.submaps import cut, draw
from fieldgrid.geometry import Lattice
from fieldgrid.maps import FrameRecord, MapFile, Transform, Wander, open_map

STATED_M = 0.27
"""What poses of the rendered decimetre logs state."""

ERROR_M = 0.3
"""What the made receivers err by along one axis, of the mean half, of the wander half of that."""

LEAST_INFORMATION = 100.0
"""Of shifts across the rows that are told to a decimetre, 1/m²."""

FACE_SHARE = 0.15
"""Of the smaller submap, seen by both."""

ALONG = np.array([0.6, 0.8])
"""The way of the rows of the rendered vineyards, east and north."""


def slow_error(random: np.random.Generator, frames: Sequence[FrameRecord]) -> Transform:
    """What a receiver of decimetres does to a drive whose poses follow odometry in between."""
    start, stop = frames[0].driven.time_ns, frames[-1].driven.time_ns
    times = np.linspace(start, stop, 25).astype(np.int64)
    fading = np.exp(-(times[1] - times[0]) / 1e9 / random.uniform(60.0, 300.0))
    shift = random.normal(0.0, ERROR_M / np.sqrt(2.0), 2)
    steps = [random.normal(0.0, 1.0, 2)]
    for _ in times[1:]:
        steps.append(fading * steps[-1] + np.sqrt(1.0 - fading**2) * random.normal(0.0, 1.0, 2))
    wander = np.array(steps) * ERROR_M / np.sqrt(2.0)
    shift += wander.mean(axis=0)
    wander = 0.5 * (wander - wander.mean(axis=0))
    east, north = (np.mean([getattr(f.driven, n) for f in frames]) for n in ("east_m", "north_m"))
    return Transform(
        *map(float, shift), float(random.normal(0.0, 0.1)), float(east), float(north),
        Wander(tuple(times.tolist()), tuple(wander[:, 0]), tuple(wander[:, 1])),
    )  # fmt: skip


def left(found: MapAlignment, sessions: dict[str, Placed]) -> tuple[float, ...] | None:
    """Metres along and across the rows between the means of two drives, degrees, and the sigma
    that was said; None where in doubt."""
    if not found.pairs or found.pairs[0].doubt is not None:
        return None
    means = []
    for drive in found.drives:
        moved = [(f.driven, drive.after.pose(pose)) for f, pose in sessions[drive.name]]
        means.append(
            np.mean(
                [
                    (
                        p.east_m - q.east_m,
                        p.north_m - q.north_m,
                        (p.heading_deg - q.heading_deg + 180.0) % 360.0 - 180.0,
                    )
                    for q, p in moved
                ],
                axis=0,
            )
        )
    off = means[1] - means[0]
    across = np.array([ALONG[1], -ALONG[0]])
    return float(ALONG @ off[:2]), float(across @ off[:2]), float(off[2]), found.pairs[0].sigma_m


def cases(universal: MapFile) -> Iterator[tuple[str, Sequence[FrameRecord], Sequence[FrameRecord]]]:
    """Two drives over one vineyard, in either order, and halves of each."""
    june, august = frames_of(universal, "june"), frames_of(universal, "august")
    h, g = len(june) // 2, len(august) // 2
    yield "June and August", june, august
    yield "August and June", august, june
    yield "June's lane of both, and August", june[h:], august
    yield "June, and August's lane of both", june, august[:g]
    yield "June's other lane, and August", june[:h], august
    yield "June, and August's other lane", june, august[g:]


def trials(folder: Path, universal: MapFile, count: int) -> None:
    """The table of made errors."""
    print(f"{'two receivers of decimetres':34s} runs doubts  left: median, worst cm; rms along, "
          "across cm; turn: median, worst °; within 3 sigma %")  # fmt: skip
    for name, first, second in cases(universal):
        random = np.random.default_rng(5)
        results = []
        for _ in range(count):
            sessions = {
                "a": displaced(first, slow_error(random, first), STATED_M),
                "b": displaced(second, slow_error(random, second), STATED_M),
            }
            with map_of(folder / "trial.gpkg", universal.datum, sessions) as trial:
                results.append(left(align_map(trial), sessions))
        told = np.array([one for one in results if one is not None]).reshape(-1, 4)
        line = f"{name:34s} {count:4d} {count - len(told):6d}"
        if len(told):
            off, turn = 100.0 * np.hypot(told[:, 0], told[:, 1]), np.abs(told[:, 2])
            along, across = 100.0 * np.sqrt((told[:, :2] ** 2).mean(axis=0))
            within = 100.0 * np.mean(off <= 300.0 * told[:, 3])
            line += f"   {np.median(off):5.1f} {off.max():5.1f}   {along:5.1f} {across:5.1f}   "
            line += f"{np.median(turn):5.2f} {turn.max():5.2f}   {within:5.1f}"
        print(line, flush=True)


def faces(universal: MapFile, names: Sequence[str]) -> None:
    """How far apart the opposite faces of rows are found, with drives at poses that are known."""
    lattice, told = Lattice(FINE_M), []
    # Neighbouring lanes share little ground; alignment itself asks for a quarter.
    with (
        mock.patch.object(pairs, "LEAST_SHARE", FACE_SHARE),
        mock.patch.object(score, "LEAST_SHARE", FACE_SHARE),
    ):
        for first in (None, 0, 1):  # all frames, and every other one: other parts of the same rows
            frames = [
                frames_of(universal, name)[first :: 1 if first is None else 2] for name in names
            ]
            pictures = [
                [draw(part, Transform(), lattice)[0] for part in cut(name, own)]
                for name, own in zip(names, frames, strict=True)
            ]
            overlaps = list(overlapping(pictures, lambda a, b: True))
            for one in overlaps:
                pair = placed(one, pictures)
                scores = SubmapCorrelator(pictures[pair.a][pair.k], FINE_REACH_M).scores(
                    pictures[pair.b][pair.l]
                )
                if scores is None or not pair.across.any():
                    continue
                shift, information = peak(scores, np.zeros(2))
                if float(pair.across @ information @ pair.across) > LEAST_INFORMATION:
                    told.append(100.0 * float(pair.across @ shift))
    print(f"faces of rows, {' and '.join(names)}: {len(told)} told, median {np.median(told):.1f}, "
          f"{np.percentile(told, 25):.1f} to {np.percentile(told, 75):.1f} cm")  # fmt: skip


def main() -> None:
    """Print what the opposite faces of rows are apart, and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trials", nargs="?", type=int, default=12)
    given = parser.parse_args()
    if not LATER.exists():
        print("../shared/data is not there; left out")
        return
    drives = {"june": (EXAMPLE, "gnss_rtk.nmea"), "august": (LATER, "gnss_rtk.nmea")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open_map(built(folder / "slope.gpkg", {"slope": (SLOPE, "gnss_rtk.nmea")})) as slope:
            faces(slope, ["slope"])
        with open_map(built(folder / "both.gpkg", drives)) as both:
            faces(both, ["june", "august"])
            trials(folder, both, given.trials)


if __name__ == "__main__":
    main()
