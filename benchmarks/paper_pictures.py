"""The pictures of docs/paper.md: Figs. 7 to 14 of Rovira-Más (2012), with the example drive.

python -m benchmarks.paper_pictures RECORDING LATER_RECORDING docs

RECORDING is the example, LATER_RECORDING a second drive through the same field. Local grids are
made once; each map places them by headings of its own, and rejects none, as the paper does.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from fieldgrid.core import BuildSettings
from fieldgrid.export.figures.drives import draw_heading, draw_trajectory, drives_of
from fieldgrid.export.figures.grid import draw_grid
from fieldgrid.geometry import Bounds, LocalGrid, Status, Trajectory, wrap_deg
from fieldgrid.maps import MapFile, open_map
from fieldgrid.pipeline import estimate_trajectory, local_grid
from fieldgrid.recordings import Recording, open_recording

DPI = 90
FINE_M, COARSE_M = 0.05, 0.25
STRAIGHT_DEG = 8.0
"""The first lane ends where the heading has left its first value by more than this."""

LANE = Bounds(-21.0, 40.0, 4.0, 73.0)
DETAIL = Bounds(-14.0, 50.0, 4.0, 68.0)
HEADLAND = Bounds(-6.0, 60.0, 14.0, 80.0)
SEASON = Bounds(-20.0, 40.0, 10.0, 72.0)

Frames = Sequence[tuple[str, int, LocalGrid]]
"""Name, time in nanoseconds and grid of each frame of a drive."""


def grids_of(recording: Recording) -> Frames:
    """The local grids of a drive."""
    return [
        (frame.frame_id, frame.time_ns, local_grid(frame, recording.rig))
        for frame in recording.frames()
    ]


def with_heading(recording: Recording, heading: str) -> Trajectory:
    """The trajectory of a drive with headings of one source."""
    settings = BuildSettings()
    pose = settings.pose.model_copy(update={"heading": heading})
    return estimate_trajectory(recording, settings.model_copy(update={"pose": pose}))


def placed(path: Path, drives: Sequence[tuple[str, Trajectory, Frames]]) -> MapFile:
    """A map of all frames of some drives, none of them rejected."""
    universal = open_map(path, datum=drives[0][1].datum, cell_m=FINE_M)
    for name, trajectory, frames in drives:
        with universal.add_session(name, trajectory=trajectory) as session:
            for frame_id, time_ns, grid in frames:
                pose = replace(trajectory.at(time_ns), status=Status.OK, reason="")
                session.add(grid, pose, frame_id=frame_id)
    return universal


def first_lane(frames: Frames, trajectory: Trajectory) -> Frames:
    """The frames before the first turn."""
    headings = np.array([trajectory.at(time_ns).heading_deg for _, time_ns, _ in frames])
    turned = np.abs(wrap_deg(headings - headings[0])) > STRAIGHT_DEG
    return frames[: int(turned.argmax())]


def mean_heading(frames: Frames, trajectory: Trajectory) -> float:
    """The heading of the line through the positions of a straight lane, in degrees."""
    poses = [trajectory.at(frames[k][1]) for k in (0, -1)]
    east_m, north_m = (poses[1].east_m - poses[0].east_m, poses[1].north_m - poses[0].north_m)
    return float(np.degrees(np.arctan2(east_m, north_m)))


def panels(width_in: float, height_in: float, count: int) -> tuple[Figure, list[plt.Axes]]:
    """A row of axes."""
    figure, places = plt.subplots(1, count, figsize=(width_in, height_in), layout="constrained")
    return figure, list(places)


def draw_row(folder: Path, target: Path, recording: Recording, frames: Frames) -> None:
    """Figs. 7 to 9: a row, its heading, and the grid by two headings and at two cell sizes."""
    smooth, course = (with_heading(recording, name) for name in ("smooth", "course"))
    lane = first_lane(frames, smooth)
    constant_deg = mean_heading(lane, smooth)
    constant = with_heading(recording, f"constant:{constant_deg:.1f}")
    by_course = placed(folder / "row.gpkg", [("row", course, lane)])
    by_constant = placed(folder / "constant.gpkg", [("row", constant, lane)])
    figure, places = panels(13.0, 4.2, 2)
    driven = drives_of(by_course)
    draw_trajectory(places[0], driven)
    draw_heading(places[1], driven[0])
    figure.savefig(target / "paper_7.png", dpi=DPI)
    figure, places = panels(13.0, 4.6, 3)
    for axes, universal, cell_m, title in (
        (places[0], by_course, FINE_M, "heading from GNSS, 5 cm"),
        (places[1], by_constant, FINE_M, f"heading {constant_deg:.1f}° throughout, 5 cm"),
        (places[2], by_course, COARSE_M, "heading from GNSS, 25 cm"),
    ):
        draw_grid(axes, universal.read(LANE, cell_m=cell_m), (), title)
    figure.savefig(target / "paper_8_9.png", dpi=DPI)


def draw_drive(folder: Path, target: Path, recording: Recording, frames: Frames) -> None:
    """Figs. 10 and 11: several lanes, and a detail; Fig. 14: the headland by two headings."""
    course, smooth = (
        placed(folder / f"{name}.gpkg", [("drive", with_heading(recording, name), frames)])
        for name in ("course", "smooth")
    )
    figure, places = panels(13.0, 4.6, 3)
    driven = drives_of(smooth)
    draw_trajectory(places[0], driven)
    draw_heading(places[1], driven[0])
    draw_grid(places[2], smooth.read(DETAIL, cell_m=COARSE_M), (), "detail, 25 cm")
    figure.savefig(target / "paper_10_11.png", dpi=DPI)
    figure, places = panels(13.0, 4.6, 3)
    draw_heading(places[0], drives_of(course)[0])
    for axes, universal, title in (
        (places[1], course, "headland, the paper's heading"),
        (places[2], smooth, "headland, one estimate"),
    ):
        draw_grid(axes, universal.read(HEADLAND, cell_m=0.1), (), title)
    figure.savefig(target / "paper_14.png", dpi=DPI)


def draw_season(folder: Path, target: Path, drives: Sequence[tuple[Recording, Frames]]) -> None:
    """Figs. 12 and 13: the lanes of several missions, and the middle of their map."""
    datum = estimate_trajectory(drives[0][0]).datum
    parts = [
        (recording.name, estimate_trajectory(recording, datum=datum), frames)
        for recording, frames in drives
    ]
    universal = placed(folder / "season.gpkg", parts)
    figure, places = panels(13.0, 5.2, 2)
    draw_trajectory(places[0], drives_of(universal))
    draw_grid(places[1], universal.read(SEASON, cell_m=COARSE_M), (), "both drives, 25 cm")
    figure.savefig(target / "paper_12_13.png", dpi=DPI)


def main() -> None:
    """Draw all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("later", type=Path)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        open_recording(given.recording, gnss="gnss_rtk.nmea") as recording,
        open_recording(given.later, gnss="gnss_rtk.nmea") as later,
    ):
        frames = grids_of(recording)
        draw_row(Path(folder), given.folder, recording, frames)
        draw_drive(Path(folder), given.folder, recording, frames)
        drives = [(recording, frames), (later, grids_of(later))]
        draw_season(Path(folder), given.folder, drives)


if __name__ == "__main__":
    main()
