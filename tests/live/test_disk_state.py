"""What is reported of a disk that takes nothing, and takes records again."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.live.kept.disk_state import DiskState


def test_only_changes_are_reported_and_losses_counted_once() -> None:
    state = DiskState(Path("row.live"))
    assert state.changed(taken=True, lost=0) == ""
    full = state.changed(taken=False, lost=0)
    assert "The disk of row.live takes nothing" in full
    assert state.changed(taken=False, lost=3) == ""
    again = state.changed(taken=True, lost=3)
    assert again.startswith("The disk takes what is pushed again.")
    assert " 3 records " in again
    assert state.changed(taken=False, lost=3)
    assert "records" not in state.changed(taken=True, lost=3)
    state.changed(taken=False, lost=3)
    assert " 2 records " in state.changed(taken=True, lost=5)
