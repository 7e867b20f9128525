"""Maps of a made-up world of which the truth is known, against that truth."""

from __future__ import annotations

import csv
import dataclasses
import gc
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import TruthError
from fieldgrid.field import Evaluation, GroupScores, evaluate, read_truth
from fieldgrid.geometry import Datum, GridSpec, LocalGrid, Pose, Status
from fieldgrid.maps import open_map
from tests.conftest import TWO_LANES

DATUM = Datum(41.65, -4.72, 787.4)
CELL_M = 0.05
SIDE = 400  # cells of the world: 20 m
EAST_0_M, NORTH_0_M = -5.0, 30.0  # its south-western corner
SPEC = GridSpec(6.0, 8.0, CELL_M)
START_NS = 1_308_133_815_469_000_000
CONFIG = {
    "rig": {
        "camera": {
            "width_px": 640, "height_px": 480, "focal_px": 400.0, "cx_px": 320.0, "cy_px": 240.0,
            "baseline_m": 0.2, "cx_right_px": None,
        },
        "mount": {"height_m": 1.5, "tilt_deg": 15.0, "roll_deg": 0.0, "yaw_deg": 0.0},
    },
    "max_range_m": 7.5,
}  # fmt: skip


class Drive(NamedTuple):
    """A frame: where it was taken, relative to the world's middle, and on which stretch."""

    east_m: float
    north_m: float
    heading_deg: float
    segment: str = "lane_1"
    direction: str = "forward"


SQUARE = (
    Drive(-3.0, -4.0, 0.0),
    Drive(4.0, -3.0, -90.0),
    Drive(3.0, 4.0, 180.0, "turn_1"),
    Drive(-4.0, 3.0, 90.0, "lane_2", "reverse"),
)


def posts(side_cells: int = 1, step_cells: int = 20) -> npt.NDArray[np.bool_]:
    """Posts at a distance from each other, none on the cells of another 20 cm beside it."""
    occupied = np.zeros((SIDE, SIDE), dtype=np.bool_)
    for j in range(7, SIDE - 4, step_cells):
        for i in range(3 + (7 * j) % 11, SIDE - 4, step_cells):
            occupied[j : j + side_cells, i : i + side_cells] = True
    return occupied


def time_ns(k: int) -> int:
    return START_NS + k * 1_250_000_000


def pose_of(drive: Drive, k: int, **changes: Any) -> Pose:
    east_m, north_m = EAST_0_M + 10.0 + drive.east_m, NORTH_0_M + 10.0 + drive.north_m
    pose = Pose(time_ns(k), east_m, north_m, 0.0, drive.heading_deg, 0.02, 0.5, 1.5)
    return dataclasses.replace(pose, **changes)


def seen_from(pose: Pose, occupied: npt.NDArray[np.bool_]) -> LocalGrid:
    """What a perfect camera makes of the world: the truth, looked up cell by cell (Eq. 3)."""
    x, y = SPEC.centres_m()
    x, y = np.meshgrid(x, y)
    phi = math.radians(pose.heading_deg)
    east = pose.east_m + x * math.cos(phi) + y * math.sin(phi)
    north = pose.north_m - x * math.sin(phi) + y * math.cos(phi)
    i = np.floor((east - EAST_0_M) / CELL_M + 1e-9).astype(int)
    j = np.floor((north - NORTH_0_M) / CELL_M + 1e-9).astype(int)
    assert min(i.min(), j.min()) >= 0
    assert max(i.max(), j.max()) < SIDE
    return LocalGrid(SPEC, np.where(occupied[j, i], 255, 0).astype(np.uint8), np.ones_like(i, bool))


