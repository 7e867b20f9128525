"""Text made to do harm: little that unfolds to much, depth, long words. Each gets one sentence."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from fieldgrid.core import CalibrationError, RecordingError
from fieldgrid.recordings import open_drive
from fieldgrid.recordings.calibration.yaml_text import load_yaml
from fieldgrid.recordings.readers.settings_file import read_settings
from fieldgrid.recordings.ros.folder import find_files

BOMB = "a: &a [x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB + "image_width: *i\n", "line 1 has an anchor or alias"),
        ("image_width: 64\nimage_height: *h\n", "line 2 has an anchor or alias"),
        ("a:\n  <<: {image_width: 64}\n", "line 2 has a merge key"),
        ("a: " + "[" * 60, "line 1 is nested too deeply"),
        ("a:\n" + "".join(f"{' ' * k}-\n" for k in range(1, 60)), "nested too deeply"),
        ("image_width: " + "1:" * 5000 + "1", "a value in line 1 has more than 1000"),
        ("image_width: " + "9" * 30_000, "a value in line 1 has more than 1000"),
        ("a: [" + "1, " * 30_000 + "]", "more than the 65536 that such a file can need"),
    ],
    ids=["bomb", "alias", "merge", "flow", "block", "base60", "digits", "long"],
)
def test_a_calibration_that_unfolds(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "stereo_opencv.yaml"
    path.write_text(text)
    tracemalloc.start()
    try:
        with pytest.raises(CalibrationError, match=message) as refused:
            load_yaml(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
    assert len(str(refused.value)) < len(str(path)) + 200


def test_the_list_of_a_bag_that_unfolds_is_not_used(tmp_path: Path) -> None:
    names = [tmp_path / f"drive_{k}.mcap" for k in (2, 10)]
    for name in names:
        name.touch()
    listed = "  relative_file_paths:\n    - &a drive_10.mcap\n    - *a\n"
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n{listed}")
    assert find_files(tmp_path).paths == names


@pytest.mark.parametrize(
    "text",
    ["x" * 900_000, "a = " + "x" * 900_000, '\\"""\n' * 200_000, "a = " + "9" * 900_000],
    ids=["word", "value", "quotes", "digits"],
)
def test_settings_of_one_long_word(text: str, tmp_path: Path) -> None:
    path = tmp_path / "recording.toml"
    path.write_text(text)
    with pytest.raises(RecordingError, match="is not TOML") as refused:
        read_settings(path)
    assert len(str(refused.value)) < len(str(path)) + 200


@pytest.mark.parametrize(
    ("place", "cell"),
    [
        (1, "4" * 100_000 + "N"),
        (1, "41 39 " * 5000 + "N"),
        (2, "7" + "°" * 100_000),
        (3, "1" + " " * 300_000 + "x"),
        (3, "1" * 300_000 + " ft"),
    ],
)
def test_a_cell_that_is_no_number(place: int, cell: str, tmp_path: Path) -> None:
    cells = ["2024-05-01T10:00:00Z", "45.0", "7.0", "100", "4"]
    cells[place] = cell
    path = tmp_path / "log.csv"
    path.write_text("time_utc,lat,lon,alt,quality\n" + ",".join(cells) + "\n")
    with pytest.raises(
        RecordingError, match=r"line 2: (lat|lon|alt) .* is not a number"
    ) as refused:
        open_drive(path).fixes()
    assert len(str(refused.value)) < len(str(path)) + 200


def test_a_column_of_a_long_name_is_none(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("lat,lon," + "gnss_" * 20_000 + "\n45,7,1\n")
    with pytest.raises(RecordingError, match="no column with UTC times") as refused:
        open_drive(path).fixes()
    assert len(str(refused.value)) < 1500
