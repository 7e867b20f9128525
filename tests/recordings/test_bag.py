"""Bags as drives: the same bits as the plain folder of the same drive, whatever the container."""

from __future__ import annotations

import csv
import hashlib
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import (
    BuildSettings,
    CalibrationError,
    ConfigError,
    GnssError,
    NoFramesError,
    RecordingError,
)
from fieldgrid.geometry import Carrier, StereoCamera
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map, track_drive
from fieldgrid.recordings import Mounting, Recording, StereoFrame, open_drive, open_recording
from fieldgrid.recordings.files import parse_time_ns
from tests.conftest import TWO_LANES
from tests.recordings import bags
from tests.recordings.bags import CONTAINERS, Container, Maker, Said

pytestmark = pytest.mark.usefixtures("worked_out_once")

SharedData = Callable[[str], Path]

P_LEFT = np.array([[905.4, 0, 316.2, 0], [0, 905.4, 243.9, 0], [0, 0, 1, 0]])
P_RIGHT = P_LEFT + np.array([[0, 0, 0, -162.972], [0, 0, 0, 0], [0, 0, 0, 0]])
RTK = "gnss_rtk.nmea"
KITTI = "kitti_2011_09_30_drive_0020"


def pairs_of(folder: Path) -> list[tuple[int, str, str]]:
    with (folder / "frames.csv").open(newline="") as table:
        return [(parse_time_ns(row), row["left"], row["right"]) for row in csv.DictReader(table)]


def settle(bag: Path, name: str = "drive") -> Path:
    """What lies beside the bag of the example: its mounting, and the datum of its session."""
    folder = bag if bag.is_dir() else bag.parent
    shutil.copy(TWO_LANES / "calibration" / "mounting.json", folder)
    (folder / "recording.toml").write_text(
        f'name = "{name}"\n[datum]\nlat_deg = 41.65\nlon_deg = -4.72\nheight_m = 787.4\n'
    )
    return bag


def said_of(maker: Maker, folder: Path, *, compressed: bool = False) -> list[Said]:
    """A plain folder of the example as messages."""
    pairs = pairs_of(folder)
    said = list(bags.images_said(maker, folder, pairs, (P_LEFT, P_RIGHT), compressed=compressed))
    said += bags.sentences_said(maker, folder / "gnss" / RTK, pairs[0][0] - 3 * bags.NANO)
    if (folder / "imu").is_dir():
        said += bags.gyro_said(maker, folder / "imu" / "imu_100hz.csv")
    return said


@pytest.fixture
def drive(make_drive: Callable[..., Path]) -> Path:
    """Three frames of the example with its gyro."""
    folder = make_drive()
    (folder / "imu").mkdir()
    lines = (TWO_LANES / "imu" / "imu_100hz.csv").read_text().splitlines(keepends=True)
    (folder / "imu" / "imu_100hz.csv").write_text("".join(lines[:2500]))
    return folder


@pytest.fixture
def mcap(drive: Path, tmp_path: Path) -> Path:
    """The same as an MCAP."""
    maker = Maker("mcap")
    return settle(bags.write_bag(tmp_path / "b" / "drive", "mcap", maker, said_of(maker, drive)))


def same_images(bag: Recording, folder: Recording) -> Iterator[bool]:
    for one, other in zip(bag.frames(), folder.frames(), strict=True):
        assert one.time_ns == other.time_ns
        for image, wanted in zip(one.images(), other.images(), strict=True):
            yield np.array_equal(image, wanted)


def content(path: Path) -> tuple[list[Any], Any]:
    """Everything of a map that comes from images, fixes and motion."""
    with open_map(path) as universal:
        (session,) = universal.sessions()
        frames = [
            (frame.frame_id, frame.pose, frame.grid().density.tobytes(), frame.quality)
            for frame in universal.frames(with_grid=True)
        ]
        inputs = {k: v.tobytes() for k, v in universal.session_inputs(session.name).items()}
        return frames, inputs


