"""Bags as recordings: no crash, and as many frames as were promised, each read or refused."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import FieldgridError, Float32
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.perception import Sweep
from fieldgrid.recordings import DriveOptions, Frame, Image, Mounting, Recording, open_drive
from fuzz.target import Target, check_sentence, written
from fuzz.targets_ros import mend_mcap
from tests.recordings import bags
from tests.recordings.bags import Container, Maker, Said
from tests.recordings.test_packed_depth import config, png, rvl

_UTC = 1_700_000_000_000_000_000
_STEP = 100_000_000
_P = np.array([[20.0, 0, 8, 0], [0, 20, 8, 0], [0, 0, 1, 0]])
_P_RIGHT = _P + np.array([[0, 0, 0, -4.0], [0, 0, 0, 0], [0, 0, 0, 0]])
_OPTIONS = DriveOptions(mounting=Mounting(Mount(2.0, 15.0), LeverArm(0.0, 0.0, 3.0)))


def check_drive(data: bytes) -> None:
    try:
        with open_drive(written(data, "drive.bag"), _OPTIONS) as drive:
            if drive.refusal is None:
                _check_frames(drive.recording())
            else:
                check_sentence(str(drive.refusal))
    except FieldgridError as error:
        check_sentence(str(error))


def _check_frames(drive: Recording) -> None:
    times_ns = drive.frame_times_ns()
    assert np.all(np.diff(times_ns) > 0)
    assert [frame.time_ns for frame in drive.frames()] == times_ns.tolist()
    last = drive.frame_count - 1
    assert [frame.time_ns for frame in drive.frames(last)] == times_ns[last:].tolist()
    for frame in drive.frames():
        try:
            frame.read(_Checks(frame))
        except FieldgridError as error:
            check_sentence(str(error))


class _Checks(NamedTuple):
    """What must hold of a frame that was read."""

    frame: Frame

    def pair(self, left: Image, right: Image) -> None:
        assert left.shape == right.shape == (16, 16)
        self._check_hashes()

    def depth(self, depth_m: Float32) -> None:
        assert not np.any(depth_m <= 0.0)
        self._check_hashes()

    def cloud(self, sweep: Sweep) -> None:
        assert np.isfinite(sweep.points_m).all()
        if sweep.after_s is not None:
            assert np.isfinite(sweep.after_s).all()
            assert sweep.after_s.shape == sweep.points_m.shape[:1]
        self._check_hashes()

    def _check_hashes(self) -> None:
        assert all(len(source.sha256()) == 64 for source in self.frame.sources)


def _small(maker: Maker, time_ns: int) -> Iterator[Said]:
    """What every seed has: a fix, a gyro and a transform."""
    yield Said(time_ns, bags.FIX, maker.fix(time_ns, 41.0, -4.0, 700.0, sigma_m=0.02))
    yield Said(time_ns, bags.IMU, maker.imu(time_ns, (0.0, 0.0, 0.1)))
    tree = maker.transforms(maker.transform("base_link", "imu_link", (0.0, 0.0, 0.0)))
    yield Said(time_ns, "/tf_static", tree)


def _stereo(maker: Maker) -> Iterator[Said]:
    for time_ns in (_UTC, _UTC + _STEP):
        for topic, info, P in (
            (bags.LEFT, bags.LEFT_INFO, _P),
            (bags.RIGHT, bags.RIGHT_INFO, _P_RIGHT),
        ):
            pixels = np.arange(256, dtype=np.uint8).reshape(16, 16)
            yield Said(time_ns, topic, maker.image(time_ns, pixels, "mono8"))
            yield Said(time_ns, info, maker.info(time_ns, (16, 16), P))
        yield from _small(maker, time_ns)


def _disparities(maker: Maker) -> Iterator[Said]:
    for time_ns in (_UTC, _UTC + _STEP):
        image = maker.image(time_ns, np.full((16, 16), 2.0, np.float32), "32FC1")
        disparity = maker.disparity(time_ns, image, 20.0, 0.2, 16.0, 1.0)
        yield Said(time_ns, "/stereo/disparity", disparity)
        yield Said(time_ns, bags.LEFT_INFO, maker.info(time_ns, (16, 16), _P))
        yield from _small(maker, time_ns)


def _packed_depths(maker: Maker) -> Iterator[Said]:
    depth = np.full((16, 16), 1500, np.uint16)
    for time_ns, kind, data in ((_UTC, "rvl", rvl(depth)), (_UTC + _STEP, "png", png(depth))):
        image = maker.compressed(time_ns, config() + data, f"16UC1; compressedDepth {kind}")
        yield Said(time_ns, "/depth/image/compressedDepth", image)
        yield Said(time_ns, "/depth/camera_info", maker.info(time_ns, (16, 16), _P))
        yield from _small(maker, time_ns)


def _clouds(maker: Maker) -> Iterator[Said]:
    points = np.random.default_rng(1).uniform(1.0, 9.0, (120, 3)).astype("<f4")
    for time_ns in (_UTC, _UTC + _STEP):
        yield Said(time_ns, "/lidar/points", maker.cloud(time_ns, points))
        yield from _small(maker, time_ns)


def _seeds(container: Container) -> list[bytes]:
    seeds = []
    for drive in (_stereo, _disparities, _packed_depths, _clouds):
        with tempfile.TemporaryDirectory() as folder:
            maker = Maker(container)
            path = bags.write_bag(
                Path(folder, "drive"), container, maker, drive(maker), packed=False
            )
            seeds.append(path.read_bytes())
    return seeds


TARGETS = [
    Target("drive in a ROS 1 bag", check_drive, lambda: _seeds("bag")),
    Target("drive in a .db3", check_drive, lambda: _seeds("db3")),
    Target("drive in an MCAP", check_drive, lambda: _seeds("mcap"), mend_mcap),
]
