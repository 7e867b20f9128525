"""Staged frames: what was put is what comes back, from memory, from a file, in any order."""

from __future__ import annotations

import errno
import json
import os
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from fieldgrid.core import ConfigError, MapError, MapWriteError
from fieldgrid.maps import (
    StagedFrame,
    StageFile,
    create_map,
    frame_of_record,
    frame_record,
    open_map,
    stage,
)
from tests.maps.file.content import content
from tests.maps.file.maps import CELL_M, DATUM, drive, grid_of, write_map


def staged(k: int) -> StagedFrame:
    return stage(
        grid_of(k),
        f"frame {k} ä",
        10**18 - k,
        images=(f"l{k}.png", f"r{k}.png"),
        images_sha256=(f"{k:064x}",),
        ground_found=k % 3 != 0,
        channels={"height": np.full(grid_of(k).spec.shape, k % 999, np.int16)},
    )


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 10**6), max_size=8, unique=True))
def test_frames_come_back_as_they_were(tmp_path: Path, seeds: list[int]) -> None:
    with StageFile(tmp_path / "map.gpkg") as temporary:
        frames = [staged(seed) for seed in seeds]
        assert [temporary.append(frame) for frame in frames] == list(range(len(frames)))
        assert list(temporary) == frames
        assert [temporary[k] for k in reversed(range(len(frames)))] == frames[::-1]
        assert [e[:3] for e in temporary.entries] == [
            (f.frame_id, f.time_ns, f.ground_found) for f in frames
        ]
        assert list(tmp_path.iterdir()) == []  # it has no name
    for seed, frame in zip(seeds, frames, strict=True):
        assert pickle.loads(pickle.dumps(frame)) == frame
        np.testing.assert_array_equal(frame.grid().density, grid_of(seed).density)
        assert (frame.cells().channels["height"] == seed % 999).all()


def test_what_is_damaged_since_it_was_written_is_told_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with StageFile(tmp_path / "map.gpkg") as stage_file:
        stage_file.append(staged(1))
        read = os.pread

        def damaged(*given: int) -> bytes:
            return read(*given).replace(b"density", b"dansity")

        monkeypatch.setattr(os, "pread", damaged)
        with pytest.raises(MapError, match="staged frame 'frame 1 ä' is damaged"):
            stage_file[0]


def test_a_frame_is_that_of_its_record() -> None:
    said, data = frame_record(staged(1))
    assert frame_of_record(json.loads(json.dumps(said)), data) == staged(1)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EACCES])
@pytest.mark.parametrize("room", [0, 100])
def test_a_full_disk_is_told_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, room: int
) -> None:
    with StageFile(tmp_path / "map.gpkg") as temporary:
        temporary.append(staged(0))
        write, left = os.pwrite, room

        def limited(file: int, data: memoryview, offset: int) -> int:
            nonlocal left
            if left == 0:
                raise OSError(error, os.strerror(error))
            taken = min(left, 7)  # a little at a time
            left -= taken
            return write(file, data[:taken], offset)

        monkeypatch.setattr(os, "pwrite", limited)
        with pytest.raises(MapWriteError) as caught:
            temporary.append(staged(1))
        monkeypatch.undo()
        # What was put before is still there; the frame that did not fit is not.
        assert list(temporary) == [staged(0)]
        assert temporary.append(staged(2)) == 1
        assert list(temporary) == [staged(0), staged(2)]
    told = str(caught.value)
    assert str(tmp_path / "map.gpkg") in told
    noisy = error in (errno.EIO, errno.EACCES)
    assert ("permissions" if noisy else "free some space") in told


def test_in_no_folder_and_once_closed_there_is_none(tmp_path: Path) -> None:
    with pytest.raises(MapWriteError, match=r"map\.gpkg \(No such file .*check the folder"):
        StageFile(tmp_path / "nowhere" / "map.gpkg")
    temporary = StageFile(tmp_path / "map.gpkg")
    temporary.close()
    temporary.close()
    with pytest.raises(ConfigError, match="are closed"):
        temporary.append(staged(1))


def make(k: int) -> StagedFrame:
    return stage(drive(8)[k][0], f"{k:06d}", drive(8)[k][1].time_ns)


def test_frames_staged_by_processes_in_any_order_give_the_same_bits(tmp_path: Path) -> None:
    frames = drive(8)
    expected = content(write_map(tmp_path / "once.gpkg", [frames]), "tiles", "digests", "frames")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        made = list(pool.map(make, range(8)))
    assert made == [make(k) for k in range(8)]
    for order in (range(8), reversed(range(8)), (3, 0, 7, 1, 6, 2, 5, 4)):
        path = tmp_path / "map.gpkg"
        with (
            StageFile(path) as stage_file,
            create_map(path, DATUM, cell_m=CELL_M, overwrite=True) as universal,
            universal.add_session("0") as session,
        ):
            for number, k in enumerate(order):
                if k % 2:  # some from a file, some as they are
                    session.add_staged(made[k], frames[k][1])
                else:
                    index = stage_file.append(made[k])
                    session.add_staged(stage_file, frames[k][1], index)
                assert number >= 0
        assert content(path, "tiles", "digests", "frames") == expected
        with open_map(path) as universal:
            assert universal.verify(deep=True).problems == ()


def test_a_channel_of_ones_own_is_kept_with_the_frame(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    height = np.arange(grid_of(1).density.size, dtype=np.int16).reshape(grid_of(1).spec.shape)
    with (
        create_map(path, DATUM, cell_m=CELL_M) as universal,
        universal.add_session("0") as session,
    ):
        grid, pose = drive(1)[0]
        session.add(grid, pose, channels={"ground_mm": height})
    with open_map(path) as universal:
        (frame,) = universal.frames(with_grid=True)
        np.testing.assert_array_equal(frame.cells().channels["ground_mm"], height)
        assert universal.verify(deep=True).problems == ()
