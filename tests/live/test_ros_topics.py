"""Topics of a graph of ROS are taken as those of a bag of the same messages: frames of every kind,
fixes, motion. A stand-in of the node plays the bag; `tests/ros` has the real one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from fieldgrid.live import Head, RobotFrames, RosStream
from fieldgrid.recordings import (
    CloudFrame,
    Connection,
    DepthFrame,
    DriveOptions,
    Message,
    StereoFrame,
    Transforms,
    open_recording,
)
from tests.conftest import TWO_LANES
from tests.live.sources import running
from tests.recordings.bags import Maker, Said, write_bag
from tests.recordings.test_bag_drive import P_RIGHT, STEP, UTC, P, clouds_said, fixes_said

LATE_NS = 3_000_000


class Graph:
    """The topics of a bag, played when all that wants to has subscribed."""

    def __init__(self, bag: Path) -> None:
        with bag.open("rb") as file:
            self._messages = [
                Message(Connection(channel.topic, schema.name, "cdr", None), one.log_time, one.data)
                for schema, channel, one in make_reader(file).iter_messages()
                if schema is not None
            ]
        self._takers: dict[str, Callable[[Message], None]] = {}
        self.left: list[str] = []
        self.node = SimpleNamespace(destroy_subscription=self.left.append)
        self.looked = 0

    def remapped(self, names: tuple[str, ...]) -> dict[str, str]:
        return {}

    def topics(self) -> dict[str, str]:
        self.looked += 1
        if self.looked == 2:
            for one in self._messages:
                if one.topic in self._takers:
                    self._takers[one.topic](one)
        return {one.topic: one.connection.type for one in self._messages}

    def subscribe(self, topic: str, type_: str, take: Callable[[Message], None]) -> Any:
        self._takers[topic] = take
        return topic


def pairs_said(maker: Maker) -> Iterator[Said]:
    """Raw images that are to be rectified, stamped 3 ms apart; one left image has no partner."""
    random = np.random.default_rng(3)
    for k in range(4):
        for side, projection, late in (("left", P, 0), ("right", P_RIGHT, LATE_NS)):
            time_ns = UTC + k * STEP + late
            pixels = random.integers(0, 255, (24, 32), dtype=np.uint8)
            if (k, side) != (2, "right"):
                image = maker.image(time_ns, pixels, "mono8", "cam_optical")
                yield Said(time_ns, f"/zed/{side}/image_raw", image)
            lens = [0.1, -0.02, 0.0, 0.0, 0.0]
            info = maker.info(time_ns, (32, 24), projection, "cam_optical", D=lens)
            yield Said(time_ns, f"/zed/{side}/camera_info", info)


def depths_said(maker: Maker) -> Iterator[Said]:
    for k in range(3):
        depth = np.full((24, 32), 1500 + k, dtype=np.uint16)
        time_ns = UTC + k * STEP
        yield Said(time_ns, "/camera/depth/image_rect", maker.image(time_ns, depth, "16UC1"))
        yield Said(time_ns, "/camera/depth/camera_info", maker.info(time_ns, (32, 24), P))


def disparities_said(maker: Maker) -> Iterator[Said]:
    for k in range(3):
        time_ns = UTC + k * STEP
        image = maker.image(time_ns, np.full((24, 32), 4.0 + k, dtype="<f4"), "32FC1")
        said = maker.disparity(time_ns, image, 100.0, 0.2, 60.0, 1.0)
        yield Said(time_ns, "/stereo/disparity", said)
        yield Said(time_ns, "/stereo/left/camera_info", maker.info(time_ns, (32, 24), P))


def moved_said(maker: Maker) -> Iterator[Said]:
    for k in range(20):
        yield Said(UTC + k * STEP, "/wheels/odom", maker.odometry(UTC + k * STEP, 0.5 + k))


def values(frame: Any) -> list[Any]:
    return list(frame.images()) if isinstance(frame, StereoFrame) else [frame.source.read()]


@pytest.mark.parametrize(
    ("said", "kind", "count"),
    [
        (pairs_said, StereoFrame, 3),
        (depths_said, DepthFrame, 3),
        (disparities_said, DepthFrame, 3),
        (clouds_said, CloudFrame, 2),
    ],
)
def test_frames_of_every_kind_are_those_of_a_bag(
    said: Callable[[Maker], Iterator[Said]], kind: type, count: int, tmp_path: Path
) -> None:
    maker = Maker("mcap")
    messages = [*said(maker), *fixes_said(maker), *moved_said(maker)]
    bag = write_bag(tmp_path / "bag", "mcap", maker, messages)
    mounting = tmp_path / "mounting.json"
    text = (TWO_LANES / "calibration" / "mounting.json").read_text()
    mounting.write_text(text.replace('"stereo_baseline_m": 0.18,', ""))
    options = DriveOptions(mounting=mounting)
    head = Head(Graph(bag), options)  # type: ignore[arg-type]
    found = head.find(tmp_path / "row.head.mcap", threading.Event(), pytest.fail)
    assert found is not None
    assert not sorted(tmp_path.glob("row*"))
    with open_recording(bag, mounting=mounting) as recording:
        theirs = list(recording.frames())
        assert found.rig == recording.rig
        assert len(theirs) == count
        fixes, wheels = recording.fixes(), recording.motion().wheels
        assert wheels is not None
        stream = RosStream(head, RobotFrames(Transforms(), "gps", found.rig.antenna))
        with running(stream, rig=found.rig) as notes:
            notes.wait(lambda: len(notes.frames) == count and len(notes.fixes) == len(fixes))
            notes.wait(lambda: len(notes.rows) == len(wheels.time_ns))
        for ours, one in zip(notes.frames, theirs, strict=True):
            assert isinstance(ours, kind)
            assert (ours.frame_id, ours.time_ns) == (one.frame_id, one.time_ns)
            for a, b in zip(values(ours), values(one), strict=True):
                assert np.array_equal(a, b, equal_nan=True)
    assert notes.told == []


def test_it_is_said_what_a_drive_still_lacks(tmp_path: Path) -> None:
    maker = Maker("mcap")
    bag = write_bag(tmp_path / "bag", "mcap", maker, list(depths_said(maker)))
    stop, told = threading.Event(), list[str]()

    def tell(text: str) -> None:
        told.append(text)
        stop.set()

    head = Head(Graph(bag), DriveOptions())  # type: ignore[arg-type]
    assert head.find(tmp_path / "row.head.mcap", stop, tell) is None
    assert "mounting.json" in told[0]
    assert str(tmp_path) in told[0]
