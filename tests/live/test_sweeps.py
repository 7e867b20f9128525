"""Clouds of a lidar that turns while it drives: carried by what is known of the way just then."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import RecordingError, resolve
from fieldgrid.live import Live, LiveOptions, replay
from fieldgrid.live.pushed import PushedSource
from fieldgrid.pipeline import SessionReport, build_map
from fieldgrid.recordings import CloudFrame, open_recording
from tests.live.making import begin
from tests.pipeline.drives.making import content
from tests.pipeline.drives.yard import SETTINGS, SPEED_MPS, SWEEPS, off_m, recorded


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("yard") / "drive")


def driven(drive: Path, out: Path, *, wheels: bool, points_gb: float) -> SessionReport:
    """The drive pushed, all that sensors say of a sweep before it."""
    with open_recording(drive) as recording:
        settings, datum = resolve(None, SETTINGS), recording.datum_hint
        options = LiveOptions(points_gb=points_gb)
        live = Live(out, recording.rig, settings, name="yard", datum_hint=datum, options=options)
        gyro = recording.motion().gyro
        assert gyro is not None
        live.push_gyro(gyro.time_ns, gyro.rate_rad_s)
        if wheels:
            live.push_wheels(gyro.time_ns, np.full(len(gyro.time_ns), SPEED_MPS))
        for fix in recording.fixes():
            live.push_fix(fix)
        for frame in recording.frames():
            assert isinstance(frame, CloudFrame)
            points_m, after_s = frame.source.sweep()
            live.push_cloud(points_m, frame.time_ns, after_s=after_s, wait=True)
        assert live.drain()
        return live.finish()


@pytest.mark.parametrize("wheels", [True, False])
def test_walls_are_where_they_are_if_the_way_is_known(
    drive: Path, tmp_path: Path, wheels: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of an estimate in time the speed would be known, too.
    monkeypatch.setattr(
        "fieldgrid.live.pose.dead_reckoning.DeadReckoning.know", lambda _self, _track: None
    )
    # Without the points of its frames the map has the grids as they were made while driving.
    report = driven(drive, tmp_path / "map.gpkg", wheels=wheels, points_gb=0.0)
    assert report.used == SWEEPS
    (note,) = (note for note in report.notes if "fieldgrid build" in note)
    assert "by the motion known then" in note
    off = np.percentile(off_m(tmp_path / "map.gpkg"), 95)
    assert off < 0.10 if wheels else off > 0.25


def test_the_map_of_sweeps_is_that_of_a_build(drive: Path, tmp_path: Path) -> None:
    settings = resolve(None, SETTINGS)
    build_map([drive], tmp_path / "built.gpkg", settings)
    with (
        open_recording(drive) as recording,
        begin(recording, tmp_path / "live.gpkg", settings=settings) as live,
    ):
        replay(live, recording, rate=None)
    assert content(tmp_path / "live.gpkg") == content(tmp_path / "built.gpkg")


def test_times_of_other_points_are_no_times() -> None:
    points_m = np.zeros((5, 3), np.float32)
    assert PushedSource("cloud", points_m).sweep().after_s is None
    with pytest.raises(RecordingError, match="for 5 points"):
        PushedSource("cloud", points_m, np.zeros(4, np.float32)).sweep()
