"""Bags as drives: the same bits as the plain folder of the same drive, whatever the container."""

from __future__ import annotations

import csv
import hashlib
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import (
    CalibrationError,
    GnssError,
    NoFramesError,
    RecordingError,
)
from fieldgrid.geometry import Carrier
from fieldgrid.pipeline import track_drive
from fieldgrid.recordings import Mounting, StereoFrame, open_drive, open_recording
from fieldgrid.recordings.files import parse_time_ns
from tests.conftest import TWO_LANES
from tests.recordings import bags
from tests.recordings.bags import CONTAINERS, Container, Maker, Said

pytestmark = pytest.mark.usefixtures("worked_out_once")

SharedData = Callable[[str], Path]

P_LEFT = np.array([[905.4, 0, 316.2, 0], [0, 905.4, 243.9, 0], [0, 0, 1, 0]])
P_RIGHT = P_LEFT + np.array([[0, 0, 0, -162.972], [0, 0, 0, 0], [0, 0, 0, 0]])
RTK = "gnss_rtk.nmea"
Rebuilt = Callable[..., Path]


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
def rebuilt(drive: Path, tmp_path: Path) -> Rebuilt:
    """The bag of the drive, with other messages."""

    def do(
        change: Callable[[list[Said]], list[Said] | None] = lambda said: said,
        container: Container = "mcap",
        **kind: bool,
    ) -> Path:
        maker = Maker(container)
        said = said_of(maker, drive, **kind)
        changed = change(said)
        path = tmp_path / f"b{len(list(tmp_path.iterdir()))}" / "drive"
        return settle(bags.write_bag(path, container, maker, said if changed is None else changed))

    return do


@pytest.fixture
def mcap(rebuilt: Rebuilt) -> Path:
    """The drive as an MCAP."""
    return rebuilt()


def without(*topics: str) -> Callable[[list[Said]], list[Said]]:
    return lambda said: [one for one in said if one.topic not in topics]


@pytest.mark.parametrize(
    ("container", "compressed"),
    [
        *((container, False) for container in CONTAINERS),
        ("mcap", True),
        *(pytest.param(c, True, marks=pytest.mark.long) for c in CONTAINERS if c != "mcap"),
    ],
)
def test_every_container_tells_what_the_folder_tells(
    container: Container, compressed: bool, drive: Path, rebuilt: Rebuilt
) -> None:
    bag = rebuilt(container=container, compressed=compressed)
    with open_recording(bag) as recording, open_recording(drive) as folder:
        assert recording.name == "drive"
        assert recording.rig == folder.rig
        assert recording.datum_hint == folder.datum_hint
        assert list(recording.fixes()) == list(folder.fixes())
        assert recording.gnss_source == bags.NMEA
        assert recording.losses == ()
        gyro, wanted = recording.motion().gyro, folder.motion().gyro
        assert gyro is not None
        assert wanted is not None
        assert gyro.time_ns.tobytes() == wanted.time_ns.tobytes()
        assert gyro.rate_rad_s.tobytes() == wanted.rate_rad_s.tobytes()
        for one, other in zip(recording.frames(), folder.frames(), strict=True):
            assert one.time_ns == other.time_ns
            assert isinstance(one, StereoFrame)
            assert one.left.name.startswith(bags.LEFT)
            assert one.left.name.endswith(f" @ {one.time_ns}")
            assert all(map(np.array_equal, one.images(), other.images()))
            if compressed:
                assert [s.sha256() for s in one.sources] == [s.sha256() for s in other.sources]


def test_every_topic_is_a_stream(mcap: Path, rebuilt: Rebuilt) -> None:
    with open_recording(mcap) as recording:
        streams = {stream.name: stream for stream in recording.streams()}
    left = streams[bags.LEFT]
    assert (left.kind, left.role, left.count) == ("sensor_msgs/Image", "left", 3)
    assert left.receive_ns is not None
    assert (left.receive_ns - left.stamp_ns).tolist() == [20_000_000] * 3
    with open_drive(rebuilt(without(bags.LEFT))) as bare:
        roles = {stream.name: stream.role for stream in bare.streams()}
        with pytest.raises(NoFramesError, match="no pair of a left and a right image"):
            bare.recording()
    assert [roles[name] for name in (bags.NMEA, bags.IMU, bags.RIGHT)] == ["nmea", "imu", ""]


def test_a_bag_without_images_is_tracked_by_its_fixes_and_motion(
    shared_data: SharedData,
) -> None:
    path = shared_data("husky_gps_rosbag") / "test1.bag"
    tracked = track_drive(path, carrier=Carrier(ahead_m=0.2))
    assert tracked.gnss_source == "/fix"
    assert len(tracked.estimate.fix_row) == 989
    assert any("no pair of a left" in one.message for one in tracked.findings)
    # The IMU lies on its side, which nothing says but what it feels.
    assert any("gravity is felt upward, along [0, 1, 0]" in one.message for one in tracked.findings)
    # The others have headings that are too unsure: the gyro shows that the fixes drift smoothly by
    # more than they state.
    assert tracked.estimate.trajectory.accepted[tracked.estimate.fix_row].sum() > 600
    with pytest.raises(RecordingError, match=r"no pair of a left .*/fix \(sensor_msgs/NavSatFix"):
        open_recording(path)


