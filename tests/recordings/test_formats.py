"""A format added through the registry is like the built-in ones; a drive is opened in one way."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import fieldgrid as fg
from fieldgrid.core import (
    BuildSettings,
    ConfigError,
    Int64,
    LackingError,
    NoFramesError,
    RecordingError,
)
from fieldgrid.export import export_map
from fieldgrid.geometry import FixColumns, Rig
from fieldgrid.maps import open_map
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline import (
    build_map,
    convert_recording,
    estimate_mount,
    inspect_recording,
    track_drive,
    write_estimate,
)
from fieldgrid.recordings import (
    Drive,
    DriveOptions,
    FixLog,
    Format,
    Frame,
    FrameSource,
    ImageFile,
    StereoFrame,
    as_recording,
    formats,
    mounting_path,
    open_drive,
    register_format,
    unregister_format,
    with_frames,
)
from tests.conftest import TWO_LANES
from tests.maps.file.content import content
from tests.recordings import bags
from tests.recordings.bags import Maker
from tests.recordings.test_bag import said_of, settle
from tests.recordings.test_euroc import write_euroc
from tests.recordings.test_kitti import write_kitti
from tests.recordings.test_kitti_odometry import write_sequence

pytestmark = pytest.mark.usefixtures("worked_out_once")

MakeDrive = Callable[..., Path]


# The whole of a format: a JSON file that names images and holds fixes and the rig.


@dataclass(frozen=True)
class ListedFrames:
    folder: Path
    rows: tuple[tuple[int, str, str], ...]
    size_px: tuple[int, int]
    roles: tuple[str, ...] = ("left", "right")

    @property
    def times_ns(self) -> Int64:
        return np.array([row[0] for row in self.rows], dtype=np.int64)

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        for time_ns, *names in self.rows[start:stop]:
            left, right = (ImageFile(self.folder / name) for name in names)
            yield StereoFrame(str(time_ns), time_ns, left, right, self.size_px)


def open_listed(path: Path, options: DriveOptions) -> Drive:
    options.refuse_topics(path)
    document = json.loads(path.read_text())
    columns = dict(document["fixes"])
    drive = Drive(
        path=path,
        name=path.stem,
        log=FixLog(FixColumns.of(columns.pop("time_ns"), **columns)),
        gnss_source=path.name,
    )
    rows = tuple((int(time), left, right) for time, left, right in document["frames"])
    rig = Rig.from_dict(document["rig"])
    source = ListedFrames(path.parent, rows, (rig.camera.width_px, rig.camera.height_px))
    return with_frames(drive, lambda drive: as_recording(drive, rig, source))


LISTED = Format(
    "listed", "a .drive file", lambda path: path.suffix == ".drive", open_listed, Path.resolve
)


@pytest.fixture
def listed(make_drive: MakeDrive) -> Iterator[tuple[Path, Path]]:
    """A drive of the example in a format of one's own, and as the folder that it is."""
    folder = make_drive("june", range(4, 9))
    with fg.open_recording(folder) as recording:
        fixes, rig = recording.fixes(), recording.rig
        rows = [
            (
                str(f.time_ns),
                f"left/{Path(f.sources[0].name).name}",
                f"right/{Path(f.sources[1].name).name}",
            )
            for f in recording.frames()
        ]
    document = {
        "fixes": {name: column.tolist() for name, column in fixes.columns().items()},
        "frames": rows,
        "rig": rig.as_dict(),
    }
    (folder / "june.drive").write_text(json.dumps(document))
    register_format(LISTED)
    yield folder / "june.drive", folder
    unregister_format("listed")


