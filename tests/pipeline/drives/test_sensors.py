"""Maps of depth images: the same as of the pairs that they come from."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import BuildSettings, CalibrationError, GnssError, resolve
from fieldgrid.field import evaluate, read_truth
from fieldgrid.field.evaluation.results import ObstacleScores
from fieldgrid.field.evaluation.scores import _view_points
from fieldgrid.geometry import OBSTACLE_ABOVE, DepthCamera, GridSpec, LocalGrid, Rig, StereoCamera
from fieldgrid.maps import open_map
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline import (
    SessionReport,
    build_map,
    cell_budget,
    local_grid,
    no_ground,
    repose_map,
    visual_odometry,
)
from fieldgrid.pipeline.checks.format_hints import format_hints
from fieldgrid.pipeline.staging.perception import perceive_frame, side_by_side
from fieldgrid.recordings import DepthFrame, DriveOptions, Recording, open_recording
from tests.conftest import TWO_LANES, make_small_drive
from tests.remembered import worked_out_once
from tests.scenes import depth_rig, lidar_rig, paper_rig

SharedData = Callable[[str], Path]
Mapped = Callable[[str], tuple[Path, SessionReport]]
Points = npt.NDArray[np.float64]

RTK = "gnss_rtk.nmea"
WITHOUT_CAMERA = {"pose": {"visual_odometry": False}}


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every third frame of the example, and its IMU."""
    folder = make_small_drive(tmp_path_factory.mktemp("pairs") / "pairs", range(0, 50, 3))
    shutil.copytree(TWO_LANES / "imu", folder / "imu")
    return folder