@pytest.mark.parametrize(
    ("container", "compressed"),
    [
        *((container, False) for container in CONTAINERS),
        ("mcap", True),
        *(pytest.param(c, True, marks=pytest.mark.long) for c in CONTAINERS if c != "mcap"),
    ],
)
def test_every_container_tells_what_the_folder_tells(
    container: Container, compressed: bool, drive: Path, tmp_path: Path
) -> None:
    maker = Maker(container)
    said = said_of(maker, drive, compressed=compressed)
    bag = settle(bags.write_bag(tmp_path / "b" / "drive", container, maker, said))
    with open_recording(bag) as recording, open_recording(drive) as folder:
        assert recording.name == "drive"
        assert recording.rig == folder.rig
        assert recording.datum_hint == folder.datum_hint
        assert list(recording.fixes()) == list(folder.fixes())
        assert recording.gnss_source == bags.NMEA
        assert recording.frame_times_ns().tolist() == folder.frame_times_ns().tolist()
        assert recording.losses == ()
        gyro, wanted = recording.motion().gyro, folder.motion().gyro
        assert gyro is not None
        assert wanted is not None
        assert gyro.time_ns.tobytes() == wanted.time_ns.tobytes()
        assert gyro.rate_rad_s.tobytes() == wanted.rate_rad_s.tobytes()
        assert all(same_images(recording, folder))
        if compressed:
            hashes = [[s.sha256() for s in f.sources] for f in recording.frames()]
            assert hashes == [[s.sha256() for s in f.sources] for f in folder.frames()]


@pytest.mark.parametrize(
    ("container", "compressed"),
    [pytest.param("bag", True, marks=pytest.mark.long), ("mcap", False)],
)
def test_a_map_has_the_same_bits(
    container: Container, compressed: bool, drive: Path, tmp_path: Path
) -> None:
    maker = Maker(container)
    said = said_of(maker, drive, compressed=compressed)
    bag = settle(bags.write_bag(tmp_path / "b" / "drive", container, maker, said))
    settings = BuildSettings()
    build_map([bag], tmp_path / "bag.gpkg", settings)
    build_map([drive], tmp_path / "folder.gpkg", settings)
    frames, inputs = content(tmp_path / "bag.gpkg")
    frames_wanted, inputs_wanted = content(tmp_path / "folder.gpkg")
    with open_map(tmp_path / "bag.gpkg") as universal, open_recording(bag) as recording:
        assert universal.sessions()[0].source_sha256 == recording.gnss_sha256()
    assert len(frames) == 3
    assert inputs == inputs_wanted
    # The example counts its frames from its first one, the bag from the first it holds.
    assert [one[1:] for one in frames] == [one[1:] for one in frames_wanted]


def test_all_frames_of_the_example_are_the_same_in_a_bag(tmp_path: Path) -> None:
    maker = Maker("db3")
    bag = settle(
        bags.write_bag(tmp_path / "b", "db3", maker, said_of(maker, TWO_LANES, compressed=True))
    )
    with open_recording(bag) as recording, open_recording(TWO_LANES, RTK) as folder:
        assert recording.frame_count == 50
        assert list(recording.fixes()) == list(folder.fixes())
        assert all(same_images(recording, folder))