def write_truth(
    folder: Path,
    occupied: npt.NDArray[np.bool_],
    drives: Sequence[Drive] = SQUARE,
    pixels: npt.NDArray[np.int32] | None = None,
    datum: Datum | None = DATUM,
) -> Path:
    folder.mkdir()
    np.savez(
        folder / "obstacle_raster_5cm.npz",
        occupied=occupied,
        east0=EAST_0_M,
        north0=NORTH_0_M,
        cell=CELL_M,
    )
    np.savez(
        folder / "observable_raster_5cm.npz",
        obstacle_pixels=np.where(occupied, 1000, 0) if pixels is None else pixels,
    )
    with (folder / "poses_frames.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["timestamp_utc_s", "cam_mid_E", "cam_mid_N", "heading_deg", "direction", "segment"]
        )
        for k, drive in enumerate(drives):
            pose = pose_of(drive, k)
            table.writerow(
                [f"{time_ns(k) / 1e9:.3f}", pose.east_m, pose.north_m, drive.heading_deg,
                 drive.direction, drive.segment]
            )  # fmt: skip
    if datum is not None:
        origin = {"lat_deg": datum.lat_deg, "lon_deg": datum.lon_deg}
        origin["ellipsoid_height_m"] = datum.height_m
        (folder / "session.json").write_text(json.dumps({"ltp_origin": origin}))
    return folder


def write_map(
    path: Path,
    frames: Sequence[tuple[LocalGrid, Pose]],
    config: dict[str, Any] | None = None,
) -> Path:
    with (
        open_map(path, datum=DATUM, cell_m=CELL_M) as universal,
        universal.add_session("made-up", config=CONFIG if config is None else config) as session,
    ):
        for grid, pose in frames:
            session.add(grid, pose)
    return path


def evaluated(universal: Path, truth: Path, **options: Any) -> Evaluation:
    with open_map(universal) as opened:
        return evaluate(opened, read_truth(truth), **options)


def scored(
    tmp_path: Path,
    occupied: npt.NDArray[np.bool_],
    move: Callable[[Pose], Pose] = lambda pose: pose,
    drives: Sequence[Drive] = SQUARE,
) -> GroupScores:
    """The scores of a map whose grids are perfect and whose poses were moved."""
    truth = write_truth(tmp_path / "truth", occupied, drives)
    true_poses = [pose_of(drive, k) for k, drive in enumerate(drives)]
    frames = [(seen_from(pose, occupied), move(pose)) for pose in true_poses]
    result = evaluated(write_map(tmp_path / "m.gpkg", frames), truth)
    assert result.groups[-1].name == "all frames"
    return result.groups[-1]


# --- obstacles


def test_a_perfect_map_has_perfect_scores(tmp_path: Path) -> None:
    group = scored(tmp_path, posts())
    obstacles, poses = group.obstacles, group.poses
    assert obstacles.precision == {"0.10": 1.0, "0.25": 1.0}
    assert obstacles.recall == {"0.10": 1.0, "0.25": 1.0}
    assert obstacles.free_with_obstacle == 0.0
    assert obstacles.obstacle_cells > 100
    assert 30 < obstacles.observable_cells < obstacles.obstacle_cells
    assert obstacles.free_cells > 40_000
    assert (poses.frames, poses.rejected) == (4, 0)
    assert poses.position_max_m == pytest.approx(0.0, abs=1e-9)
    assert poses.heading_max_deg == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("east_m", "north_m"), [(0.2, 0.0), (0.0, -0.2), (-0.1, 0.15)])
def test_poses_off_by_20_cm_fail_at_10_cm_but_not_at_25(
    east_m: float, north_m: float, tmp_path: Path
) -> None:
    def moved(pose: Pose) -> Pose:
        return dataclasses.replace(
            pose, east_m=pose.east_m + east_m, north_m=pose.north_m + north_m
        )

    group = scored(tmp_path, posts(), moved)
    assert group.obstacles.precision == {"0.10": 0.0, "0.25": 1.0}
    assert group.obstacles.recall["0.10"] == 0.0
    assert group.obstacles.recall["0.25"] is not None
    assert group.obstacles.recall["0.25"] > 0.97  # but for what came into view at the rim
    assert group.obstacles.free_with_obstacle is not None
    assert group.obstacles.free_with_obstacle > 0.0
    assert group.poses.position_median_m == pytest.approx(math.hypot(east_m, north_m))
    assert group.poses.heading_max_deg == pytest.approx(0.0, abs=1e-9)


def test_poses_off_by_5_cm_are_within_10(tmp_path: Path) -> None:
    def moved(pose: Pose) -> Pose:
        return dataclasses.replace(pose, east_m=pose.east_m + 0.05)

    obstacles = scored(tmp_path, posts(), moved).obstacles
    assert obstacles.precision["0.10"] == obstacles.recall["0.10"] == 1.0


