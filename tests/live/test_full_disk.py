"""A disk that is really full: a small one of memory, which refuses what each writer writes.

Skipped where nothing may be mounted. What a disk does that is mocked is in `test_live` and
`test_kept_points`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from fieldgrid.core import BuildSettings, MapWriteError
from fieldgrid.live import LiveGrid, finish_session, replay
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import Frame, open_recording
from tests.conftest import make_small_drive
from tests.live.making import Told, begin
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")

PAGE = os.sysconf("SC_PAGE_SIZE")


class SmallDisk:
    """A disk of 16 MB at a place."""

    def __init__(self, place: Path) -> None:
        self.place, self.filler = place, place / "filler"

    def fill(self, left_bytes: int = 0) -> None:
        """Leave so much room."""
        with self.filler.open("ab", buffering=0) as file:
            while os.statvfs(self.place).f_bavail * PAGE > left_bytes:
                file.write(bytes(PAGE))

    def free(self) -> None:
        self.filler.unlink()


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SmallDisk]:
    """No room on it is reserved for the map."""
    monkeypatch.setattr("fieldgrid.live.kept.kept_points.RESERVE_BYTES", 0)
    monkeypatch.setattr("fieldgrid.live.kept.kept_points.AGAIN_BYTES", 0)
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(place)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no disk may be mounted here, so none can be filled")
    try:
        yield SmallDisk(place)
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def test_a_disk_that_is_full_while_driving_costs_the_frames_of_that_while(
    disk: SmallDisk, leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those before and after, also the points are kept: the map is that of a build of them."""
    # A pair whose writing is refused gives its room back, and for a moment the disk is not full.
    monkeypatch.setattr(SessionFolder, "claim_pair", lambda *_: False)
    drive, out, told = tmp_path / "drive", disk.place / "m.gpkg", Told()
    shutil.copytree(leaning_drive, drive, symlinks=True)
    with open_recording(drive) as recording:
        live = begin(recording, out, on_result=told)
        push_frame = live.push_frame

        def pushed(frame: Frame, *, wait: bool = False) -> bool:
            if frame.frame_id in ("000022", "000024"):
                live.drain()
                (disk.fill if frame.frame_id == "000022" else disk.free)()
            return push_frame(frame, wait=wait)

        live.push_frame = pushed  # type: ignore[method-assign]
        replay(live, recording, rate=None)
        assert (live.counts.frames, live.counts.dropped) == (4, 2)
        live.finish()
    assert len(told.of(LiveGrid)) == 6
    texts = told.texts("disk")
    for text in (
        "takes nothing: what is pushed waits in memory",
        "Frames are not kept until there is room",
        "could not be written (No space left on device), so until there is room the points",
        "takes what is pushed again",
        "takes frames again",
        "The points of frames are kept again",
    ):
        assert sum(text in one for one in texts) == 1, (text, texts)
    kept = ("000020", "000021", "000024", "000025")
    for image in [*drive.glob("left/*"), *drive.glob("right/*")]:
        if image.stem not in kept:
            image.unlink()
    fewer = make_small_drive(tmp_path / "fewer", map(int, kept))
    shutil.copy(fewer / "frames.csv", drive)
    build_map([drive], tmp_path / "built.gpkg", BuildSettings())
    assert content(out) == content(tmp_path / "built.gpkg")


def test_a_disk_that_is_full_at_the_end_keeps_the_drive(
    disk: SmallDisk, leaning_drive: Path, built_level: Path
) -> None:
    """However much room it has: grids that are made again, the map and its journal are refused one
    after the other."""
    out = disk.place / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.drain()
        threads = set(threading.enumerate())
        disk.fill()
        with pytest.raises(MapWriteError, match="--finish tries again"):
            live.finish()
        assert not set(threading.enumerate()) - threads
    for left_bytes in (30_000, 60_000, 150_000, 300_000):
        disk.free()
        disk.fill(left_bytes)
        with pytest.raises(MapWriteError, match="free some space"):
            finish_session(out)
        assert sorted(path.name for path in disk.place.iterdir()) == ["filler", "m.gpkg.work"]
    disk.free()
    finish_session(out)
    assert content(out) == content(built_level)
    with open_map(out) as universal:
        assert universal.verify(deep=True).sound


def test_a_session_that_begins_on_a_full_disk_says_what_to_do(
    disk: SmallDisk, leaning_drive: Path, built_level: Path
) -> None:
    """Its file is refused; with room it begins."""
    out = disk.place / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        disk.fill()
        with pytest.raises(MapWriteError, match="free some space"):
            begin(recording, out)
        disk.free()
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.finish()
    assert content(out) == content(built_level)