@pytest.mark.parametrize(
    ("container", "compressed"),
    [
        pytest.param(c, packed, marks=() if (c, packed) == ("mcap", True) else pytest.mark.long)
        for c in CONTAINERS
        for packed in (False, True)
    ],
)
def test_a_kitti_drive_with_covariances_is_that_of_a_table_with_sigmas(
    container: Container, compressed: bool, shared_data: SharedData, tmp_path: Path
) -> None:
    kitti = open_recording(shared_data(KITTI), mounting=None)
    assert isinstance(kitti.rig.sensor, StereoCamera)
    frames = list(kitti.frames())[:4]
    folder, maker = tmp_path / "folder", Maker(container)
    calibrate_like(folder, kitti)
    files = [(f.time_ns, Path(f.left.name).name, f.left, f.right) for f in frames]
    rows = ["frame_id,time_ns,left,right"]
    for k, (time_ns, name, *sources) in enumerate(files):
        for side, source in zip(("left", "right"), sources, strict=True):
            (folder / side).mkdir(exist_ok=True)
            shutil.copyfile(source.name, folder / side / name)
        rows.append(f"{k:06d},{time_ns},left/{name},right/{name}")
    (folder / "frames.csv").write_text("\n".join(rows))
    P = projections_of(kitti.rig.sensor)
    pairs = [(time_ns, f"left/{name}", f"right/{name}") for time_ns, name, *_ in files]
    said = list(bags.images_said(maker, folder, pairs, P, compressed=compressed))
    table = ["time_ns,lat_deg,lon_deg,height_m,sigma_m"]
    for fix in kitti.fixes():
        assert fix.sigma_m is not None
        sigma_m = math.sqrt(fix.sigma_m**2)  # as a covariance holds it
        values = fix.lat_deg, fix.lon_deg, fix.height_m
        table.append(",".join([str(fix.time_ns), *map(repr, values), repr(sigma_m)]))
        message = maker.fix(fix.time_ns, *values, sigma_m=fix.sigma_m)
        said.append(Said(fix.time_ns, bags.FIX, message))
    (folder / "gnss").mkdir()
    (folder / "gnss" / "fixes.csv").write_text("\n".join(table))
    bag = bags.write_bag(tmp_path / "b" / "kitti", container, maker, said)
    mounting = folder / "calibration" / "mounting.json"
    with open_recording(bag, mounting=mounting) as recording, open_recording(folder) as wanted:
        assert list(recording.fixes()) == list(wanted.fixes())
        assert {fix.quality for fix in recording.fixes()} <= {4, 5, 1}
        assert all(same_images(recording, wanted))
        assert recording.rig == wanted.rig
        first, second = track_ends(recording), track_ends(wanted)
    assert first == second
    inside = bag / "mounting.json" if bag.is_dir() else bag.with_name("kitti.mounting.json")
    shutil.copy(mounting, inside)
    build_map([bag], tmp_path / "bag.gpkg", BuildSettings())
    build_map([folder], tmp_path / "folder.gpkg", BuildSettings())
    assert content(tmp_path / "bag.gpkg") == content(tmp_path / "folder.gpkg")


def calibrate_like(folder: Path, kitti: Recording) -> None:
    """The calibration of KITTI as files of a plain folder."""
    rig, calibration = kitti.rig, folder / "calibration"
    calibration.mkdir(parents=True)
    P_left, P_right = projections_of(rig.camera)
    size = f"image_width: {rig.camera.width_px}\nimage_height: {rig.camera.height_px}\n"
    for key, P in (("left", P_left), ("right", P_right)):
        (calibration / f"stereo_{key}_camera_info.yaml").write_text(
            f"{size}camera_matrix: {{data: {P[:, :3].ravel().tolist()}}}\n"
            f"projection_matrix: {{data: {P.ravel().tolist()}}}\n"
        )
    arm, mount = rig.antenna, rig.mount
    antenna = [arm.forward_m, -arm.right_m, arm.up_m - mount.height_m]
    (calibration / "mounting.json").write_text(
        f'{{"camera_height_above_ground_m": {mount.height_m}, '
        f'"camera_tilt_down_deg": {mount.tilt_deg}, '
        f'"gnss_antenna_from_camera_mid_flu_m": {antenna}}}'
    )


def projections_of(camera: StereoCamera) -> tuple[Any, Any]:
    f, right = camera.focal_px, camera.cx_right_px or camera.cx_px
    P_left = np.array([[f, 0, camera.cx_px, 0], [0, f, camera.cy_px, 0], [0, 0, 1, 0]])
    P_right = P_left.copy()
    P_right[0, 2:] = right, -f * camera.baseline_m
    return P_left, P_right


def track_ends(recording: Recording) -> list[float]:
    from fieldgrid.pipeline import estimate_trajectory

    trajectory = estimate_trajectory(recording)
    return [*trajectory.east_m[[0, -1]].tolist(), *trajectory.heading_deg[[0, -1]].tolist()]


def test_frames_can_be_had_again_and_tell_where_they_are_from(mcap: Path) -> None:
    with open_recording(mcap) as recording:
        first, again = list(recording.frames()), list(recording.frames())
        assert len(first) == recording.frame_count == 3
        for one, other in zip(first, again, strict=True):
            assert isinstance(one, StereoFrame)
            assert [s.name for s in one.sources] == [s.name for s in other.sources]
            assert one.left.name == f"{bags.LEFT} @ {one.time_ns}"
            assert one.left.sha256() != one.right.sha256()
        assert [frame.frame_id for frame in first] == ["000000", "000001", "000002"]