def test_a_mirrored_heading_collapses(tmp_path: Path) -> None:
    drives = [Drive(-3.0, -4.0, 37.0), Drive(0.0, -4.0, 37.0)]
    (tmp_path / "right").mkdir()
    (tmp_path / "wrong").mkdir()
    world = posts(side_cells=2)
    right = scored(tmp_path / "right", world, drives=drives)
    wrong = scored(
        tmp_path / "wrong",
        world,
        lambda pose: dataclasses.replace(pose, heading_deg=-pose.heading_deg),
        drives,
    )
    for scores, low, high in ((right, 0.99, 1.0), (wrong, 0.0, 0.4)):
        for values in (scores.obstacles.precision, scores.obstacles.recall):
            assert values["0.10"] is not None
            assert low <= values["0.10"] <= high
    assert wrong.poses.heading_median_deg == pytest.approx(74.0)


def test_nothing_is_shifted_or_turned_to_fit(tmp_path: Path) -> None:
    """A map that is right but for one shift of everything is not right."""

    def moved(pose: Pose) -> Pose:
        return dataclasses.replace(pose, east_m=pose.east_m + 3.0, north_m=pose.north_m + 0.5)

    group = scored(tmp_path, posts(), moved)
    assert group.obstacles.precision["0.25"] is not None
    assert group.obstacles.precision["0.25"] < 0.5
    assert group.poses.position_median_m == pytest.approx(math.hypot(3.0, 0.5))


def test_free_cells_on_obstacles_are_counted(tmp_path: Path) -> None:
    occupied = posts(side_cells=2)
    truth = write_truth(tmp_path / "truth", occupied)
    pose = pose_of(SQUARE[0], 0)
    seen = seen_from(pose, occupied)
    blind = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), seen.observed)
    group = evaluated(write_map(tmp_path / "m.gpkg", [(blind, pose)]), truth).groups[-1]
    obstacles = group.obstacles
    assert obstacles.obstacle_cells == 0
    assert obstacles.free_cells == SPEC.n_x * SPEC.n_y
    assert obstacles.precision == {"0.10": None, "0.25": None}
    assert obstacles.recall == {"0.10": 0.0, "0.25": 0.0}
    assert obstacles.observable_cells > 0
    # Each observable cell in view of the frame is a free cell of this map.
    assert obstacles.free_with_obstacle == pytest.approx(
        obstacles.observable_cells / obstacles.free_cells
    )


def test_cells_in_doubt_are_neither_free_nor_obstacle(tmp_path: Path) -> None:
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied)
    pose = pose_of(SQUARE[0], 0)
    doubtful = LocalGrid(SPEC, np.full(SPEC.shape, 75, np.uint8), np.ones(SPEC.shape, bool))
    obstacles = (
        evaluated(write_map(tmp_path / "m.gpkg", [(doubtful, pose)]), truth).groups[-1].obstacles
    )
    assert (obstacles.obstacle_cells, obstacles.free_cells) == (0, 0)
    assert obstacles.free_with_obstacle is None


def test_only_what_can_be_seen_is_asked_for(tmp_path: Path) -> None:
    """Recall counts cells of enough pixels, inside the view of some frame, and no others."""
    occupied = np.zeros((SIDE, SIDE), dtype=np.bool_)
    pose = pose_of(SQUARE[0], 0)  # looks north

    def put(x_m: float, y_m: float) -> tuple[int, int]:
        j = int((pose.north_m + y_m - NORTH_0_M) / CELL_M + 1e-6)
        i = int((pose.east_m + x_m - EAST_0_M) / CELL_M + 1e-6)
        occupied[j, i] = True
        return j, i

    in_view = [put(0.0, 5.0), put(1.5, 5.0), put(-1.5, 6.0)]
    put(0.0, -3.0)  # behind
    put(2.9, 2.5)  # beside the field of view, tan⁻¹(320 / 400) = 39°
    put(0.0, 1.0)  # under the field of view
    put(0.0, 7.7)  # beyond the range of 7.5 m
    put(5.0, 5.0)  # beside the grid
    dim = put(0.5, 6.5)
    pixels = np.where(occupied, 1000, 0)
    pixels[dim] = 99
    truth = write_truth(tmp_path / "truth", occupied, pixels=pixels)
    universal = write_map(tmp_path / "m.gpkg", [(seen_from(pose, occupied), pose)])
    assert evaluated(universal, truth).groups[-1].obstacles.observable_cells == len(in_view)
    dimmer = evaluated(universal, truth, observable_pixels=99)
    assert dimmer.groups[-1].obstacles.observable_cells == len(in_view) + 1
    assert dimmer.observable_pixels == 99


