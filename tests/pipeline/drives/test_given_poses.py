"""A map from poses of another program."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.cli import main
from fieldgrid.core import DatumError, GnssError, RecordingError, resolve
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map, repose_map
from fieldgrid.recordings import DriveOptions, PoseSource, open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.drives.making import MakeDrive
from tests.recordings import bags
from tests.recordings.test_euroc import write_euroc
from tests.recordings.test_given_poses import Truth, truth, tum

__all__ = ["truth"]

DECLARED = {
    "pose": {"frame_origin": "41.65,-4.72,787.4", "frame_heading_deg": 90.0, "accuracy_m": 0.05}
}
START = "[start]\nutc_s = 1308133811\n"


def as_sequence(drive: Path, folder: Path, times_ns: list[int]) -> Path:
    """A plain folder as a sequence of KITTI odometry."""
    for number, side in enumerate(("left", "right")):
        shutil.copytree(drive / side, folder / f"image_{number}")
        for path in (folder / f"image_{number}").iterdir():
            pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            assert cv2.imwrite(str(path.with_suffix(".png")), pixels)
            path.unlink()
    with open_recording(drive) as recording:
        camera = recording.rig.camera
    f, cx, cy = camera.focal_px, camera.cx_px, camera.cy_px
    rows = [
        f"P{k}: {f} 0 {cx} {-k * camera.focal_baseline_px_m} 0 {f} {cy} 0 0 0 1 0" for k in (0, 1)
    ]
    (folder / "calib.txt").write_text("\n".join(rows))
    times = [f"{(time_ns - 1308133811 * 10**9) / 1e9:.9f}" for time_ns in times_ns]
    (folder / "times.txt").write_text("\n".join(times))
    shutil.copyfile(drive / "calibration" / "mounting.json", folder / "mounting.json")
    return folder


def as_bag(drive: Path, path: Path, times_ns: list[int]) -> Path:
    """A plain folder as a bag without fixes."""
    with open_recording(drive) as recording:
        camera = recording.rig.camera
    f, cx, cy = camera.focal_px, camera.cx_px, camera.cy_px
    left = np.array([[f, 0.0, cx, 0.0], [0.0, f, cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    right = left.copy()
    right[0, 3] = -camera.focal_baseline_px_m
    names = sorted(one.name for one in (drive / "left").iterdir())
    pairs = [
        (time_ns, f"left/{name}", f"right/{name}")
        for time_ns, name in zip(times_ns, names, strict=True)
    ]
    maker = bags.Maker("mcap")
    said = bags.images_said(maker, drive, pairs, (left, right), compressed=True)
    return bags.write_bag(path, "mcap", maker, said)


@pytest.mark.parametrize("kind", ["plain", "euroc", "kitti", "bag"])
def test_poses_with_a_declared_frame_need_no_fix(
    kind: str, truth: Truth, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive, out, mounting = make_drive(), tmp_path / "map.gpkg", None
    times_ns = truth.time_ns[3:6].tolist()
    poses = tum(tmp_path / "slam.tum", truth.time_ns, truth.left_m, truth.R_enu_camera)
    if kind == "euroc":
        (drive / "imu").mkdir()
        log = (TWO_LANES / "imu" / "imu_100hz.csv").read_text()
        (drive / "imu" / "imu_100hz.csv").write_text(log)
        drive = write_euroc(drive, tmp_path / "euroc")
    elif kind == "kitti":
        drive = as_sequence(drive, tmp_path / "06", times_ns)
        with pytest.raises(RecordingError, match=r"\[start\] utc_s .* \[datum\] lat_deg"):
            build_map([drive], out, resolve(None, DECLARED))
        (drive / "recording.toml").write_text(START)
        (drive / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
        with pytest.raises(GnssError, match=r"add \[datum\] to recording\.toml"):
            build_map([drive], out, resolve(None, {}))
    elif kind == "bag":
        mounting = drive / "calibration" / "mounting.json"
        drive = as_bag(drive, tmp_path / "bag", times_ns)
    shutil.rmtree(drive / "gnss", ignore_errors=True)
    options = DriveOptions(mounting=mounting, poses=PoseSource(poses, axes="rdf"))
    with pytest.raises(GnssError, match=r"declare.* --frame-origin"):
        build_map([drive], out, resolve(None, {}), options)
    (report,) = build_map([drive], out, resolve(None, DECLARED), options)
    assert (report.used, report.frames) == (3, 3)
    with open_map(out) as universal:
        places = [(f.driven.east_m, f.driven.north_m) for f in universal.frames()]
    assert np.abs(np.array(places) - truth.middle_m[3:6, :2]).max() < 0.05


def test_poses_that_are_declared_far_from_the_datum_are_refused_first(
    truth: Truth, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive()
    shutil.rmtree(drive / "gnss")
    path = tum(tmp_path / "slam.tum", truth.time_ns, truth.left_m, truth.R_enu_camera)
    settings = resolve(None, {"pose": {**DECLARED["pose"], "frame_origin": "39.5,-1.1,700"}})
    options = DriveOptions(poses=PoseSource(path, axes="rdf"))
    with pytest.raises(DatumError, match=r"poses of drive are 388 km from the datum"):
        build_map([drive], tmp_path / "map.gpkg", settings, options)


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
    main()
    assert "poses of slam.tum" in capsys.readouterr().out
    (again,) = repose_map(out)
    assert again.heading_source == "given poses"
    assert again.moved_m == pytest.approx((0.0, 0.0), abs=1e-9)
    (own,) = repose_map(out, {"heading": "course"})
    assert own.heading_source == "course"
    (back,) = repose_map(out, {"heading": "smooth"})
    assert back.used == 8
