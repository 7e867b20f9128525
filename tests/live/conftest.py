"""A short part of the example, and the map that a build makes of it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fieldgrid.build import build_map
from fieldgrid.recording import open_recording
from fieldgrid.settings import BuildSettings
from tests.conftest import make_small_drive

FRAMES = range(20, 26)
BEFORE_S, AFTER_S = 6.0, 4.0


@pytest.fixture(scope="session")
def short_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six pairs of the example and the log around them; no IMU, which would tell how it leans."""
    drive = make_small_drive(tmp_path_factory.mktemp("live") / "drive", FRAMES)
    with open_recording(drive) as recording:
        times_ns, fix_ns = recording.frame_times_ns(), recording.fixes().time_ns
    near = (fix_ns > times_ns[0] - BEFORE_S * 1e9) & (fix_ns < times_ns[-1] + AFTER_S * 1e9)
    log = drive / "gnss" / "gnss_rtk.nmea"
    epochs = re.split(rb"(?=\$GPGGA)", log.read_bytes())
    assert len(epochs) == len(fix_ns) + 1
    log.write_bytes(b"".join(epochs[k + 1] for k in near.nonzero()[0]))
    return drive


@pytest.fixture(scope="session")
def built(short_drive: Path) -> Path:
    """Its map, as a build makes it."""
    out = short_drive.parent / "built.gpkg"
    build_map([short_drive], out, BuildSettings())
    return out
