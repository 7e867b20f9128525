"""Tables of gears that a user knows."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.core import GearName, GearSpan, RecordingError
from fieldgrid.recordings import read_gear_spans

NOON = 1_780_488_000_000_000_000  # 2026-06-03T12:00:00Z


@pytest.mark.parametrize(
    "rows",
    [
        ("2026-06-03T12:00:00Z,2026-06-03T12:00:10.5Z,reverse",),
        ("1780488000,1780488010.5,Reverse",),
        (f"{NOON},{NOON + 10_500_000_000}, reverse",),
    ],
)
def test_spans_with_times_of_any_kind(rows: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "gears.csv"
    path.write_text("\n".join(("from,to,gear", *rows, "")))
    (span,) = read_gear_spans(path)
    assert span == GearSpan(start_ns=NOON, stop_ns=NOON + 10_500_000_000, gear=GearName.REVERSE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,gear\n1,forward\n", r"has the columns time, gear; .*from, to, gear"),
        ("from,to,gear\n1780488000,1780488001,back\n", r"'back' is neither forward nor reverse"),
        ("from,to,gear\n1780488001,1780488000,forward\n", r"does not come after the start"),
        ("from,to,gear\nsoon,1780488000,forward\n", r"'soon' is no UTC time"),
        ("from,to,gear\n1780488000,,forward\n", r"is no UTC time"),
        ("", r"is empty"),
    ],
)
def test_what_is_no_span_is_told(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "gears.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message):
        read_gear_spans(path)