def test_what_lies_outside_the_truth_is_not_judged(tmp_path: Path) -> None:
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied)
    pose = pose_of(SQUARE[0], 0)
    seen = seen_from(pose, occupied)
    # The same frame again, 3 km away, with nothing but obstacles.
    solid = LocalGrid(SPEC, np.full(SPEC.shape, 255, np.uint8), seen.observed)
    far = dataclasses.replace(pose, time_ns=time_ns(1), east_m=3000.0)
    obstacles = (
        evaluated(write_map(tmp_path / "m.gpkg", [(seen, pose), (solid, far)]), truth)
        .groups[-1]
        .obstacles
    )
    assert obstacles.precision["0.10"] == 1.0


# --- frames


def test_rejected_frames_are_not_in_the_map_that_is_judged(tmp_path: Path) -> None:
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied)
    good = [pose_of(drive, k) for k, drive in enumerate(SQUARE[:3])]
    frames = [(seen_from(pose, occupied), pose) for pose in good]
    alone = evaluated(write_map(tmp_path / "alone.gpkg", frames), truth)
    wrong = pose_of(
        SQUARE[3], 3, east_m=1.0, heading_deg=math.nan, status=Status.REJECTED, reason="a jump"
    )
    solid = LocalGrid(SPEC, np.full(SPEC.shape, 255, np.uint8), np.ones(SPEC.shape, bool))
    both = evaluated(write_map(tmp_path / "both.gpkg", [*frames, (solid, wrong)]), truth)
    assert both.groups[-1].obstacles == alone.groups[-1].obstacles
    assert (both.groups[-1].poses.frames, both.groups[-1].poses.rejected) == (3, 1)
    assert both.groups[-1].poses.position_max_m == pytest.approx(0.0, abs=1e-9)
    assert both.frames[-1].status == "rejected"


def test_a_map_of_rejected_frames_alone_has_no_scores(tmp_path: Path) -> None:
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied)
    pose = pose_of(SQUARE[0], 0, status=Status.REJECTED, reason="a jump")
    result = evaluated(write_map(tmp_path / "m.gpkg", [(seen_from(pose, occupied), pose)]), truth)
    group = result.groups[-1]
    assert group.obstacles.precision == {"0.10": None, "0.25": None}
    assert (group.poses.frames, group.poses.rejected) == (0, 1)
    assert group.poses.heading_median_deg is None


def test_driving_forward_on_the_rows_is_a_group_of_its_own(tmp_path: Path) -> None:
    """The turn and the reverse are wrong, the rows are right: the groups tell them apart."""
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied)
    frames = []
    for k, drive in enumerate(SQUARE):
        pose = pose_of(drive, k)
        off_m = 0.0 if k < 2 else 0.2
        frames.append(
            (seen_from(pose, occupied), dataclasses.replace(pose, east_m=pose.east_m + off_m))
        )
    result = evaluated(write_map(tmp_path / "m.gpkg", frames), truth)
    on_rows, everything = result.groups
    assert (on_rows.name, everything.name) == ("forward on the rows", "all frames")
    assert (on_rows.poses.frames, everything.poses.frames) == (2, 4)
    assert on_rows.obstacles.precision["0.10"] == on_rows.obstacles.recall["0.10"] == 1.0
    assert everything.obstacles.precision["0.10"] is not None
    assert everything.obstacles.precision["0.10"] < 1.0
    assert on_rows.poses.position_max_m == pytest.approx(0.0, abs=1e-9)


def test_without_a_row_there_is_one_group(tmp_path: Path) -> None:
    drives = [Drive(-3.0, -4.0, 0.0, "turn_1")]
    truth = write_truth(tmp_path / "truth", posts(), drives)
    pose = pose_of(drives[0], 0)
    universal = write_map(tmp_path / "m.gpkg", [(seen_from(pose, posts()), pose)])
    assert [group.name for group in evaluated(universal, truth).groups] == ["all frames"]