def test_every_topic_is_a_stream(mcap: Path) -> None:
    with open_recording(mcap) as recording:
        streams = {stream.name: stream for stream in recording.streams()}
    left = streams[bags.LEFT]
    assert (left.kind, left.role, left.count) == ("sensor_msgs/Image", "left", 3)
    assert left.receive_ns is not None
    assert (left.receive_ns - left.stamp_ns).tolist() == [20_000_000] * 3
    assert streams[bags.NMEA].role == "nmea"
    assert streams[bags.IMU].role == "imu"


def test_a_bag_without_images_is_tracked_by_its_fixes_and_motion(
    shared_data: SharedData,
) -> None:
    tracked = track_drive(
        shared_data("husky_gps_rosbag") / "test1.bag", carrier=Carrier(ahead_m=0.2)
    )
    assert tracked.gnss_source == "/fix"
    assert len(tracked.estimate.fix_row) == 989
    assert any("no pair of a left" in note for note in tracked.notes)
    # The IMU lies on its side, which nothing says but what it feels.
    assert any("gravity is felt upward, along [0, 1, 0]" in note for note in tracked.notes)
    accepted = tracked.estimate.trajectory.accepted[tracked.estimate.fix_row]
    # The others have headings that are too unsure: the gyro shows that the fixes drift smoothly by
    # more than they state.
    assert accepted.sum() > 600
    with pytest.raises(RecordingError, match=r"no pair of a left .*/fix \(sensor_msgs/NavSatFix"):
        open_recording(shared_data("husky_gps_rosbag") / "test1.bag")


def test_every_topic_of_a_bag_without_images_is_a_stream(drive: Path, tmp_path: Path) -> None:
    def without_left(_: Maker, said: list[Said]) -> list[Said]:
        return [one for one in said if one.topic != bags.LEFT]

    with open_drive(rebuilt(drive, tmp_path, without_left)) as bare:
        roles = {stream.name: stream.role for stream in bare.streams()}
        with pytest.raises(NoFramesError, match="no pair of a left and a right image"):
            bare.recording()
    assert roles[bags.NMEA] == "nmea"
    assert roles[bags.IMU] == "imu"
    assert roles[bags.RIGHT] == ""


def test_the_hash_of_the_fixes_is_that_of_their_messages_or_their_log(
    drive: Path, tmp_path: Path
) -> None:
    def moved(_: Maker, said: list[Said]) -> list[Said]:
        return [one._replace(receive_ns=one.receive_ns + 7) for one in said]

    def changed(maker: Maker, said: list[Said]) -> list[Said]:
        first = next(one for one in said if one.topic == bags.NMEA)
        return [*said, first]

    def hash_of(change: Callable[[Maker, list[Said]], list[Said]], gnss: str | None = None) -> str:
        with open_recording(rebuilt(drive, tmp_path, change), gnss) as recording:
            return recording.gnss_sha256()

    plain = hash_of(lambda _, said: said)
    assert len(plain) == 64
    assert hash_of(moved) == plain
    assert hash_of(changed) != plain
    log = drive / "gnss" / RTK
    assert hash_of(changed, str(log)) == hashlib.sha256(log.read_bytes()).hexdigest()