def test_a_format_is_added_in_one_file(listed: tuple[Path, Path], tmp_path: Path) -> None:
    path, folder = listed
    assert next(formats()) is LISTED
    with open_drive(path) as drive, open_drive(folder) as same:
        assert drive.kind == "listed"
        assert drive.fixes() == same.fixes()
        assert [stream.role for stream in drive.streams()] == ["left", "right", "fix"]
    wanted = track_drive(folder)
    tracked = track_drive(path, datum=wanted.estimate.trajectory.datum)
    assert (
        tracked.estimate.trajectory.east_m.tobytes() == wanted.estimate.trajectory.east_m.tobytes()
    )
    datum = wanted.estimate.trajectory.datum
    (report,) = build_map([path], tmp_path / "map.gpkg", BuildSettings(), datum=datum)
    assert (report.session, report.used) == ("june", 5)
    build_map([folder], tmp_path / "same.gpkg", BuildSettings(), datum=datum)
    assert content(tmp_path / "map.gpkg", "tiles") == content(tmp_path / "same.gpkg", "tiles")
    with open_map(tmp_path / "map.gpkg", writable=True) as universal:
        assert universal.verify(deep=True).problems == ()
        export_map(universal, tmp_path / "map.tif")
        whole = content(tmp_path / "map.gpkg")
        universal.remove_session("june")
        assert content(tmp_path / "map.gpkg", "tiles")["tiles"] == []
        universal.restore_session("june")
    assert content(tmp_path / "map.gpkg") == whole
    found = inspect_recording(path)
    assert (found.kind, found.frames, found.builds) == ("listed", 5, True)
    assert convert_recording(path, tmp_path / "june.mcap").topics["/gnss/fix"] == len(drive.fixes())
    assert estimate_mount(path).looked > 0
    assert mounting_path(path) == path.resolve()
    with pytest.raises(ConfigError, match="no bag and has no topics; leave --topic left out"):
        open_drive(path, DriveOptions(topics={"left": "/a"}))
    with pytest.raises(ConfigError, match="a format 'listed' already"):
        register_format(LISTED)


def test_what_is_no_drive_is_told_with_all_formats(tmp_path: Path) -> None:
    for path, match in (
        (tmp_path / "none", "does not exist; give the folder of a recording"),
        (tmp_path, "is no recording; looked for .*a .bag, an .mcap or .db3.*; give one of these"),
        (tmp_path / "no\0name", "does not exist"),
    ):
        match = match.replace("a .bag", r"a ROS 1 \.bag")
        with pytest.raises(RecordingError, match=match):
            open_drive(path)