def test_frames_of_sessions_that_tell_no_lean_are_counted(tmp_path: Path) -> None:
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied, SQUARE)
    poses = [pose_of(drive, k) for k, drive in enumerate(SQUARE)]
    path = write_map(tmp_path / "m.gpkg", [(seen_from(pose, occupied), pose) for pose in poses])
    assert evaluated(path, truth).unlevelled_frames == len(poses)
    with (
        open_map(tmp_path / "levelled.gpkg", datum=DATUM, cell_m=CELL_M) as universal,
        universal.add_session("levelled", config=CONFIG) as session,
    ):
        for k, pose in enumerate(poses):
            grid = seen_from(pose, occupied)
            heights = np.zeros(grid.density.shape, np.int16)
            # A frame that found no ground has no heights though the lean was known.
            session.add(grid, pose, channels={"ground_cm": heights} if k else None)
    assert evaluated(tmp_path / "levelled.gpkg", truth).unlevelled_frames == 0


def test_errors_of_a_frame_are_signed_and_go_the_short_way_round(tmp_path: Path) -> None:
    drives = [Drive(-3.0, -4.0, 179.0), Drive(-3.0, -4.0, -10.0)]
    truth = write_truth(tmp_path / "truth", posts(), drives)
    blank = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, bool))
    true_poses = [pose_of(drive, k) for k, drive in enumerate(drives)]
    frames = [
        (blank, dataclasses.replace(true_poses[0], heading_deg=-178.0)),
        (
            blank,
            dataclasses.replace(
                true_poses[1],
                east_m=true_poses[1].east_m - 0.3,
                north_m=true_poses[1].north_m + 0.4,
                heading_deg=-12.5,
            ),
        ),
    ]
    result = evaluated(write_map(tmp_path / "m.gpkg", frames), truth)
    first, second = result.frames
    assert (first.frame_id, second.frame_id) == ("000000", "000001")
    assert first.heading_error_deg == pytest.approx(3.0)
    assert second.heading_error_deg == pytest.approx(-2.5)
    assert (second.east_error_m, second.north_error_m) == pytest.approx((-0.3, 0.4))
    poses = result.groups[-1].poses
    assert poses.position_max_m == pytest.approx(0.5)
    assert poses.position_median_m == pytest.approx(0.25)
    assert poses.heading_median_deg == pytest.approx(2.75)
    assert poses.heading_max_deg == pytest.approx(3.0)


def test_frames_belong_together_by_time_to_a_millisecond(tmp_path: Path) -> None:
    occupied = posts()
    truth = write_truth(tmp_path / "truth", occupied)
    frames = []
    for k, off_ns in enumerate((400_000, -900_000, 1_500_000, 600_000_000_000)):
        pose = pose_of(SQUARE[k], k)
        late = dataclasses.replace(pose, time_ns=pose.time_ns + off_ns)
        frames.append((seen_from(pose, occupied), late))
    result = evaluated(write_map(tmp_path / "m.gpkg", frames), truth)
    assert result.unmatched_frames == 2
    assert [frame.frame_id for frame in result.frames] == ["000000", "000001"]
    assert result.groups[-1].poses.frames == 2


def test_the_truth_of_another_drive_is_refused(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    pose = pose_of(SQUARE[0], 0, time_ns=time_ns(0) + 86_400_000_000_000)
    universal = write_map(tmp_path / "m.gpkg", [(seen_from(pose, posts()), pose)])
    with pytest.raises(TruthError, match="None of the map's 1 frames is in the truth"):
        evaluated(universal, truth)


# --- JSON


def test_a_result_is_json_without_nan(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    good = pose_of(SQUARE[0], 0)
    unknown = pose_of(
        SQUARE[1],
        1,
        heading_deg=math.nan,
        heading_sigma_deg=math.inf,
        status=Status.REJECTED,
        reason="heading unknown",
    )
    blank = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, bool))
    universal = write_map(tmp_path / "m.gpkg", [(blank, good), (blank, unknown)])
    result = evaluated(universal, truth).as_dict()
    text = json.dumps(result, allow_nan=False)
    assert json.loads(text) == result
    assert result["frames"][1]["heading_error_deg"] is None
    assert result["frames"][1]["heading_sigma_deg"] is None
    assert result["groups"][-1]["obstacles"]["precision"] == {"0.10": None, "0.25": None}
    assert result["cell_m"] == CELL_M