def test_the_hash_of_the_fixes_is_that_of_their_messages_or_their_log(
    drive: Path, rebuilt: Rebuilt
) -> None:
    def moved(said: list[Said]) -> list[Said]:
        return [one._replace(receive_ns=one.receive_ns + 7) for one in said]

    def changed(said: list[Said]) -> list[Said]:
        return [*said, next(one for one in said if one.topic == bags.NMEA)]

    def hash_of(change: Callable[[list[Said]], list[Said]], gnss: str | None = None) -> str:
        with open_recording(rebuilt(change), gnss) as recording:
            return recording.gnss_sha256()

    plain = hash_of(without())
    assert len(plain) == 64
    assert hash_of(moved) == plain != hash_of(changed)
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


def test_the_mounting_of_a_file_has_its_name_or_lies_in_its_folder(mcap: Path) -> None:
    own, shared = mcap.with_name("drive.mounting.json"), mcap.with_name("mounting.json")
    text = shared.read_text()
    own.write_text(text.replace('"camera_tilt_down_deg": 16.0', '"camera_tilt_down_deg": 15.0'))
    with open_recording(mcap) as recording:
        assert recording.rig.mount.tilt_deg == 15.0
    own.unlink()
    with open_recording(mcap) as recording:
        assert recording.rig.mount.tilt_deg == 16.0
    shared.unlink()
    given = Mounting(recording.rig.mount, recording.rig.antenna)
    with open_recording(mcap, mounting=given, image_time_offset_ns=5) as recording:
        assert recording.rig.image_time_offset_ns == 5
    with pytest.raises(CalibrationError, match="fieldgrid mount"):
        open_recording(mcap)
    tracked = track_drive(mcap)
    assert any("fieldgrid mount" in one.message for one in tracked.findings)
    assert tracked.estimate.trajectory.accepted.any()


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


def only_gga(said: list[Said]) -> list[Said]:
    return [s for s in said if s.topic != bags.NMEA or "GGA" in s.message.sentence]


def later(said: list[Said]) -> None:
    for stamp in (one.message.header.stamp for one in said if one.topic == bags.RIGHT):
        stamp.nanosec = (stamp.nanosec + 300_000_000) % bags.NANO


def uncalibrated(said: list[Said]) -> None:
    for one in said:
        if one.topic == bags.LEFT_INFO:
            one.message.k[:] = one.message.p[:] = 0.0


@pytest.mark.parametrize(
    ("change", "options", "error", "match"),
    [
        (without(bags.RIGHT), {}, RecordingError, r"no pair of a left .*/stereo/left/image_rect"),
        (
            without(bags.LEFT_INFO, bags.RIGHT_INFO),
            {},
            CalibrationError,
            "no readable camera_info for left_info",
        ),
        (uncalibrated, {}, CalibrationError, r"K\[0\] = 0 means"),
        (only_gga, {}, GnssError, "no valid RMC or ZDA"),
        (later, {}, RecordingError, "is of the moment of"),
        (
            without(),
            {"topics": {"left": bags.RIGHT, "right": bags.LEFT}},
            CalibrationError,
            r"baseline of -0\.18",
        ),
        (
            without(),
            {"topics": {"left": "/nowhere"}},
            RecordingError,
            "left=/nowhere is not there; .* of /gps/nmea",
        ),
        (
            without(),
            {"topics": {"left": bags.LEFT_INFO}},
            RecordingError,
            "of the type sensor_msgs/CameraInfo, not",
        ),
        (without(), {"gnss": "none.nmea"}, RecordingError, "neither a topic .* nor a log"),
        (without(), {"gnss": bags.LEFT}, RecordingError, "holds no fixes"),
    ],
)
def test_what_stands_against_a_recording_is_told(
    change: Any, options: dict[str, Any], error: type[Exception], match: str, rebuilt: Rebuilt
) -> None:
    with pytest.raises(error, match=match):
        open_recording(rebuilt(change), **options)


def test_stamps_since_the_start_of_the_machine_give_way_to_the_recorders(
    drive: Path, rebuilt: Rebuilt
) -> None:
    def booted(said: list[Said]) -> None:
        for one in said:
            if one.topic == bags.LEFT:
                one.message.header.stamp.sec -= 1_308_133_000

    with open_recording(rebuilt(booted)) as recording:
        received = [time_ns + 20_000_000 for time_ns, *_ in pairs_of(drive)]
        assert recording.frame_times_ns().tolist() == received
        assert sum("recorder's times are taken" in note for note in recording.notes) == 2
