"""Frames of a plain folder: by a table, or by the names of the files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings.frames.frame_table import PAIRS, read_frames
from fieldgrid.recordings.frames.in_folder import InFolder

START_S = 1_700_000_000
HEADER = "frame_id,timestamp_utc_s,left,right"


def folder_with(folder: Path, rows: Sequence[str] = (), stems: Sequence[object] = (0,)) -> Path:
    """A folder of pairs with these names, and with a table of these rows if there are any."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for stem in stems:
            (folder / side / f"{stem}.png").touch()
    if rows:
        (folder / "frames.csv").write_bytes("\n".join([*rows, ""]).encode())
    return folder


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
    """It is used where its stamp says."""
    rows = [f"f{k},{START_S + s},left/{k}.png,right/{k}.png" for k, s in enumerate(stamps_s)]
    shots, notes = read_frames(folder_with(tmp_path, [HEADER, *rows], range(len(rows))))
    assert [shot.time_ns for shot in shots] == sorted(shot.time_ns for shot in shots)
    assert [f"1, the first of them {told}." in note for note in notes] == ([True] if told else [])


@pytest.mark.parametrize("mark", [";", "\t", "|"])
def test_a_table_of_a_spreadsheet(mark: str, tmp_path: Path) -> None:
    """Semicolons, a decimal comma, a byte order mark, Windows's line ends and paths."""
    row = f"0,{START_S}#25,left\\0.png,right\\0.png".replace(",", mark).replace("#", ",")
    rows = [f"\ufeff{HEADER.replace(',', mark)}\r", f"{row}\r"]
    (shot,), notes = read_frames(folder_with(tmp_path, rows))
    assert shot.time_ns == START_S * 10**9 + 250_000_000
    assert shot.files == ("left/0.png", "right/0.png")
    assert not notes


@pytest.mark.parametrize(
    ("header", "left", "match"),
    [
        ("frame_id,timestamp,left,right", "left/0.png", "no column is time_ns or .*, but frame_id"),
        ("name,timestamp_utc_s,left,right", "left/0.png", "no column frame_id; .* It has: name, t"),
        (HEADER, "", "line 2: left is empty"),
        (HEADER, "../x/0.png", "leads out of the recording"),
        (HEADER, "..\\x\\0.png", "leads out of the recording"),
        (HEADER, "/robot/drive/left/../0.png", "leads out of the recording"),
        # Although a file of the same name is in the recording: which is meant is not known.
        (HEADER, "OTHER/left/0.png", r"leads out .* \(ln -s THEIR_FOLDER left\)"),
    ],
)
def test_a_table_that_is_refused(header: str, left: str, match: str, tmp_path: Path) -> None:
    other = folder_with(tmp_path / "other")
    row = f"0,{START_S},{left.replace('OTHER', str(other))},right/0.png"
    with pytest.raises(RecordingError, match=match):
        read_frames(folder_with(tmp_path / "drive", [header, row]))


@pytest.mark.parametrize("root", ["FOLDER", "LINK", "/robot/june/drive", "C:\\june"])
def test_paths_from_the_root(root: str, tmp_path: Path) -> None:
    """Into the folder, or to where it was recorded."""
    folder, link = tmp_path / "drive", tmp_path / "link"
    link.symlink_to(folder)
    top = root.replace("FOLDER", str(folder)).replace("LINK", str(link))
    mark = "\\" if "\\" in top else "/"
    left, right = (mark.join((top, side, "0.png")) for side in ("left", "right"))
    folder_with(folder, [HEADER, f"0,{START_S},{left},{right}"])
    (shot,), notes = read_frames(link if root == "LINK" else folder)
    assert shot.files == ("left/0.png", "right/0.png")
    told = "/left, which is not here; those of the same names in the recording are"
    assert [told in note for note in notes] == ([] if root in ("FOLDER", "LINK") else [True])


@pytest.mark.parametrize("missing", [0, 1])
def test_a_missing_image_of_a_recording_that_was_moved(missing: int, tmp_path: Path) -> None:
    rows = [f"{k},{START_S + k},/robot/left/{k}.png,/robot/right/{k}.png" for k in range(2)]
    folder = folder_with(tmp_path, [HEADER, *rows], [1 - missing])
    shots, (note,) = read_frames(folder, layout=PAIRS._replace(incomplete=True))
    files = [file for shot in shots for file in shot.files]
    assert f"left/{1 - missing}.png" in files
    assert not any(file.startswith("/") for file in files)
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


@pytest.mark.parametrize(
    ("stem", "after_ns", "told"),
    [
        (f"{START_S}000000000", 0, ""),
        (f"{START_S}.250000", 250_000_000, "s since 1970"),
        (f"{START_S}250", 250_000_000, "ms since 1970"),
        (f"{START_S}250000", 250_000_000, "us since 1970"),
    ],
)
def test_times_as_names(stem: str, after_ns: int, told: str, tmp_path: Path) -> None:
    (shot,), notes = read_frames(folder_with(tmp_path, stems=[stem]))
    assert shot.time_ns == START_S * 10**9 + after_ns
    assert [told in note for note in notes] == ([True] if told else [])


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
        read_frames(folder_with(tmp_path, stems=[stem]))


def test_a_time_in_the_file_goes_before_a_guess_from_its_name(tmp_path: Path) -> None:
    def in_file(path: Path) -> int:
        if path.stem == f"{START_S}250":
            raise RecordingError("no time in the file")
        return START_S * 10**9

    layout = PAIRS._replace(time_of=in_file)
    for stem, after_ns, told in (("500", 0, ""), ("250", 250_000_000, "ms since 1970")):
        folder = folder_with(tmp_path / stem, stems=[f"{START_S}{stem}"])
        (shot,), notes = read_frames(folder, layout=layout)
        assert shot.time_ns == START_S * 10**9 + after_ns
        assert [told in note for note in notes] == ([True] if told else [])
