"""A damaged journal: no wrong step, nothing lost without a report, no session of another rig."""

from __future__ import annotations

import errno
import os
import shutil
import zlib
from pathlib import Path

import pytest

from fieldgrid.core import ConfigError, MapError, MapWriteError
from fieldgrid.live import discard_session, finish_session, live_folder, replay
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.perception import CameraStep, Refusal
from fieldgrid.pipeline import Journal, read_journal
from fieldgrid.pipeline.staging.journal import _HEAD, _MARK, MAGIC
from fieldgrid.recordings import open_recording
from tests.live.making import begin


@pytest.fixture(scope="module")
def whole(short_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a session that has pushed a whole drive and was ended."""
    out = tmp_path_factory.mktemp("whole") / "m.gpkg"
    with pytest.MonkeyPatch.context() as patch, open_recording(short_drive) as recording:
        patch.setattr("fieldgrid.live.session.warm_up", lambda gridder, odometry: None)
        patch.setattr("fieldgrid.live.session.warm_up_poses", lambda rig, settings: None)
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    return live_folder(out)


@pytest.fixture
def out(whole: Path, tmp_path: Path) -> Path:
    """A map whose session is a copy of that."""
    shutil.copytree(whole, live_folder(tmp_path / "m.gpkg"))
    return tmp_path / "m.gpkg"


def damage(journal: Path, starts: list[int]) -> None:
    """Change a byte in the body of the records that begin there."""
    data = bytearray(journal.read_bytes())
    for start in starts:
        data[start + 24] ^= 0x55
    journal.write_bytes(data)


def starts_of(out: Path, kind: str) -> list[int]:
    records = read_journal(live_folder(out) / "live")
    return [record.start for record in records if record.kind == kind]


def test_no_step_leads_over_a_frame_that_is_lost(out: Path) -> None:
    with SessionFolder(out, None) as kept:
        before = [one.found for one in kept.drive.frames]
    assert all(isinstance(one, CameraStep) for one in before[1:])
    damage(live_folder(out) / "live", [starts_of(out, "frame")[k] for k in (2, 3)])
    with SessionFolder(out, None) as kept:
        found = [one.found for one in kept.drive.frames]
    assert found == [*before[:2], Refusal.LOST, before[5]]


def test_damage_between_two_frames_costs_no_step(out: Path) -> None:
    with SessionFolder(out, None) as kept:
        before = [one.found for one in kept.drive.frames]
    damage(live_folder(out) / "live", starts_of(out, "fix")[:-20:7])
    with SessionFolder(out, None) as kept:
        assert kept.read().damaged_bytes > 0
        assert [one.found for one in kept.drive.frames] == before


def test_the_last_records_of_a_drive_are_not_lost_without_a_word(out: Path) -> None:
    journal = live_folder(out) / "live"
    last = [record.start for record in read_journal(journal)][-3:]
    size = journal.stat().st_size
    damage(journal, last)
    for _ in range(2):
        with SessionFolder(out, None) as kept:
            assert f"{size - last[0]} bytes" in kept.recording(kept.read()).notes[-1]


def test_a_full_disk_and_a_damaged_beginning_do_not_cost_the_session(
    out: Path, short_drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damage(live_folder(out) / "live", starts_of(out, "begin"))
    monkeypatch.setattr(Journal, "_write", lambda journal: False)
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        assert live.is_resumed
        assert live.counts.frames == 6
        live.stop()


def test_a_block_without_a_frame_removes_only_what_it_began(out: Path, short_drive: Path) -> None:
    journal = live_folder(out) / "live"
    damage(journal, starts_of(out, "frame"))
    data = journal.read_bytes()
    with open_recording(short_drive) as recording:
        with begin(recording, out) as live:
            assert live.counts.frames == 0
        assert journal.read_bytes() == data
        journal.write_bytes(bytes(len(data)))  # after a power cut
        with begin(recording, out):
            pass
        assert journal.stat().st_size > len(data)
        with begin(recording, out.with_name("n.gpkg")):
            pass
        assert not live_folder(out.with_name("n.gpkg")).exists()


def with_other_settings(journal: bytes) -> bytes:
    """The journal as of a version that has a setting which this one does not have."""
    start = len(MAGIC)
    _, length, blobs, _ = _HEAD.unpack(journal[start : start + _HEAD.size])
    body = journal[start + _HEAD.size :][:length].replace(b'"checks"', b'"cheeks"')
    head = _HEAD.pack(_MARK, length, blobs, zlib.crc32(body, blobs))
    return MAGIC + head + body + journal[start + _HEAD.size + length :]


def test_a_session_of_other_settings_is_refused_in_a_sentence(out: Path) -> None:
    journal = live_folder(out) / "live"
    journal.write_bytes(with_other_settings(journal.read_bytes()))
    with pytest.raises(MapError, match="of another version of this program or damaged"):
        finish_session(out)


def test_whatever_is_damaged_can_be_discarded(
    out: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, data = live_folder(out), (whole / "live").read_bytes()
    of_others = folder / "notes.txt"
    journals = [
        data.replace(b'["begin",', b'["begun",'),
        bytes(len(data)),  # a power cut left it unwritten
        b"",
        data.replace(b'["fix",[', b'["fix",{'),
        with_other_settings(data),
    ]
    for journal in journals:
        shutil.copytree(whole, folder, dirs_exist_ok=True)
        of_others.write_text("mine")
        (folder / "live").write_bytes(journal)
        assert discard_session(out)[0] in ("", "drive")
        assert [path.name for path in folder.iterdir()] == ["notes.txt"]
    # A full disk may take not even what is there already.
    shutil.copytree(whole, folder, dirs_exist_ok=True)

    def full(*_given: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    assert discard_session(out) == ("drive", 6)
    with pytest.raises(ConfigError, match="no live session"):
        discard_session(out)


def test_files_of_others_and_sessions_that_go_on_are_not_discarded(
    out: Path, short_drive: Path
) -> None:
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        with pytest.raises(MapError, match="Another program"):
            discard_session(out)
        live.stop()
    journal = live_folder(out) / "live"
    journal.write_text("what happened on the third of June")
    with pytest.raises(MapError, match="no journal"):
        discard_session(out)
    assert journal.exists()


def test_what_cannot_be_removed_is_not_reported_as_removed(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_given: object, **_named: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.raises(MapWriteError, match="permissions"):
        discard_session(out)
