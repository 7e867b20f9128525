"""A short part of the example, and the map that a build makes of it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from fieldgrid.core import BuildSettings
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import open_recording
from tests.conftest import TWO_LANES, make_small_drive
from tests.live.making import cut_log

FRAMES = range(20, 26)
IMU = "imu/imu_100hz.csv"


@pytest.fixture(autouse=True)
def _nothing_is_worked_out_twice(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What pairs show and where drives went is tested elsewhere, and that kernels are ready before
    the first frame in a process of its own."""
    monkeypatch.setattr("fieldgrid.live.session.warm_up", lambda gridder, odometry: None)
    monkeypatch.setattr("fieldgrid.live.session.warm_up_poses", lambda rig, settings: None)
    if "worked_out_afresh" not in request.fixturenames:
        request.getfixturevalue("worked_out_once")


@pytest.fixture(scope="session")
def short_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six pairs of the example and the log around them; no IMU, which would tell how it leans."""
    drive = make_small_drive(tmp_path_factory.mktemp("live") / "drive", FRAMES)
    cut_log(drive)
    return drive


@pytest.fixture(scope="session")
def built(short_drive: Path) -> Path:
    """Its map, as a build makes it."""
    out = short_drive.parent / "built.gpkg"
    build_map([short_drive], out, BuildSettings())
    return out


@pytest.fixture(scope="session")
def leaning_drive(short_drive: Path) -> Path:
    """The same with what its IMU said meanwhile: it tells how the vehicle leans."""
    drive = short_drive.parent / "leaning" / "drive"
    shutil.copytree(short_drive, drive, symlinks=True)
    (drive / "imu").mkdir()
    with open_recording(drive) as recording:
        fix_s = recording.fixes().time_ns / 1e9
    head, *rows = (TWO_LANES / IMU).read_text().splitlines(keepends=True)
    near = [row for row in rows if fix_s[0] - 1.0 < float(row.split(",", 1)[0]) < fix_s[-1] + 1.0]
    (drive / IMU).write_text("".join([head, *near]))
    return drive


@pytest.fixture(scope="session")
def built_level(leaning_drive: Path) -> Path:
    """Its map, as a build makes it."""
    out = leaning_drive.parent / "built.gpkg"
    build_map([leaning_drive], out, BuildSettings())
    return out
