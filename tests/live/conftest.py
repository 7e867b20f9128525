"""A short part of the example, and the map that a build makes of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.build import build_map
from fieldgrid.settings import BuildSettings
from tests.conftest import make_small_drive
from tests.live.making import cut_log

FRAMES = range(20, 26)


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
