"""Frames whose stamps do not fit to their place in the table are told."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings.frames.frame_table import PAIRS, read_frames
from fieldgrid.recordings.frames.in_folder import InFolder

START_S = 1_700_000_000


@pytest.mark.parametrize(
    ("stamps_s", "told"),
    [
        (list(range(40)), None),
        ([10.5 if k == 20 else k for k in range(40)], "f20"),
        ([3600 if k == 20 else k for k in range(40)], "f20"),
        # A table that is in no order of time says nothing.
        ([(7 * k) % 40 for k in range(40)], None),
        (list(range(40, 0, -1)), None),
        ([*range(20, 40), *range(20)], None),
        ([0, 5, 1], None),
    ],
)
def test_a_frame_between_such_of_another_time_is_told(
    stamps_s: list[float], told: str | None, tmp_path: Path
) -> None:
    rows = ["frame_id,timestamp_utc_s,left,right"]
    rows += [f"f{k},{START_S + s},l/{k}.png,r/{k}.png" for k, s in enumerate(stamps_s)]
    (tmp_path / "frames.csv").write_text("\n".join(rows) + "\n")
    for side in ("l", "r"):
        (tmp_path / side).mkdir()
        for k in range(len(stamps_s)):
            (tmp_path / side / f"{k}.png").touch()
    shots, notes = read_frames(tmp_path)
    # It is used where its stamp says.
    assert [shot.time_ns for shot in shots] == sorted(shot.time_ns for shot in shots)
    assert bool(notes) is (told is not None)
    if told is not None:
        (note,) = notes
        assert f"1, the first of them {told}." in note


def folder_with(tmp_path: Path, table: str) -> Path:
    (tmp_path / "frames.csv").write_bytes(table.encode())
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        (tmp_path / side / "0.png").touch()
    return tmp_path


@pytest.mark.parametrize("mark", [";", "\t", "|"])
def test_a_table_of_a_spreadsheet(mark: str, tmp_path: Path) -> None:
    """Semicolons, a decimal comma, a byte order mark, Windows's line ends and paths."""
    rows = ("frame_id,timestamp_utc_s,left,right", f"0,{START_S}#25,left\\0.png,right\\0.png")
    text = "\r\n".join(row.replace(",", mark).replace("#", ",") for row in rows)
    shots, notes = read_frames(folder_with(tmp_path, f"\ufeff{text}\r\n"))
    assert [shot.time_ns for shot in shots] == [START_S * 10**9 + 250_000_000]
    assert shots[0].files == ("left/0.png", "right/0.png")
    assert not notes


@pytest.mark.parametrize(
    ("header", "match"),
    [
        ("frame_id,timestamp,left,right", "line 2: no column is time_ns or .*, but frame_id, time"),
        ("name,timestamp_utc_s,left,right", "no column frame_id; .* It has: name, timestamp"),
    ],
)
def test_columns_that_are_called_otherwise(header: str, match: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=match):
        read_frames(folder_with(tmp_path, f"{header}\n0,{START_S},left/0.png,right/0.png\n"))


def test_a_windows_path_does_not_lead_out(tmp_path: Path) -> None:
    table = f"frame_id,timestamp_utc_s,left,right\n0,{START_S},..\\x\\0.png,right/0.png\n"
    with pytest.raises(RecordingError, match="leads out of the recording"):
        read_frames(folder_with(tmp_path, table))


def pair_in(folder: Path, stem: str = "0") -> Path:
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        (folder / side / f"{stem}.png").touch()
    return folder


def table_of(left: str, right: str) -> str:
    return f"frame_id,timestamp_utc_s,left,right\n0,{START_S},{left},{right}\n"


def test_paths_from_the_root_into_the_folder(tmp_path: Path) -> None:
    folder = pair_in(tmp_path / "drive")
    (tmp_path / "link").symlink_to(folder)
    for root in (folder, tmp_path / "link"):
        table = table_of(f"{root}/left/0.png", f"{root}/right/0.png")
        (folder / "frames.csv").write_text(table)
        shots, notes = read_frames(root)
        assert shots[0].files == ("left/0.png", "right/0.png")
        assert notes == ()


