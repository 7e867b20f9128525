"""Folders in which images appear, half written, late, or under names that are no times."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import CalibrationError, RecordingError
from fieldgrid.live import ImageFolder
from fieldgrid.recordings import DriveOptions, StereoFrame, open_growing
from tests.conftest import TWO_LANES
from tests.live.sources import append, drop, empty_copy, rows_of, running

ROWS = rows_of(TWO_LANES)
FIRST_NS = 1_308_133_815_469_000_000


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return empty_copy(TWO_LANES, tmp_path / "june")


def test_frames_are_taken_as_they_are_whole_and_in_order(folder: Path) -> None:
    drop(TWO_LANES, folder, ROWS[0])  # from before the session
    with running(ImageFolder(open_growing(folder))) as notes:
        notes.wait_told("is watched for frames; the 1 that lie there already are left out.")
        append(folder, ROWS[1][:20])  # a row that is not whole
        for name in ("left/000001.jpg", "right/000001.jpg"):
            shutil.copy(TWO_LANES / name, folder / name)
        half = (TWO_LANES / "right" / "000002.jpg").read_bytes()
        shutil.copy(TWO_LANES / "left" / "000002.jpg", folder / "left")
        (folder / "right" / "000002.jpg").write_bytes(half[: len(half) // 2])
        append(folder, ROWS[1][20:] + ROWS[2])
        drop(TWO_LANES, folder, ROWS[3])
        notes.wait(lambda: bool(notes.frames))
        append(folder, "000004,now,,left/000004.jpg,right/000004.jpg\n" + ROWS[5])
        notes.wait_told("has a frame that is left out: ")  # so it has looked again
        assert [frame.frame_id for frame in notes.frames] == ["000001"]
        with (folder / "right" / "000002.jpg").open("ab") as image:
            image.write(half[len(half) // 2 :])
        notes.wait(lambda: len(notes.frames) == 3)
    assert [frame.frame_id for frame in notes.frames] == ["000001", "000002", "000003"]
    assert notes.frames[0].time_ns == FIRST_NS + 1_630_000_000
    left, _ = notes.frames[1].images()
    np.testing.assert_array_equal(
        left, cv2.imread(str(TWO_LANES / "left" / "000002.jpg"), cv2.IMREAD_GRAYSCALE)
    )
    assert f"{folder / 'frames.csv'}, line 6: timestamp_utc_s 'now' is no UTC time" in notes.told[1]


def test_an_image_that_is_never_whole_is_given_up(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.live.sources.images.GIVEN_UP_S", 0.1)
    with running(ImageFolder(open_growing(folder))) as notes:
        notes.wait_told("is watched for frames.")
        append(folder, ROWS[0])  # and no file
        drop(TWO_LANES, folder, ROWS[1])
        notes.wait(lambda: len(notes.frames) == 2)
    assert [frame.frame_id for frame in notes.frames] == ["000000", "000001"]
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        notes.frames[0].images()


def test_names_are_times_where_there_is_no_table(folder: Path) -> None:
    (folder / "frames.csv").unlink()
    with running(ImageFolder(open_growing(folder))) as notes:
        notes.wait_told("is watched for frames.")
        for number, name in ((0, FIRST_NS), (1, FIRST_NS + 1), (2, "two")):
            for side in ("left", "right"):
                source = TWO_LANES / side / f"{number:06d}.jpg"
                shutil.copy(source, folder / side / f"{name}.jpg")
        notes.wait(lambda: len(notes.frames) == 2)
        notes.wait_told("the image name two.jpg is no UTC time in s, ms, us or ns")
    assert [frame.time_ns for frame in notes.frames] == [FIRST_NS, FIRST_NS + 1]


def test_of_deep_images_the_first_tells_the_bits(folder: Path) -> None:
    with running(ImageFolder(open_growing(folder))) as notes:
        notes.wait_told("is watched")
        image = np.full((480, 640), 4000, dtype=np.uint16)
        for side in ("left", "right"):
            cv2.imwrite(str(folder / side / "a.png"), image)
        append(folder, "a,1308133815.469,,left/a.png,right/a.png\n")
        notes.wait(lambda: bool(notes.frames))
    assert "the lower 12 are taken as filled" in notes.told[1]
    assert notes.frames[0].images()[0].max() == 4000 >> 4


def test_a_folder_that_goes_and_comes_back(folder: Path) -> None:
    away = folder.with_name("away")
    with running(ImageFolder(open_growing(folder))) as notes:
        notes.wait_told("is watched")
        drop(TWO_LANES, folder, ROWS[0])
        notes.wait(lambda: len(notes.frames) == 1)
        os.rename(folder, away)
        notes.wait_told("is not there (No such file or directory)")
        os.rename(away, folder)
        notes.wait_told("is there again")
        drop(TWO_LANES, folder, ROWS[1])
        notes.wait(lambda: len(notes.frames) == 2)
        (folder / "frames.csv").write_text("frame_id\n")
        notes.wait_told("has become shorter than what was read of it")


def test_what_is_whole_at_the_end_is_taken(folder: Path) -> None:
    watched = open_growing(folder)
    source = ImageFolder(watched)
    source.begin()
    with running(source) as notes:
        pass
    drop(TWO_LANES, folder, ROWS[0])
    append(folder, ROWS[1])
    source.finish(notes)  # type: ignore[arg-type]
    assert [frame.frame_id for frame in notes.frames] == ["000000"]


def test_depths_whose_files_tell_no_end(folder: Path) -> None:
    (folder / "frames.csv").unlink()
    for side in ("left", "right"):
        (folder / side).rmdir()
    (folder / "depth").mkdir()
    with running(ImageFolder(open_growing(folder))) as notes:
        notes.wait_told("is watched")
        np.save(folder / "depth" / f"{FIRST_NS}.npy", np.ones((480, 640), dtype=np.float32))
        notes.wait(lambda: bool(notes.frames))
    assert not isinstance(notes.frames[0], StereoFrame)


def test_what_is_no_folder_of_a_drive(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere does not exist; give the folder"):
        open_growing(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match="is no folder"):
        open_growing(folder / "session.json")
    offset = DriveOptions(image_time_offset_ns=5)
    assert open_growing(folder, offset).rig.image_time_offset_ns == 5
    (folder / "calibration" / "mounting.json").unlink()
    with pytest.raises(CalibrationError, match="does not say how its sensor is mounted"):
        open_growing(folder)
    clouds = tmp_path / "clouds_only"
    shutil.copytree(TWO_LANES / "calibration", clouds / "calibration")
    (clouds / "clouds").mkdir()
    with pytest.raises(CalibrationError, match="points_per_sr"):
        open_growing(clouds)
