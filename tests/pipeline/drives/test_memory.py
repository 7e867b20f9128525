"""Few frames are in memory at once."""

from __future__ import annotations

import gc
import threading
import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import FixColumns, Motion
from fieldgrid.maps import open_map
from fieldgrid.perception import LocalGridder
from fieldgrid.pipeline import SessionReport, add_recording, estimate_trajectory
from fieldgrid.pipeline.staging.perception import perceive_frame, side_by_side
from fieldgrid.recordings import Frame, Image, ImageSource, StereoFrame, Stream, open_recording
from tests.conftest import TWO_LANES

FRAMES = 16
"""More than twice what four threads may have before them."""


class Alive:
    """Counts objects that are alive, and the most that ever were."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.now = self.most = self.ever = 0

    def watch(self, thing: object) -> None:
        weakref.finalize(thing, self._gone)
        with self._lock:
            self.now += 1
            self.ever += 1
            self.most = max(self.most, self.now)

    def _gone(self) -> None:
        with self._lock:
            self.now -= 1


@dataclass
class Watched:
    """An image of the example, counted as long as it is in memory."""

    image: ImageSource
    alive: Alive

    @property
    def name(self) -> str:
        return self.image.name

    def read(self) -> Image:
        image = self.image.read()
        self.alive.watch(image)
        return image

    def sha256(self) -> str:
        return self.image.sha256()


class LongDrive:
    """The example over and over: a drive of any length that counts what of it is in memory."""

    def __init__(self, frame_count: int) -> None:
        self._of = open_recording(TWO_LANES, "gnss_rtk.nmea")
        self._pairs = list(self._of.frames())[5:8]
        self._start_ns = self._pairs[0].time_ns
        self.name, self.rig, self.datum_hint = "long", self._of.rig, self._of.datum_hint
        self.path = self._of.path
        self.gnss_source, self.notes, self.losses = self._of.gnss_source, (), ()
        self.pose_name = self._of.pose_name
        self.frame_count, self.source = frame_count, self
        self.images = Alive()
        self.drawn = 0

    def frame_times_ns(self) -> npt.NDArray[np.int64]:
        return self._start_ns + np.arange(self.frame_count, dtype=np.int64) * 20_000_000

    def image_times_ns(self) -> npt.NDArray[np.int64]:
        return self.frame_times_ns() + self.rig.image_time_offset_ns

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        for k, time_ns in list(enumerate(self.frame_times_ns().tolist()))[start:stop]:
            self.drawn += 1
            pair = self._pairs[k % len(self._pairs)]
            left, right = Watched(pair.left, self.images), Watched(pair.right, self.images)
            yield StereoFrame(f"{k:06d}", time_ns, left, right, pair.size_px)

    def fixes(self) -> FixColumns:
        return self._of.fixes()

    def gnss_sha256(self) -> str:
        return self._of.gnss_sha256()

    def motion(self) -> Motion:
        return self._of.motion()

    def streams(self) -> Sequence[Stream]:
        return self._of.streams()

    def close(self) -> None:
        self._of.close()

    def __enter__(self) -> LongDrive:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.mark.parametrize(
    ("jobs", "odometry"),
    [
        pytest.param(n, follows, marks=() if follows == (n > 1) and n != 2 else pytest.mark.long)
        for n in (1, 2, 4)
        for follows in (True, False)
    ],
)
@pytest.mark.usefixtures("worked_out_afresh")
def test_few_frames_are_in_memory_however_long_the_drive(
    jobs: int, odometry: bool, tmp_path: Path
) -> None:
    drive = LongDrive(FRAMES)
    trajectory = estimate_trajectory(drive)
    ahead: list[int] = []
    with open_map(tmp_path / "m.gpkg", datum=trajectory.datum) as universal:
        report = add_recording(
            universal,
            drive,
            jobs=jobs,
            progress=lambda now: ahead.append(drive.drawn - now.frames_done - 5),
            # The images of a few frames come again and again.
            settings=BuildSettings.model_validate(
                {
                    "pose": {"visual_odometry": odometry},
                    "checks": {"accept": ["frames-misplaced"]},
                }
            ),
        )
    # Each is read once, and five pairs before, for whether their rows match.
    assert drive.drawn == FRAMES + 5
    assert (report.frames, drive.images.ever) == (FRAMES, 2 * FRAMES + 10)
    assert report.used > 0
    assert report.camera_steps + report.camera_refusals == (FRAMES - 1 if odometry else 0)
    assert (report.fixes, 350 < report.fixes_accepted <= 437) == (437, True)
    assert max(ahead) <= jobs + 2
    assert drive.images.most <= 2 * jobs
    gc.collect()
    assert drive.images.now == 0


@pytest.mark.parametrize("jobs", [1, 3])
@pytest.mark.usefixtures("worked_out_afresh")
def test_a_slow_reader_of_perceived_frames_is_waited_for(jobs: int) -> None:
    drive, grids = LongDrive(10), Alive()
    order: list[str] = []
    ahead, drawn = [], threading.Semaphore(0)

    def frames() -> Iterator[Frame]:
        for frame in drive.frames():
            ahead.append(drive.drawn - len(order))
            drawn.release()
            yield frame

    for perceived in side_by_side(
        partial(perceive_frame, gridder=LocalGridder(drive.rig)), frames(), jobs
    ):
        grids.watch(perceived.grid.density)
        # Slow: all that may be drawn before this one is taken has been drawn.
        while drive.drawn < min(len(order) + jobs + 1, drive.frame_count):
            assert drawn.acquire(timeout=60.0)
        order.append(perceived.frame.frame_id)
        del perceived
    assert max(ahead) <= jobs + 2
    assert order == [f"{k:06d}" for k in range(10)]
    assert grids.most <= 2


def test_reasons_are_counted() -> None:
    report = SessionReport("x", frames=3, reasons=Counter({"b": 1, "a": 2}))
    assert report.frames_per_s == 0.0
    as_dict = report.as_dict()
    assert as_dict["reasons"] == {"a": 2, "b": 1}
    assert as_dict["findings"] == []