def test_a_bag_of_several_files_is_one_drive(drive: Path, tmp_path: Path) -> None:
    maker = Maker("bag")
    said = sorted(said_of(maker, drive), key=lambda one: one.receive_ns)
    for k in range(3):
        part = said[k * len(said) // 3 : (k + 1) * len(said) // 3]
        bags.write_bag(tmp_path / "split" / f"drive_{9 + k}", "bag", maker, part)
    with open_recording(settle(tmp_path / "split")) as recording, open_recording(drive) as folder:
        assert list(recording.fixes()) == list(folder.fixes())
        assert recording.frame_times_ns().tolist() == folder.frame_times_ns().tolist()
        note = "3 files are read as one drive: drive_9.bag to drive_11.bag."
        assert note in recording.notes


def test_a_bag_is_tracked_like_its_folder(mcap: Path, drive: Path) -> None:
    bag, folder = track_drive(mcap), track_drive(drive)
    assert bag.name == "drive"
    assert bag.estimate.trajectory.east_m.tobytes() == folder.estimate.trajectory.east_m.tobytes()
    with pytest.raises(ConfigError, match="mounting"):
        track_drive(mcap, carrier=Carrier())


def test_without_mounting_a_bag_is_tracked_and_not_built(mcap: Path) -> None:
    (mcap.parent / "mounting.json").unlink()
    with pytest.raises(CalibrationError, match="fieldgrid mount"):
        open_recording(mcap)
    tracked = track_drive(mcap)
    assert any("fieldgrid mount" in note for note in tracked.notes)
    assert tracked.estimate.trajectory.accepted.any()


def test_the_mounting_of_a_file_has_its_name_or_lies_in_its_folder(mcap: Path) -> None:
    own = mcap.with_name("drive.mounting.json")
    text = (mcap.parent / "mounting.json").read_text()
    own.write_text(text.replace('"camera_tilt_down_deg": 16.0', '"camera_tilt_down_deg": 15.0'))
    with open_recording(mcap) as recording:
        assert recording.rig.mount.tilt_deg == 15.0
    own.unlink()
    with open_recording(mcap) as recording:
        assert recording.rig.mount.tilt_deg == 16.0
    given = Mounting(recording.rig.mount, recording.rig.antenna)
    (mcap.parent / "mounting.json").unlink()
    with open_recording(mcap, mounting=given, image_time_offset_ns=5) as recording:
        assert recording.rig.image_time_offset_ns == 5


def test_the_settings_of_a_file_have_its_name_or_lie_in_its_folder(mcap: Path) -> None:
    mcap.with_suffix(".toml").write_text('name = "own"\nimage_time_offset_s = 0.25\n')
    with open_recording(mcap) as recording:
        assert recording.name == "own"
        assert recording.rig.image_time_offset_ns == 250_000_000
        assert recording.datum_hint is None
    mcap.with_suffix(".toml").write_text('frames = "frames.csv"\n')
    with pytest.raises(RecordingError, match="frames is for folders"):
        open_recording(mcap)


def test_the_log_may_lie_beside_the_bag(mcap: Path, drive: Path) -> None:
    shutil.copy(drive / "gnss" / RTK, mcap.parent)
    with open_recording(mcap, RTK) as recording, open_recording(drive) as folder:
        assert recording.gnss_source == RTK
        assert list(recording.fixes()) == list(folder.fixes())
        assert recording.motion().gyro is not None
    with open_recording(mcap, bags.NMEA) as recording:
        assert recording.gnss_source == bags.NMEA
    with pytest.raises(RecordingError, match=r"neither a topic .* nor a log"):
        open_recording(mcap, "gnss_none.nmea")
    with pytest.raises(RecordingError, match="holds no fixes"):
        open_recording(mcap, bags.LEFT)


def test_what_a_cut_bag_still_holds_is_used_and_the_loss_told(mcap: Path, drive: Path) -> None:
    mcap.write_bytes(mcap.read_bytes()[:-200_000])
    with open_recording(mcap) as recording:
        (lost,) = recording.losses
        assert "cannot be read" in lost or "not closed" in lost
        assert 0 < recording.frame_count <= 3
        assert len(list(recording.frames())) == recording.frame_count
    assert lost in track_drive(mcap).notes


@pytest.mark.parametrize("container", CONTAINERS)
def test_an_empty_file_is_told(container: Container, tmp_path: Path) -> None:
    path = tmp_path / f"empty.{container.removesuffix(' folder')}"
    path.touch()
    with pytest.raises(RecordingError, match="is empty"):
        open_recording(path)


def test_a_file_that_is_no_bag_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "letter.txt"
    path.write_text("Dear Sir or Madam")
    with pytest.raises(GnssError, match="no bag and no GNSS log that is known"):
        open_recording(path)


def rebuilt(drive: Path, tmp_path: Path, change: Callable[[Maker, list[Said]], list[Said]]) -> Path:
    """The bag of the drive with other messages."""
    maker = Maker("mcap")
    said = change(maker, said_of(maker, drive))
    return settle(bags.write_bag(tmp_path / "changed" / "drive", "mcap", maker, said))


def test_a_missing_topic_is_told_with_what_there_is(drive: Path, tmp_path: Path) -> None:
    path = rebuilt(drive, tmp_path, lambda _, said: [s for s in said if s.topic != bags.RIGHT])
    with pytest.raises(RecordingError, match=r"no pair of a left .*/stereo/left/image_rect"):
        open_recording(path)
    path = rebuilt(
        drive, tmp_path / "2", lambda _, said: [s for s in said if "info" not in s.topic]
    )
    with pytest.raises(CalibrationError, match=r"no readable camera_info for left_info"):
        open_recording(path)


def test_a_bag_without_fixes_opens_and_says_so(drive: Path, tmp_path: Path) -> None:
    path = rebuilt(drive, tmp_path, lambda _, said: [s for s in said if s.topic != bags.NMEA])
    with open_recording(path) as recording:
        assert list(recording.fixes()) == []
        assert any("No topic with fixes" in note for note in recording.notes)


def test_sentences_without_a_date_are_told(drive: Path, tmp_path: Path) -> None:
    def only_gga(_: Maker, said: list[Said]) -> list[Said]:
        return [s for s in said if s.topic != bags.NMEA or "GGA" in s.message.sentence]

    with pytest.raises(GnssError, match=r"no valid RMC or ZDA"):
        open_recording(rebuilt(drive, tmp_path, only_gga))


def test_a_side_that_stops_half_way_leaves_the_pairs_before(drive: Path, tmp_path: Path) -> None:
    def stopped(_: Maker, said: list[Said]) -> list[Said]:
        rights = [s for s in said if s.topic == bags.RIGHT]
        return [s for s in said if s.topic != bags.RIGHT or s is rights[0]]

    with open_recording(rebuilt(drive, tmp_path, stopped)) as recording:
        assert recording.frame_count == 1
        assert len(list(recording.frames())) == 1
        assert any("2 left and 0 right images without a partner" in n for n in recording.notes)


def test_images_that_never_fall_together_are_told(drive: Path, tmp_path: Path) -> None:
    def later(maker: Maker, said: list[Said]) -> list[Said]:
        for one in said:
            if one.topic == bags.RIGHT:
                stamp = one.message.header.stamp
                stamp.nanosec = (stamp.nanosec + 300_000_000) % bags.NANO
        return said

    with pytest.raises(RecordingError, match="is of the moment of"):
        open_recording(rebuilt(drive, tmp_path, later))


def test_stamps_since_the_start_of_the_machine_give_way_to_the_recorders(
    drive: Path, tmp_path: Path
) -> None:
    def booted(_: Maker, said: list[Said]) -> list[Said]:
        for one in said:
            if one.topic == bags.LEFT:
                one.message.header.stamp.sec -= 1_308_133_000
        return said

    with open_recording(rebuilt(drive, tmp_path, booted)) as recording:
        received = [time_ns + 20_000_000 for time_ns, *_ in pairs_of(drive)]
        assert recording.frame_times_ns().tolist() == received
        assert sum("recorder's times are taken" in note for note in recording.notes) == 2


def test_swapped_topics_are_a_calibration_that_cannot_be(mcap: Path) -> None:
    topics = {"left": bags.RIGHT, "right": bags.LEFT}
    with pytest.raises(CalibrationError, match=r"baseline of -0\.18"):
        open_recording(mcap, topics=topics)


def test_given_topics_are_checked(mcap: Path) -> None:
    with pytest.raises(RecordingError, match=r"left=/nowhere is not there; .* of /gps/nmea"):
        open_recording(mcap, topics={"left": "/nowhere"})
    with pytest.raises(RecordingError, match=r"of the type sensor_msgs/CameraInfo, not"):
        open_recording(mcap, topics={"left": bags.LEFT_INFO})
    with open_recording(mcap, topics={"left": bags.LEFT}) as recording:
        assert recording.frame_count == 3


def test_an_uncalibrated_camera_is_told(drive: Path, tmp_path: Path) -> None:
    def uncalibrated(_: Maker, said: list[Said]) -> list[Said]:
        for one in said:
            if one.topic == bags.LEFT_INFO:
                one.message.k[:] = 0.0
                one.message.p[:] = 0.0
        return said

    with pytest.raises(CalibrationError, match=r"K\[0\] = 0 means"):
        open_recording(rebuilt(drive, tmp_path, uncalibrated))