@pytest.mark.parametrize("root", ["/robot/june/drive", "C:\\june", "/robot/june/drive/left/.."])
def test_a_recording_that_was_moved(root: str, tmp_path: Path) -> None:
    """Its table names the files where they were recorded."""
    folder = pair_in(tmp_path / "drive")
    mark = "\\" if "\\" in root else "/"
    table = table_of(*(mark.join((root, side, "0.png")) for side in ("left", "right")))
    (folder / "frames.csv").write_text(table)
    if ".." in root:
        with pytest.raises(RecordingError, match="leads out of the recording"):
            read_frames(folder)
        return
    shots, (note,) = read_frames(folder)
    assert shots[0].files == ("left/0.png", "right/0.png")
    assert "/left, which is not here; those of the same names in the recording are" in note


@pytest.mark.parametrize("missing", [0, 1])
def test_a_missing_image_of_a_recording_that_was_moved(missing: int, tmp_path: Path) -> None:
    folder = pair_in(tmp_path / "drive", str(1 - missing))
    rows = [f"{k},{START_S + k},/robot/left/{k}.png,/robot/right/{k}.png" for k in range(2)]
    table = "\n".join(["frame_id,timestamp_utc_s,left,right", *rows, ""])
    (folder / "frames.csv").write_text(table)
    layout = PAIRS._replace(incomplete=True)
    shots, (note,) = read_frames(folder, layout=layout)
    assert f"left/{1 - missing}.png" in [file for shot in shots for file in shot.files]
    assert not any(file.startswith("/") for shot in shots for file in shot.files)
    assert "/robot/left, which is not here" in note
    with pytest.raises(RecordingError, match=rf"left/{missing}\.png"):
        read_frames(folder)


def test_a_folder_is_found_again_when_its_first_file_is_there(tmp_path: Path) -> None:
    """In a live session files come after their row."""
    in_folder = InFolder(tmp_path)
    assert in_folder("/robot/june/0.png") == "/robot/june/0.png"
    (tmp_path / "june").mkdir()
    (tmp_path / "june" / "1.png").touch()
    assert in_folder("/robot/june/1.png") == "june/1.png"


def test_files_that_lie_elsewhere_are_refused(tmp_path: Path) -> None:
    """Although files of the same names are in the recording: which are meant is not known."""
    folder, other = pair_in(tmp_path / "drive"), pair_in(tmp_path / "other")
    table = table_of(f"{other}/left/0.png", f"{other}/right/0.png")
    (folder / "frames.csv").write_text(table)
    with pytest.raises(RecordingError, match=r"leads out .* \(ln -s THEIR_FOLDER left\)"):
        read_frames(folder)


@pytest.mark.parametrize(
    ("stem", "time_ns", "told"),
    [
        (f"{START_S}000000000", START_S * 10**9, ""),
        (f"{START_S}.250000", START_S * 10**9 + 250_000_000, "s since 1970"),
        (f"{START_S}250", START_S * 10**9 + 250_000_000, "ms since 1970"),
        (f"{START_S}250000", START_S * 10**9 + 250_000_000, "us since 1970"),
    ],
)
def test_times_as_names(stem: str, time_ns: int, told: str, tmp_path: Path) -> None:
    shots, notes = read_frames(pair_in(tmp_path / "drive", stem))
    assert shots[0].time_ns == time_ns
    assert bool(notes) == bool(told)
    assert told in "".join(notes)


DATES = (
    *("20240601100", "202406011000", "2024060110000"),
    *("2024060110000001", "20240601100000123", "202406011000000001"),
)
"""With a count or milliseconds: as numbers they would be times after 2033, or none at all."""


@pytest.mark.parametrize(
    "stem", ["0", "000123", "0000000123", "20240601120000", "left_7", "17000000000", *DATES]
)
def test_names_that_are_no_times(stem: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is no UTC time in s, ms, us or ns; add frames"):
        read_frames(pair_in(tmp_path / "drive", stem))


def test_a_time_in_the_file_goes_before_a_guess_from_its_name(tmp_path: Path) -> None:
    def in_file(path: Path) -> int:
        if path.stem == f"{START_S}250":
            raise RecordingError("no time in the file")
        return START_S * 10**9

    layout = PAIRS._replace(time_of=in_file)
    shots, notes = read_frames(pair_in(tmp_path / "file", f"{START_S}500"), layout=layout)
    assert (shots[0].time_ns, notes) == (START_S * 10**9, ())
    shots, notes = read_frames(pair_in(tmp_path / "name", f"{START_S}250"), layout=layout)
    assert shots[0].time_ns == START_S * 10**9 + 250_000_000
    assert "ms since 1970" in notes[0]
