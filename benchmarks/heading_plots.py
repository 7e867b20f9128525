"""What is wrong, as pictures: the harvester's backed-up pieces, and headings against truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import heading_harvester, heading_vineyard
from benchmarks.heading_scores import poses_at
from fieldgrid.geometry import wrap_deg

ROWS_AROUND = 40


def draw(folder: Path) -> None:
    """A picture for each harvester log with failing pieces, and one for each vineyard variant."""
    if heading_harvester.FOLDER.exists():
        for log in heading_harvester.logs():
            _harvester(log, folder)
    if heading_vineyard.TRUTH.exists():
        for variant in heading_vineyard.VARIANTS:
            _rendered(variant, folder)


def _harvester(log: heading_harvester.Log, folder: Path) -> None:
    from matplotlib import pyplot

    found = heading_harvester.estimate(log, speeds=False)
    gear = found.trajectory.gear[found.fix_row]
    points = log.points()
    pieces = [
        piece
        for piece in heading_harvester.backed_up(log)
        if (gear[piece.first + 1 : piece.last] > 0).any()
    ]
    if not pieces:
        return
    columns = 4
    rows = -(-len(pieces) // columns)
    figure, axes = pyplot.subplots(rows, columns, figsize=(5 * columns, 5 * rows), squeeze=False)
    for axis, piece in zip(axes.flat, pieces, strict=False):
        around = slice(max(piece.first - ROWS_AROUND, 0), piece.last + ROWS_AROUND)
        place, gears, work = points[around], gear[around], log.work[around]
        axis.plot(*place.T, color="0.7", lw=0.8)
        for value, colour in ((1, "tab:green"), (0, "0.4"), (-1, "tab:red")):
            axis.scatter(*place[gears == value].T, s=10, color=colour)
        axis.scatter(*place[work].T, s=45, facecolors="none", edgecolors="tab:blue")
        axis.plot(*points[[piece.first, piece.last]].T, "k*", ms=9)
        axis.annotate("start", place[0])
        kind = "both" if piece.both else "loose"
        axis.set_title(f"{log.name} rows {piece.first}-{piece.last} {kind}", fontsize=8)
        axis.set_aspect("equal")
    figure.tight_layout()
    figure.savefig(folder / f"harvester_{log.name}.png", dpi=60)
    pyplot.close(figure)


def _rendered(variant: heading_vineyard.Variant, folder: Path) -> None:
    from matplotlib import pyplot

    truth = heading_vineyard.read_truth()
    trajectory = heading_vineyard.estimate(variant)[0].trajectory
    poses = poses_at(trajectory, truth.time_ns)
    seconds = (truth.time_ns - truth.time_ns[0]) / 1e9
    off = np.asarray(wrap_deg(poses.heading_deg - truth.heading_deg))
    figure, (track, error, gears) = pyplot.subplots(3, 1, figsize=(12, 14))
    track.plot(truth.east_m, truth.north_m, "k", lw=0.8)
    track.scatter(poses.east_m, poses.north_m, c=poses.gear, s=6, cmap="RdYlGn")
    track.set_aspect("equal")
    error.plot(seconds, np.clip(off, -30.0, 30.0), ".", ms=3)
    error.plot(seconds, 3.0 * np.minimum(poses.sigma_deg, 10.0), "0.6")
    gears.plot(seconds, truth.gear, "k", seconds, 0.9 * poses.gear, "r.", ms=3)
    gears.plot(seconds, truth.speed_mps, "b", lw=0.7)
    gears.plot(seconds, poses.accepted - 3.0, "g")
    track.set_title(variant.name)
    figure.savefig(
        folder / f"rendered_{variant.name.replace(', ', '_').replace(' ', '-')}.png", dpi=60
    )
    pyplot.close(figure)
