"""Cameras that are not those of the calibration."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import BuildSettings, ConfigError, FieldgridError, RecordingError, resolve
from fieldgrid.maps import open_map
from fieldgrid.pipeline import add_recording, inspect_recording
from fieldgrid.recordings import open_recording
from tests.pipeline.drives.making import (
    COURSE,
    DEFAULTS,
    MakeDrive,
    SharedData,
    build,
    edit_mounting,
    fog,
    no_image_is_read,
)


def swap_sides(drive: Path) -> None:
    left, right = drive / "left", drive / "right"
    left.rename(drive / "other")
    right.rename(left)
    (drive / "other").rename(right)


@pytest.mark.parametrize(
    ("frames", "settings"),
    [
        (range(3, 6), COURSE),
        (range(20, 36), DEFAULTS),
        pytest.param(range(3, 6), DEFAULTS, marks=pytest.mark.long),
        pytest.param(range(20, 36), COURSE, marks=pytest.mark.long),
    ],
)
def test_swapped_sides_are_refused_and_named(
    frames: range, settings: BuildSettings, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=frames)
    swap_sides(drive)
    with pytest.raises(
        RecordingError, match="only with left and right exchanged, so the two are swapped"
    ):
        build([drive], tmp_path / "m.gpkg", settings=settings)
    assert sorted(tmp_path.iterdir()) == [drive]


@pytest.mark.long
def test_swapped_sides_of_a_kitti_drive_are_refused(
    shared_data: SharedData, tmp_path: Path
) -> None:
    drive = tmp_path / "kitti_2011_09_30_drive_0020"
    shutil.copytree(shared_data(drive.name), drive)
    for left in list(drive.rglob("image_00")):
        right = left.with_name("image_01")
        left.rename(left.with_name("other"))
        right.rename(left)
        left.with_name("other").rename(right)
    with pytest.raises(RecordingError, match="the two are swapped"):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (30, "or the calibration is of other cameras"),
        (
            -40,
            r"no ground was found in the image, .*check the calibration, and the camera's height",
        ),
    ],
)
def test_a_calibration_of_other_cameras_is_refused(
    columns: int, message: str, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(5, 13))
    for image in (drive / "right").iterdir():
        pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None
        image.unlink()
        cv2.imwrite(str(image), np.roll(pixels, columns, axis=1))  # a principal point elsewhere
    with pytest.raises(FieldgridError, match=message):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


def test_pairs_that_are_not_rectified_are_refused_unless_accepted(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(5, 13))
    for image in (drive / "right").iterdir():
        pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None
        image.unlink()
        cv2.imwrite(str(image), np.roll(pixels, 4, axis=0))
    with pytest.raises(RecordingError, match=r"4\.0\d pixels lower .* --accept vertical-misalignm"):
        build([drive], tmp_path / "m.gpkg")
    settings = resolve(None, {"checks": {"accept": ["vertical-misalignment"]}})
    (report,) = build([drive], tmp_path / "m.gpkg", settings=settings)
    assert any(note.startswith("Accepted vertical-misalignment: ") for note in report.notes)
    assert any("of 7 visual odometry steps succeeded" in note for note in report.notes)


def test_a_camera_that_measures_other_metres_stops_a_build(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    """Nothing but the way tells images that are a pixel and a half aside."""
    drive = make_drive(frames=range(5, 21))
    for image in (drive / "right").iterdir():
        pixels = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
        assert pixels is not None
        image.unlink()
        aside = np.array([[1.0, 0.0, 1.5], [0.0, 1.0, 0.0]], dtype=np.float32)
        moved = cv2.warpAffine(pixels, aside, pixels.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
        cv2.imwrite(str(image), moved)
    with pytest.raises(
        RecordingError, match=r"measures 1\.0\d\d .* A baseline of .* --accept scale"
    ):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


@pytest.mark.parametrize(
    "change", [{"camera_height_above_ground_m": 3.65}, {"camera_tilt_down_deg": 26.0}]
)
def test_a_wrong_mounting_is_hinted_at(
    change: dict[str, float], make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(5, 21))
    edit_mounting(drive, change)
    (report,) = build([drive], tmp_path / "m.gpkg")
    (hint,) = (note for note in report.notes if "No ground was found" in note)
    assert re.search(
        r"in \d+ of 16 frames\. Visual odometry succeeded, so the calibration fits\. Check "
        r"the camera's height of .* m and tilt of .*° in the mounting;",
        hint,
    )


def test_a_drive_half_in_fog_is_none_of_these(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(4, 16))
    fog(drive, *(f"{k:06d}" for k in range(7, 16)))
    (report,) = build([drive], tmp_path / "m.gpkg")
    assert (report.used, report.rejected) == (3, 9)


def test_what_does_not_fit_the_map_is_refused_before_the_images(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    build([make_drive("first")], out)
    before = out.read_bytes()
    no_image_is_read(monkeypatch)
    coarse = resolve(None, {"grid": {"cell_m": 0.1}})
    with pytest.raises(ConfigError, match=r"smaller than the local cells of 0\.1 m"):
        build([make_drive("second")], out, append=True, settings=coarse)
    with (
        open_recording(make_drive("third")) as recording,
        open_map(out, writable=True) as universal,
        pytest.raises(ConfigError, match="has a session 'first' already"),
    ):
        add_recording(universal, recording, name="first")
    assert out.read_bytes() == before


def test_a_build_says_of_the_images_what_an_inspection_says(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(3, 9))
    for path in [*(drive / "left").iterdir(), *(drive / "right").iterdir()]:
        sharp = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert sharp is not None
        path.unlink()  # a link to the image of the example
        cv2.imwrite(str(path), cv2.GaussianBlur(sharp, (0, 0), 2.5))
    said = [
        f"{one.message} {one.remedy}"
        for one in inspect_recording(drive).findings
        if one.code == "images-blurred"
    ]
    assert len(said) == 1
    clean = make_drive("clean", frames=range(3, 9))
    for path, expected in ((drive, True), (clean, False)):
        (report,) = build([path], tmp_path / f"{path.name}.gpkg")
        assert any("are blurred: " in note for note in report.notes) == expected
