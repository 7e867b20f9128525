"""A journal that is damaged anywhere: no wrong step, nothing lost without a word, no wrong owner."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.live import live_folder, replay
from fieldgrid.live.journal import _RECORD, MAGIC
from fieldgrid.live.session_folder import SessionFolder
from fieldgrid.odometry import CameraStep, Refusal
from fieldgrid.recording import open_recording
from tests.live.making import begin


@pytest.fixture(scope="module")
def whole(short_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a session that has pushed a whole drive and was ended."""
    out = tmp_path_factory.mktemp("whole") / "m.gpkg"
    with pytest.MonkeyPatch.context() as patch, open_recording(short_drive) as recording:
        patch.setattr("fieldgrid.live.live.warm_up", lambda gridder, odometry: None)
        patch.setattr("fieldgrid.live.live.warm_up_poses", lambda rig, settings: None)
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    return live_folder(out)


@pytest.fixture
def out(whole: Path, tmp_path: Path) -> Path:
    """A map whose session is a copy of that."""
    shutil.copytree(whole, live_folder(tmp_path / "m.gpkg"))
    return tmp_path / "m.gpkg"


def records(journal: Path) -> Iterator[tuple[int, int, str, Any]]:
    """Where each record of a sound journal begins and ends, its kind and its value."""
    data, start = journal.read_bytes(), len(MAGIC)
    while start < len(data):
        _, length, _ = _RECORD.unpack_from(data, start)
        end = start + _RECORD.size + length
        yield start, end, *json.loads(data[start + _RECORD.size : end])
        start = end


def damage(journal: Path, starts: list[int]) -> None:
    """Change a byte in the body of the records that begin there."""
    data = bytearray(journal.read_bytes())
    for start in starts:
        data[start + _RECORD.size + 8] ^= 0x55
    journal.write_bytes(data)


def starts_of(out: Path, kind: str) -> list[int]:
    journal = live_folder(out) / "journal"
    return [start for start, _, one, _ in records(journal) if one == kind]


def test_no_step_leads_over_a_frame_that_is_lost(out: Path) -> None:
    with SessionFolder(out, None) as kept:
        before = kept.staged().found
    assert all(isinstance(one, CameraStep) for one in before[1:])
    damage(live_folder(out) / "journal", [starts_of(out, "frame")[k] for k in (2, 3)])
    with SessionFolder(out, None) as kept:
        found = kept.staged().found
    assert found == [*before[:2], Refusal.LOST, before[5]]


def test_damage_between_two_frames_costs_no_step(out: Path) -> None:
    with SessionFolder(out, None) as kept:
        before = kept.staged().found
    damage(live_folder(out) / "journal", starts_of(out, "fix")[:-20:7])
    with SessionFolder(out, None) as kept:
        assert kept.read().damaged_bytes > 0
        assert kept.staged().found == before
