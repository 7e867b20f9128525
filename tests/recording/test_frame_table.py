"""Frames whose stamps do not fit to their place in the table are told."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.errors import RecordingError
from fieldgrid.recording.frame_table import read_frames

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