# --- truth and maps that cannot be compared


def a_map(tmp_path: Path, config: dict[str, Any] | None = None) -> Path:
    pose = pose_of(SQUARE[0], 0)
    return write_map(tmp_path / "m.gpkg", [(seen_from(pose, posts()), pose)], config)


@pytest.mark.parametrize(
    "other", [Datum(41.6501, -4.72, 787.4), Datum(41.65, -4.72, 735.0), Datum(-41.65, 4.72, 787.4)]
)
def test_another_datum_names_the_option_that_helps(other: Datum, tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts(), datum=other)
    with pytest.raises(TruthError, match=r"from the map's datum; build the map with --datum") as e:
        evaluated(a_map(tmp_path), truth)
    wanted = str(e.value).rpartition("--datum ")[2].rstrip(".")
    assert tuple(float(v) for v in wanted.split(",")) == dataclasses.astuple(other)


def test_a_truth_that_states_no_datum_is_believed(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts(), datum=None)
    assert read_truth(truth).datum is None
    assert evaluated(a_map(tmp_path), truth).groups[-1].obstacles.precision["0.10"] == 1.0


def test_the_folder_of_a_drive_stands_for_the_truth_in_it() -> None:
    found, expected = read_truth(TWO_LANES), read_truth(TWO_LANES / "truth")
    assert (found.occupied == expected.occupied).all()
    assert (found.poses, found.datum) == (expected.poses, expected.datum)


@pytest.mark.parametrize(
    "config",
    [{}, {"rig": {}}, {**CONFIG, "max_range_m": None}, {**CONFIG, "rig": {"camera": 3}}],
)
def test_a_session_that_does_not_say_what_its_camera_saw(
    config: dict[str, Any], tmp_path: Path
) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    with pytest.raises(TruthError, match="does not say what its camera saw"):
        evaluated(a_map(tmp_path, config), truth)


# NumPy leaves a file that it cannot open as an archive to the garbage collector.
leaves_files_open = pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning"
)


@leaves_files_open
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("obstacle_raster_5cm.npz", None),
        ("obstacle_raster_5cm.npz", b""),
        ("obstacle_raster_5cm.npz", b"PK\x03\x04 and no more"),
        ("obstacle_raster_5cm.npz", b"\x00\xff" * 100),
        ("observable_raster_5cm.npz", None),
        ("observable_raster_5cm.npz", b"\x00\xff" * 100),
    ],
)
def test_a_raster_that_is_missing_or_broken_is_named(
    name: str, content: bytes | None, tmp_path: Path
) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    (truth / name).unlink()
    if content is not None:
        (truth / name).write_bytes(content)
    with pytest.raises(TruthError, match=name):
        read_truth(truth)
    gc.collect(1)  # what this test made: to look at all objects takes a third of a second


