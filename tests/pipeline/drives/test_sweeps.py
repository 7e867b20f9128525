"""Maps of a lidar that turns while it drives: walls of a yard, with and without times of points."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import resolve
from fieldgrid.maps import open_map
from fieldgrid.pipeline import SessionReport, build_map, convert_recording, repose_map
from fieldgrid.pipeline.repose import _of_sweeps
from fieldgrid.recordings import CloudFrame, open_drive, open_recording
from tests.pipeline.drives.yard import SETTINGS, SWEEPS, off_m, recorded


def built(folder: Path, out: Path, **more: object) -> SessionReport:
    (report,) = build_map([folder], out, resolve(None, SETTINGS), **more)  # type: ignore[arg-type]
    return report


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, SessionReport]:
    """The recording with times, its map and what is told of it."""
    folder = recorded(tmp_path_factory.mktemp("timed") / "drive")
    out = folder.parent / "map.gpkg"
    return folder, out, built(folder, out)


def test_walls_are_where_they_are(timed: tuple[Path, Path, SessionReport], tmp_path: Path) -> None:
    _, out, report = timed
    as_seen = built(recorded(tmp_path / "drive", timed=False), tmp_path / "raw.gpkg")
    assert report.used == as_seen.used == SWEEPS
    mended, raw = off_m(out), off_m(tmp_path / "raw.gpkg")
    assert len(mended) > 400
    assert np.percentile(mended, 95) < 0.10  # the cells are 10 cm
    assert np.percentile(raw, 95) > 0.25


def test_the_report_tells_it_once(timed: tuple[Path, Path, SessionReport], tmp_path: Path) -> None:
    def notes(report: SessionReport) -> list[str]:
        return [note for note in report.notes if "sweep" in note]

    (note,) = notes(timed[2])
    assert note == (
        "The points of a sweep (0.100 s) are corrected for the vehicle's motion within it."
    )
    corrected = recorded(tmp_path / "drive", settings="[cloud]\ncorrected = true\n")
    (note,) = notes(built(corrected, tmp_path / "map.gpkg"))
    assert "motion within a sweep is not corrected" in note
    with open_recording(corrected) as recording:
        (frame,) = recording.frames(0, 1)
        assert isinstance(frame, CloudFrame)
        assert frame.source.sweep().after_s is None


def test_the_map_does_not_depend_on_the_jobs(
    timed: tuple[Path, Path, SessionReport], tmp_path: Path
) -> None:
    folder, out, _ = timed
    built(folder, tmp_path / "map.gpkg", jobs=1)
    with open_map(out) as one, open_map(tmp_path / "map.gpkg") as other:
        assert np.array_equal(one.read().density, other.read().density)


def test_a_converted_drive_keeps_the_times(
    timed: tuple[Path, Path, SessionReport], tmp_path: Path
) -> None:
    folder, out, _ = timed
    with open_drive(folder) as drive:
        convert_recording(drive, tmp_path / "drive.mcap")
    built(tmp_path / "drive.mcap", tmp_path / "map.gpkg")
    with open_map(out) as one, open_map(tmp_path / "map.gpkg") as other:
        assert np.array_equal(one.read().density, other.read().density)


def test_poses_that_are_estimated_again_say_what_they_do_to_sweeps(
    timed: tuple[Path, Path, SessionReport], tmp_path: Path
) -> None:
    out = tmp_path / "map.gpkg"
    shutil.copy(timed[1], out)
    (report,) = repose_map(out)
    (told,) = (one.message for one in report.findings if one.code == "sweep")
    assert "up to 0.000 m elsewhere, which is less than half a cell" in told
    with open_map(out) as universal:
        (session,) = universal.sessions()
        track = universal.trajectory(session.name, as_driven=True)
    straight = replace(track, heading_deg=np.zeros(len(track)))
    told = _of_sweeps(track, straight, track.time_ns[5:-5].tolist(), resolve(None, SETTINGS))
    found = re.search(r"up to ([\d.]+) m elsewhere, so build the drive again", told.message)
    assert found
    # 0.06 rad, 15 m ahead, and the way of a tenth of a second in another direction.
    assert 0.9 < float(found[1]) < 1.6
