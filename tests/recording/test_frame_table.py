"""Frames whose stamps do not fit to their place in the table are told."""

from __future__ import annotations

from pathlib import Path

import pytest

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