@pytest.fixture(scope="module")
def drives(pairs: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same as depths in millimetres and as disparities in 1/256 px, by our own matcher."""
    folders = {kind: tmp_path_factory.mktemp(kind) for kind in ("depth", "disparity")}
    rows = []
    with open_recording(pairs, RTK) as recording, worked_out_once():
        gridder, camera = LocalGridder(recording.rig), recording.rig.camera
        for frame in recording.frames():
            values, row_start = gridder.matcher.disparity(*frame.images())
            disparity_px = np.zeros((camera.height_px, camera.width_px))
            disparity_px[row_start:] = np.maximum(values, 0) / 16.0
            depth_m = camera.focal_baseline_px_m / np.maximum(disparity_px, 1e-3)
            rows.append((frame.frame_id, frame.time_ns))
            for kind, image in (
                ("depth", np.where(depth_m < 65.0, depth_m * 1000.0, 0.0)),
                ("disparity", disparity_px * 256.0),
            ):
                (folders[kind] / kind).mkdir(exist_ok=True)
                path = folders[kind] / kind / f"{frame.frame_id}.png"
                cv2.imwrite(str(path), np.rint(image).astype(np.uint16))
    for kind, folder in folders.items():
        for name in ("calibration", "gnss", "imu"):
            if (TWO_LANES / name).exists():
                shutil.copytree(TWO_LANES / name, folder / name)
        shutil.copy(TWO_LANES / "session.json", folder)
        with (folder / "frames.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["frame_id", "time_ns", kind])
            table.writerows([frame_id, ns, f"{kind}/{frame_id}.png"] for frame_id, ns in rows)
    return folders


def first_of(drive: Path, folder: Path, count: int = 6) -> Path:
    """A copy of the first frames of a drive of depths, to be changed."""
    kind = drive.name.rstrip("0123456789")
    (folder / kind).mkdir(parents=True)
    for name in ("calibration", "gnss", "imu"):
        if (drive / name).exists():
            shutil.copytree(drive / name, folder / name)
    shutil.copy(drive / "session.json", folder)
    head, *rows = (drive / "frames.csv").read_text().splitlines(keepends=True)
    (folder / "frames.csv").write_text("".join([head, *rows[:count]]))
    for row in rows[:count]:
        image = row.strip().rpartition(",")[2]
        shutil.copy(drive / image, folder / image)
    return folder


def built(path: Path, out: Path, tables: dict[str, dict[str, object]]) -> SessionReport:
    (report,) = build_map([path], out, resolve(None, tables), DriveOptions(RTK))
    return report


@pytest.fixture(scope="module")
def mapped(drives: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Mapped:
    """Builds the map of one kind of depths once; read it, or copy it."""

    @cache
    def build(kind: str) -> tuple[Path, SessionReport]:
        out = tmp_path_factory.mktemp("mapped") / "depths.gpkg"
        return out, built(drives[kind], out, {})

    return build


def obstacles(out: Path) -> ObstacleScores:
    with open_map(out) as universal:
        return evaluate(universal, read_truth(TWO_LANES / "truth")).groups[0].obstacles


@pytest.mark.parametrize("kind", ["depth", pytest.param("disparity", marks=pytest.mark.long)])
def test_a_map_of_depths_is_that_of_the_pairs(
    kind: str, pairs: Path, mapped: Mapped, tmp_path: Path
) -> None:
    of_pairs = built(pairs, tmp_path / "pairs.gpkg", WITHOUT_CAMERA)
    depths, report = mapped(kind)
    assert report.used == report.frames == of_pairs.used
    assert report.max_range_m == of_pairs.max_range_m
    assert report.stages.match_s == 0.0
    assert (report.camera_steps, report.camera_refusals) == (0, 0)
    assert any("no stereo pairs" in note for note in report.notes)
    assert not any("The growth of the depth error" in note for note in report.notes)
    theirs, ours = obstacles(tmp_path / "pairs.gpkg"), obstacles(depths)
    for tolerance in ("0.10", "0.25"):
        assert ours.precision[tolerance] == pytest.approx(theirs.precision[tolerance], abs=0.005)
        assert ours.recall[tolerance] == pytest.approx(theirs.recall[tolerance], abs=0.005)
    assert ours.observable_cells == pytest.approx(theirs.observable_cells, rel=0.01)
    with open_map(depths) as universal:
        (session,) = universal.sessions()
        assert session.config["rig"]["depth_camera"]["baseline_m"] == pytest.approx(0.18)
        assert "search" not in session.config
        assert not any(key.startswith("steps.") for key in universal.session_inputs(session.name))
        assert universal.verify(deep=True).sound


def test_poses_can_be_estimated_again(mapped: Mapped, tmp_path: Path) -> None:
    out = Path(shutil.copy(mapped("depth")[0], tmp_path))
    (report,) = repose_map(out, {"heading": "course"})
    assert report.used > 0


def test_local_grids_of_depths_and_pairs_agree(pairs: Path, drives: dict[str, Path]) -> None:
    def first(path: Path) -> tuple[LocalGrid, Recording]:
        with open_recording(path, RTK) as recording:
            return local_grid(next(recording.frames()), recording.rig), recording

    pair, of_pairs = first(pairs)
    depth, of_depths = first(drives["depth"])
    assert isinstance(of_pairs.rig.sensor, StereoCamera)
    assert isinstance(of_depths.rig.sensor, DepthCamera)
    # The grid begins 9 cm further left, so two cells are not quite what they were.
    ours, theirs = depth.density[:, 2:] > OBSTACLE_ABOVE, pair.density[:, :-2] > OBSTACLE_ABOVE
    both = depth.observed[:, 2:] & pair.observed[:, :-2]
    either = depth.observed[:, 2:] | pair.observed[:, :-2]
    assert both.sum() > 0.8 * either.sum()
    assert (ours == theirs)[both].mean() > 0.97


def test_true_depths_find_what_the_matcher_finds(shared_data: SharedData) -> None:
    """The renderer's depths of four images, float metres, against the grids of the pairs."""
    drive = shared_data("vineyard_two_lanes")
    with open_recording(drive, RTK) as recording:
        pair = recording.rig.camera
        frames = {frame.frame_id: frame for frame in recording.frames()}
        rig = recording.rig
    camera = DepthCamera(640, 480, pair.focal_px, pair.focal_px, pair.cx_px, pair.cy_px, 0.18)
    truths = sorted((drive / "truth" / "depth").glob("*.npz"))
    assert len(truths) == 4
    for path in truths:
        with np.load(path) as archive:
            (depth_m,) = (archive[name] for name in archive.files)
        true = np.where(depth_m > 0, depth_m, np.nan).astype(np.float32)
        ours, ground = LocalGridder(replace(rig, sensor=camera)).from_depth(true)
        frame_id = path.name.partition("_")[0]
        theirs, matched = LocalGridder(rig)(*frames[frame_id].images())
        assert ground.camera_height_m == pytest.approx(matched.camera_height_m, abs=0.04)
        assert ground.pitch_deg == pytest.approx(matched.pitch_deg, abs=0.5)
        found, wanted = (grid.density > OBSTACLE_ABOVE for grid in (ours, theirs))
        assert found.sum() == pytest.approx(wanted.sum(), rel=0.15, abs=5)


# --- what a sensor cannot


def test_nobody_says_how_the_error_of_depths_grows(drives: dict[str, Path], tmp_path: Path) -> None:
    folder = first_of(drives["depth"], tmp_path / "drive")
    with open_recording(folder, RTK) as recording:
        camera = recording.rig.sensor
    assert isinstance(camera, DepthCamera)
    for path in (folder / "calibration").glob("stereo*"):
        path.unlink()
    mounting = folder / "calibration" / "mounting.json"
    text = mounting.read_text().replace('"stereo_baseline_m"', '"note"')
    mounting.write_text(text)
    (folder / "calibration" / "depth_camera_info.yaml").write_text(
        f"image_width: {camera.width_px}\nimage_height: {camera.height_px}\n"
        f"camera_matrix: {{data: [{camera.fx_px}, 0, {camera.cx_px}, 0, {camera.fy_px}, "
        f"{camera.cy_px}, 0, 0, 1]}}\nprojection_matrix: {{data: [{camera.fx_px}, 0, "
        f"{camera.cx_px}, 0, 0, {camera.fy_px}, {camera.cy_px}, 0, 0, 0, 1, 0]}}\n"
    )
    report = built(folder, tmp_path / "map.gpkg", {})
    assert report.max_range_m == 15.0
    assert any(one.code == "depth-range" and "up to 15 m" in one.message for one in report.findings)


def test_a_depth_image_of_another_size_is_named(drives: dict[str, Path], tmp_path: Path) -> None:
    folder = first_of(drives["depth"], tmp_path / "drive")
    path = sorted((folder / "depth").glob("*.png"))[0]
    cv2.imwrite(str(path), np.zeros((240, 320), np.uint16))
    with open_recording(folder, RTK) as recording:
        frame = next(recording.frames())
        assert isinstance(frame, DepthFrame)
        with pytest.raises(CalibrationError, match=rf"{path.name} has 320 x 240 px"):
            local_grid(frame, recording.rig)
        with pytest.raises(CalibrationError, match=rf"{path.name} has 320 x 240 px"):
            list(
                side_by_side(
                    partial(perceive_frame, gridder=LocalGridder(recording.rig)), [frame], 1
                )
            )


def test_depths_have_no_visual_odometry(drives: dict[str, Path]) -> None:
    with (
        open_recording(drives["depth"], RTK) as recording,
        pytest.raises(CalibrationError, match="needs a stereo pair, and the rig has a Depth"),
    ):
        visual_odometry(recording, 1)


def test_a_drive_without_ground_names_the_mounting(drives: dict[str, Path], tmp_path: Path) -> None:
    folder = first_of(drives["depth"], tmp_path / "drive")
    for path in (folder / "depth").glob("*.png"):
        cv2.imwrite(str(path), np.zeros((480, 640), np.uint16))
    with pytest.raises(GnssError, match=r"no ground was found in the image.*camera's height"):
        built(folder, tmp_path / "map.gpkg", {})


@pytest.mark.parametrize(
    ("kind", "times", "says"),
    [
        ("depth", 0.1, r"\[depth\] scale_m = 0\.01"),
        ("disparity", 1.0 / 16.0, r"\[disparity\] scale_px = 0\.0625"),
    ],
)
def test_depths_in_another_unit_are_told_with_it(
    kind: str, times: float, says: str, drives: dict[str, Path], tmp_path: Path
) -> None:
    folder = first_of(drives[kind], tmp_path / "drive")
    for path in (folder / kind).glob("*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64)
        cv2.imwrite(str(path), np.rint(times * image).astype(np.uint16))
    out = tmp_path / "map.gpkg"
    with pytest.raises(CalibrationError, match=rf"No ground was found .* With {says} in record"):
        built(folder, out, {})
    assert not out.exists()
    with open_recording(folder, RTK) as recording:
        (reading,) = format_hints(recording, LocalGridder(recording.rig), 1)
    (folder / "recording.toml").write_text(reading.replace("] ", "]\n"))
    assert built(folder, out, {}).used > 0


@pytest.mark.parametrize(
    ("axes", "times", "says"),
    [
        ("rfu", 1.0, '[cloud] axes = "rfu"'),
        ("rdf", 1.0, '[cloud] axes = "rdf"'),
        ("flu", 1000.0, "[cloud] scale_m = 0.001"),
        ("flu", 10.0, "[cloud] scale_m = 0.1"),
    ],
)
def test_clouds_of_other_axes_or_units_are_told_with_them(
    axes: str, times: float, says: str, drives: dict[str, Path], tmp_path: Path
) -> None:
    with open_recording(drives["depth"], RTK) as recording:
        camera, frames = recording.rig.sensor, list(recording.frames(4, 6))
    assert isinstance(camera, DepthCamera)
    folder = tmp_path / "drive"
    (folder / "clouds").mkdir(parents=True)
    for name in ("calibration", "gnss"):
        shutil.copytree(drives["depth"] / name, folder / name)
    for frame in frames:
        assert isinstance(frame, DepthFrame)
        z = frame.source.read()[::4, ::4]
        v, u = np.nonzero(np.isfinite(z))
        z = z[v, u]
        x = (4 * u - camera.cx_px) * z / camera.fx_px
        y = (4 * v - camera.cy_px) * z / camera.fy_px
        along = {"f": z, "l": -x, "u": -y, "r": x, "d": y}
        points = times * np.column_stack([along[axis] for axis in axes])
        np.save(folder / "clouds" / f"{frame.time_ns}.npy", points.astype(np.float32))
    with open_recording(folder, RTK) as recording:
        gridder = LocalGridder(recording.rig)
        assert format_hints(recording, gridder, 1) == [says]
    (folder / "recording.toml").write_text(says.replace("] ", "]\n"))
    with open_recording(folder, RTK) as recording:
        assert all(
            gridder.from_cloud(frame.source.read())[1].refined for frame in recording.frames()
        )


def test_of_frames_without_ground_no_reading_is_told(
    drives: dict[str, Path], tmp_path: Path
) -> None:
    folder = first_of(drives["depth"], tmp_path / "drive")
    for path in (folder / "depth").glob("*.png"):  # a wall across the way
        cv2.imwrite(str(path), np.full((480, 640), 6000, np.uint16))
    with open_recording(folder, RTK) as recording:
        assert format_hints(recording, LocalGridder(recording.rig), 1) == []


def test_why_a_frame_without_ground_is_rejected() -> None:
    assert "in the image" in no_ground(paper_rig())
    assert no_ground(paper_rig()) == no_ground(depth_rig())
    assert "in the cloud" in no_ground(lidar_rig(1000.0))


def test_the_budget_of_poses_goes_as_far_as_points_do() -> None:
    settings = BuildSettings()
    assert cell_budget(lidar_rig(1000.0), settings).reach_m == 15.0
    assert cell_budget(depth_rig(), settings).reach_m == 15.0
    near = cell_budget(depth_rig(baseline_m=0.05), settings).reach_m
    assert near == pytest.approx(np.sqrt(0.2 * 780.0 * 0.05 / 0.25))


# --- what a truth is held against


def view(rig: Rig, max_range_m: float = 15.0) -> tuple[Points, Points]:
    config = {"rig": rig.as_dict(), "max_range_m": max_range_m}
    return _view_points(GridSpec(10.0, 15.0, 0.05), config, 0.1)


def test_a_depth_camera_sees_what_the_left_camera_sees() -> None:
    """But for half a baseline, by which the left camera stands left of the pair's middle."""
    pair, depth = view(paper_rig()), view(depth_rig())
    assert len(depth[0]) == pytest.approx(len(pair[0]), rel=0.01)
    assert depth[1].min() == pair[1].min()
    far = depth[1] > 7.0
    assert depth[0][far].mean() == pytest.approx(0.0, abs=0.06)
    near = depth[1] < 6.0
    assert depth[0][near].max() == pytest.approx(pair[0][pair[1] < 6.0].max() + 0.1, abs=0.11)
    wide = view(depth_rig((390.0, 780.0)))
    assert np.abs(wide[0]).max() > 1.5 * np.abs(depth[0][near]).max()
    low = view(depth_rig((780.0, 390.0)))
    assert low[1].min() < 0.8 * depth[1].min()


def test_a_lidar_sees_to_all_sides() -> None:
    x, y = view(lidar_rig(1000.0), 9.0)
    assert np.hypot(x, y).max() <= 9.0
    assert (x.min(), x.max()) == pytest.approx((-5.0, 5.0), abs=0.11)
    assert y.min() == pytest.approx(0.1)
    assert 7500 < len(x) < 9000  # 10 m x 9 m less two corners