@pytest.mark.parametrize("name", ["pipe", "pipe.bag", "pipe.mcap", "june-03"])
def test_pipes_and_devices_are_refused_at_once(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    for path in (tmp_path / name, Path("/dev/zero"), Path("/dev/stdin")):
        with pytest.raises(RecordingError, match="is neither a file nor a folder"):
            open_drive(path)


FILES = (
    *("frames.csv", "recording.toml", "session.json", "calibration/mounting.json"),
    *("calibration/stereo_left_camera_info.yaml", "gnss/rtk.nmea", "imu/imu_100hz.csv"),
    *("left/000000.jpg", "metadata.yaml"),
)


@pytest.mark.parametrize("name", FILES)
def test_a_pipe_inside_a_recording_does_not_block(name: str, make_drive: MakeDrive) -> None:
    folder = make_drive()
    path = folder / name
    if name.startswith("left/"):
        path = next((folder / "left").iterdir())
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    if name.startswith("gnss/"):
        shutil.rmtree(folder / "gnss")
        path.parent.mkdir()
    os.mkfifo(path)
    try:
        with open_drive(folder) as drive:
            for frame in drive.recording().frames():
                frame.images()
    except fg.FieldgridError as problem:
        assert str(problem).endswith(".")  # noqa: PT017


def test_a_drive_without_frames_says_so(make_drive: MakeDrive) -> None:
    folder = make_drive()
    for name in ("left", "right", "frames.csv", "calibration"):
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    with open_drive(folder) as drive:
        assert (drive.kind, drive.rig) == ("plain folder", None)
        assert len(drive.fixes())
        with pytest.raises(NoFramesError, match=r"neither frames\.csv, nor left/ and right/"):
            drive.recording()
    with pytest.raises(ConfigError, match="leave --mounting out"):
        open_drive(folder, DriveOptions(mounting=Path("a.json")))


def test_what_stands_against_the_frames_is_kept_with_the_fixes(make_drive: MakeDrive) -> None:
    folder = make_drive()
    (folder / "calibration" / "mounting.json").unlink()
    with open_drive(folder) as drive:
        assert len(drive.fixes())
        with pytest.raises(fg.FieldgridError, match="fieldgrid mount"):
            drive.recording()
    with open_drive(folder, DriveOptions(unmounted=True)) as drive:
        recording = drive.recording()
        assert not recording.is_mounted
        assert recording.frame_count == 3
    with pytest.raises(ConfigError, match="--antenna"):
        write_estimate(estimate_mount(folder), folder)


# --- what every format keeps


def images_of(source: FrameSource, start: int, stop: int) -> list[tuple[str, bytes]]:
    return [
        (frame.frame_id, b"".join(image.tobytes() for image in frame.images()))
        for frame in source.frames(start, stop)
    ]


def made_bag(container: bags.Container, folder: Path, out: Path) -> Path:
    said = said_of(Maker(container), folder)
    return settle(bags.write_bag(out / "drive", container, Maker(container), said))


MAKERS: dict[str, tuple[str, Callable[[Path, Path], Path]]] = {
    "folder": ("plain folder", lambda folder, _: folder),
    "euroc": ("EuRoC", write_euroc),
    "kitti": ("KITTI raw", lambda _, out: write_kitti(out)),
    "odometry": ("KITTI odometry", lambda _, out: write_sequence(out)),
    **{container: ("ROS bag", partial(made_bag, container)) for container in bags.CONTAINERS},
}
"""The formats, and what makes a drive of each: of a plain folder with a gyro, in a folder."""


@pytest.fixture(
    params=[
        pytest.param(
            name, marks=pytest.mark.long if name in set(bags.CONTAINERS) - {"mcap"} else ()
        )
        for name in MAKERS
    ]
)
def made(request: pytest.FixtureRequest, make_drive: MakeDrive, tmp_path: Path) -> tuple[str, Path]:
    """A drive in each format, of three frames or more but for KITTI's two."""
    kind, maker = MAKERS[request.param]
    folder = make_drive("june", range(4, 7))
    (folder / "imu").mkdir()
    lines = (TWO_LANES / "imu" / "imu_100hz.csv").read_text().splitlines(keepends=True)
    (folder / "imu" / "imu_100hz.csv").write_text("".join(lines[:2500]))
    return kind, maker(folder, tmp_path / "made")


def test_a_drive_opens_with_frames_and_fixes(made: tuple[str, Path]) -> None:
    kind, path = made
    with open_drive(path) as drive:
        recording = drive.recording()
        assert (drive.kind, recording.kind) == (kind, kind)
        assert recording.frame_count >= 2
        assert recording.is_mounted
        times_ns = recording.frame_times_ns()
        assert (np.diff(times_ns) > 0).all()
        assert [frame.time_ns for frame in recording.frames()] == times_ns.tolist()
        assert len(drive.fixes())
        assert drive.gnss_source
        assert {"left", "right"} <= {stream.role for stream in drive.streams()}
        size_px = (recording.rig.camera.width_px, recording.rig.camera.height_px)
        assert {image.shape for f in recording.frames() for image in f.images()} == {size_px[::-1]}
        assert drive.losses == ()


def test_frames_from_one_to_another_also_in_another_process(made: tuple[str, Path]) -> None:
    with fg.open_recording(made[1]) as recording:
        source, count = recording.source, recording.frame_count
        whole = images_of(source, 0, count)
        assert [name for name, _ in whole] == [frame.frame_id for frame in recording.frames()]
        assert [frame.frame_id for frame in recording.frames(1, 2)] == [whole[1][0]]
        assert [f.frame_id for f in recording.frames(count - 1, 99)] == [whole[-1][0]]
        assert list(recording.frames(count, 1)) == []
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            shares = list(pool.map(images_of, [source] * 2, [0, 1], [1, count]))
        assert shares[0] + shares[1] == whole
        (frame,) = pickle.loads(pickle.dumps(list(recording.frames(1, 2))))
        assert b"".join(image.tobytes() for image in frame.images()) == whole[1][1]


def test_a_part_of_the_time_is_cut_out(made: tuple[str, Path]) -> None:
    with fg.open_recording(made[1]) as recording:
        times_ns = recording.frame_times_ns() + recording.rig.image_time_offset_ns
        first, last = (int(times_ns[k]) for k in (0, -1))
    with open_drive(made[1], DriveOptions(from_ns=first, until_ns=last)) as drive:
        part = drive.recording()
        assert part.frame_times_ns().tolist() == recording.frame_times_ns()[:-1].tolist()
        names = [frame.frame_id for frame in recording.frames()]
        assert [frame.frame_id for frame in part.frames()] == names[:-1]
        assert all(first <= fix.time_ns < last for fix in part.fixes())
    with pytest.raises(RecordingError, match=r"Nothing is left of .* from 20\d\d-.* --until"):
        open_drive(made[1], DriveOptions(until_ns=400_000_000 * 10**9))


def test_what_a_format_cannot_use_is_refused(made: tuple[str, Path], tmp_path: Path) -> None:
    kind, path = made
    if kind != "ROS bag":
        with pytest.raises(ConfigError, match="leave --topic left out"):
            open_drive(path, DriveOptions(topics={"left": "/a"}))
        with pytest.raises(ConfigError, match="leave --epoch out"):
            open_drive(path, DriveOptions(epoch_ns=10**18))
    with pytest.raises(ConfigError, match=r"none\.json cannot be read"):
        open_drive(path, DriveOptions(mounting=tmp_path / "none.json")).recording()
    with pytest.raises(fg.FieldgridError, match=r"none\.nmea"):
        open_drive(path, DriveOptions(gnss="none.nmea"))


@pytest.mark.parametrize("left", [0.0, 0.5, 0.97])
def test_files_that_are_cut_are_told_and_never_crash(
    left: float, made: tuple[str, Path], tmp_path: Path
) -> None:
    """Each file of the drive in turn, once: an error is a sentence, or what is there is read."""
    path = made[1]
    files = [p for p in [path, *path.rglob("*")] if p.is_file()]
    seen: set[str] = set()
    for file in files:
        if (key := f"{file.parent.name}/{file.suffix}") in seen:
            continue
        seen.add(key)
        whole = file.read_bytes()
        file.unlink()  # images may be links
        file.write_bytes(whole[: int(left * len(whole))])
        try:
            with open_drive(path) as drive:
                for frame in drive.recording().frames():
                    frame.images()
        except fg.FieldgridError as problem:
            assert str(problem)[-1] in ".)", str(problem)  # noqa: PT017
        file.write_bytes(whole)
    assert seen


def test_all_that_is_lacking_is_told_at_once(made: tuple[str, Path]) -> None:
    """Without calibration, mounting and fixes: one error, in the order in which they are mended."""
    kind, path = made
    lacking = {
        "plain folder": (
            ("calibration", "gnss", "frames.csv"),
            ("neither stereo_opencv", "has no frames.csv", "no mounting.json"),
        ),
        "EuRoC": (
            ("mav0/cam0/sensor.yaml", "mounting.json", "gnss"),
            ("sensor.yaml cannot be read", "no mounting.json"),
        ),
        "KITTI raw": (
            tuple(f"calib_{n}.txt" for n in ("cam_to_cam", "velo_to_cam", "imu_to_velo")),
            ("calib_cam_to_cam.txt and calib_velo_to_cam.txt and calib_imu_to_velo.txt are",),
        ),
        "KITTI odometry": (("recording.toml", "../../poses"), ("nothing says when it was driven",)),
        "ROS bag": ((), ()),
    }
    names, sentences = lacking[kind]
    if not names:
        pytest.skip("what a bag lacks is in tests of its own")
    for name in names:
        one = path / name
        shutil.rmtree(one) if one.is_dir() else one.unlink()
    with pytest.raises(RecordingError) as caught, open_drive(path) as drive:
        drive.recording()
    said = str(caught.value)
    assert "\n" not in said
    if kind != "KITTI raw":
        sentences += ("has no GNSS log",)
        assert isinstance(caught.value, LackingError)
        assert len(caught.value.problems) == len(sentences)
        copied = pickle.loads(pickle.dumps(caught.value))
        assert str(copied) == said
    places = [said.index(sentence) for sentence in sentences]
    assert places == sorted(places)


def test_rigs_options_and_gridders_can_be_pickled() -> None:
    options = DriveOptions("rtk.nmea", topics={"left": "/a"}, mounting=Path("m.json"))
    assert pickle.loads(pickle.dumps(options)) == options
    with fg.open_recording(TWO_LANES, "gnss_rtk.nmea") as recording:
        rig = pickle.loads(pickle.dumps(recording.rig))
        assert rig == recording.rig
        assert hash(rig) == hash(recording.rig)
        assert Rig.from_dict(json.loads(json.dumps(rig.as_dict()))) == rig
        gridder = LocalGridder(rig)
        left, right = next(recording.frames()).images()
        grid, _ = gridder(left, right)
        copy, _ = pickle.loads(pickle.dumps(gridder))(left, right)
    assert np.array_equal(copy.density, grid.density)
    assert np.array_equal(copy.observed, grid.observed)
