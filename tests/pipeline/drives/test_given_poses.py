"""A map from poses of another program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fieldgrid.cli import main
from fieldgrid.core import resolve
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map, repose_map
from fieldgrid.recordings import DriveOptions, PoseSource
from tests.pipeline.drives.making import MakeDrive
from tests.recordings.test_given_poses import Truth, truth, tum

__all__ = ["truth"]


def test_a_map_says_what_its_poses_are_from(
    truth: Truth,
    make_drive: MakeDrive,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its frames lie where the truth has them; estimating again gives the same, and nothing is
    looked for in the images."""
    path = tum(tmp_path / "slam.tum", truth.time_ns, truth.left_m, truth.R_enu_camera)
    drive, out = make_drive(frames=range(8, 16)), tmp_path / "map.gpkg"
    options = DriveOptions("gnss_rtk.nmea", poses=PoseSource(path, axes="rdf"))
    (report,) = build_map([drive], out, resolve(None, {}), options)
    assert (report.used, report.frames) == (8, 8)
    assert (report.heading_source, report.camera_steps) == ("given poses", 0)
    with open_map(out) as universal:
        (session,) = universal.sessions()
        assert session.config["poses"] == "slam.tum"
        assert session.config["level_grids"] is True
        before = {f.frame_id: f.driven for f in universal.frames(session.name)}
    times = [pose.time_ns for pose in before.values()]
    k = np.searchsorted(truth.time_ns, times)
    places = np.array([[pose.east_m, pose.north_m] for pose in before.values()])
    assert np.hypot(*(places - truth.middle_m[k, :2]).T).max() < 0.05
    headings = np.array([pose.heading_deg for pose in before.values()])
    assert np.abs(headings - truth.heading_deg[k]).max() < 0.2
    monkeypatch.setattr("sys.argv", ["fieldgrid", "sessions", str(out)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert "poses of slam.tum" in capsys.readouterr().out
    (again,) = repose_map(out)
    assert again.heading_source == "given poses"
    assert again.moved_m == pytest.approx((0.0, 0.0), abs=1e-9)
    (own,) = repose_map(out, {"heading": "course"})
    assert own.heading_source == "course"
    (back,) = repose_map(out, {"heading": "smooth"})
    assert back.used == 8