@leaves_files_open
def test_a_truncated_raster_is_named(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    path = truth / "obstacle_raster_5cm.npz"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(TruthError, match=r"obstacle_raster_5cm\.npz cannot be read"):
        read_truth(truth)
    gc.collect(1)  # what this test made: to look at all objects takes a third of a second


@leaves_files_open
def test_no_flipped_byte_of_a_raster_is_another_error(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    path = truth / "obstacle_raster_5cm.npz"
    np.savez_compressed(path, occupied=posts(), east0=EAST_0_M, north0=NORTH_0_M, cell=CELL_M)
    whole = path.read_bytes()
    others = set()
    for at in range(0, len(whole), 5):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            read_truth(truth)
        except TruthError:
            pass
        except Exception as error:  # noqa: BLE001
            others.add(repr(error))
    gc.collect(1)  # what this test made: to look at all objects takes a third of a second
    assert others == set()


def test_a_table_of_poses_that_is_missing_is_named(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    (truth / "poses_frames.csv").unlink()
    with pytest.raises(TruthError, match=r"poses_frames\.csv cannot be read"):
        read_truth(truth)


def test_an_empty_table_of_poses_matches_no_frame(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts(), drives=())
    with pytest.raises(TruthError, match="None of the map's 1 frames is in the truth"):
        evaluated(a_map(tmp_path), truth)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"occupied": posts()[:-1]}, r"obstacle raster \(399, 400\) and the observable raster"),
        ({"occupied": posts().ravel()}, r"obstacle raster \(160000,\)"),
        ({"cell": None}, r"obstacle_raster_5cm\.npz cannot be read"),
        ({"occupied": np.array([{}])}, r"obstacle_raster_5cm\.npz cannot be read"),
    ],
)
def test_rasters_that_do_not_belong_together(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    whole = {"occupied": posts(), "east0": EAST_0_M, "north0": NORTH_0_M, "cell": CELL_M}
    arrays = {key: value for key, value in {**whole, **changes}.items() if value is not None}
    np.savez(truth / "obstacle_raster_5cm.npz", **arrays)
    with pytest.raises(TruthError, match=message):
        read_truth(truth)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("heading_deg", "yaw"),
        ("timestamp_utc_s", "time"),
        ("lane_1", "lane_1\n1308133816.0,1,2"),
        (",180.0,", ",south,"),
        ("1308133815.469", ""),
    ],
)
def test_a_table_of_poses_that_cannot_be_read_is_named(old: str, new: str, tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    path = truth / "poses_frames.csv"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(TruthError, match=r"poses_frames\.csv cannot be read"):
        read_truth(truth)


def test_a_row_of_poses_without_its_segment_is_named(tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    path = truth / "poses_frames.csv"
    path.write_text(path.read_text().replace(",lane_2", ""))
    with pytest.raises(TruthError, match=r"poses_frames\.csv cannot be read"):
        evaluated(a_map(tmp_path), truth)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_pose_that_is_no_number_is_named(value: str, tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    path = truth / "poses_frames.csv"
    path.write_text(path.read_text().replace(",180.0,", f",{value},"))
    with pytest.raises(TruthError, match=r"poses_frames\.csv cannot be read"):
        read_truth(truth)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"ltp_origin": {"lat_deg": 1}}'])
def test_a_session_file_without_an_origin_is_named(text: str, tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth", posts())
    (truth / "session.json").write_text(text)
    with pytest.raises(TruthError, match=r"session\.json does not state the truth's origin"):
        read_truth(truth)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(TruthError, match=r"no truth folder .*nowhere; give the folder"):
        read_truth(tmp_path / "nowhere")


# --- the example's truth


def test_the_truth_of_the_example() -> None:
    truth = read_truth(TWO_LANES / "truth")
    assert truth.datum == DATUM
    assert truth.lattice.cell_m == CELL_M
    assert truth.occupied.shape == truth.obstacle_pixels.shape == truth.window.shape
    assert len(truth.poses) == 50
    assert sum(pose.forward_on_row for pose in truth.poses) == 31
    assert [pose.direction for pose in truth.poses].count("reverse") == 3
    first = truth.poses[0]
    assert (first.time_ns, first.east_m, first.heading_deg) == (START_NS, -19.2265, 37.0)
    # Cells begin where the raster says: obstacles.json was made from the same scene.
    bounds = truth.lattice.bounds(truth.window)
    with np.load(TWO_LANES / "truth" / "obstacle_raster_5cm.npz") as raster:
        assert bounds.west_m == pytest.approx(float(raster["east0"]), abs=1e-6)
        assert bounds.south_m == pytest.approx(float(raster["north0"]), abs=1e-6)


def test_errors_are_compared_with_what_poses_state(tmp_path: Path) -> None:
    def sure(position_m: float, heading_deg: float) -> Callable[[Pose], Pose]:
        return lambda pose: dataclasses.replace(
            pose,
            east_m=pose.east_m + 0.1,
            heading_deg=pose.heading_deg + 1.0,
            position_sigma_m=position_m,
            heading_sigma_deg=heading_deg,
        )

    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    honest = scored(tmp_path / "a", posts(), sure(0.034, 0.34)).poses
    assert (honest.position_within_3_sigma, honest.heading_within_3_sigma) == (1.0, 1.0)
    lying = scored(tmp_path / "b", posts(), sure(0.033, 0.33)).poses
    assert (lying.position_within_3_sigma, lying.heading_within_3_sigma) == (0.0, 0.0)
