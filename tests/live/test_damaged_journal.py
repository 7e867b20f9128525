"""A damaged journal: no wrong step, nothing lost without a report, no session of another rig."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import ConfigError, MapError, MapWriteError
from fieldgrid.live import Live, discard_session, live_folder, replay
from fieldgrid.live.kept.journal import _RECORD, DAMAGED, MAGIC, Journal, read_journal
from fieldgrid.live.kept.kept_drive import KeptFrame
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.perception import CameraStep, Refusal
from fieldgrid.pipeline import StageTimes
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


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A journal of twenty records."""
    path = tmp_path / "journal"
    with Journal(path) as journal:
        for k in range(20):
            journal.append("rows", [k, "ä" * k, 0.1 * k])
    return path


def test_damage_at_the_end_is_reported_each_time(written: Path) -> None:
    sound, data = list(read_journal(written)), written.read_bytes()
    starts = [start for start, *_ in records(written)]
    ends: list[tuple[int, bytes]] = [(k, bytes(len(data) - starts[k])) for k in (0, 12, 19)]
    for place in (0, 5, 9, 14, len(data) - starts[19] - 1):  # mark, length, check, JSON
        last = bytearray(data[starts[19] :])
        last[place] ^= 0x55
        ends.append((19, bytes(last)))
    ends.append((17, bytes(len(data) - starts[17] - 40) + data[-40:]))
    ends.append((20, bytes(3000)))
    ends.append((19, data[starts[19] : -9] + bytes(7)))  # a power cut left the rest unwritten
    for k, end in ends:
        written.write_bytes(data[: starts[k] if k < 20 else len(data)] + end)
        expected = [*sound[:k], (DAMAGED, len(end))]
        for _ in range(2):
            assert list(read_journal(written)) == expected
            Journal(written).close()
        with Journal(written) as journal:
            journal.append("rows", "next")
        assert list(read_journal(written)) == [*expected, ("rows", "next")]


def test_what_a_kill_cut_off_is_no_damage(written: Path) -> None:
    sound, data = list(read_journal(written)), written.read_bytes()
    *_, (last, end, _, _) = records(written)
    for cut in range(last, end):
        for hole in (b"", bytes(100)):  # or behind some
            written.write_bytes(data[:last] + hole + data[last:cut])
            if hole and cut - last < 12:
                continue  # so little of it cannot be told from damage
            expected = [*sound[:-1], *([(DAMAGED, len(hole))] if hole else [])]
            assert list(read_journal(written)) == expected
            Journal(written).close()
            assert written.stat().st_size == last + len(hole)


def test_the_last_records_of_a_drive_are_not_lost_without_a_word(out: Path) -> None:
    journal = live_folder(out) / "journal"
    last = [start for start, *_ in records(journal)][-3:]
    size = journal.stat().st_size
    damage(journal, last)
    for _ in range(2):
        with SessionFolder(out, None) as kept:
            assert f"{size - last[0]} bytes" in kept.recording(kept.read()).notes[-1]


@pytest.mark.parametrize("length", [20, 6 * 500, 1 << 30])
def test_the_search_behind_damage_reads_little_for_marks_of_no_record(
    length: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = 0

    class Counting(io.BufferedReader):
        def read(self, size: int | None = -1, /) -> bytes:
            nonlocal read
            data = super().read(size)
            read += len(data)
            return data

    path = tmp_path / "journal"
    with Journal(path) as journal:
        journal.append("rows", 1)
    record = path.read_bytes()[len(MAGIC) :]
    mark = _RECORD.pack(b"\xf1LIV", length, 1) + b'["'
    size = path.write_bytes(MAGIC + mark * 1000 + record)
    monkeypatch.setattr(Path, "open", lambda path, _mode: Counting(io.FileIO(path)))
    monkeypatch.setattr("fieldgrid.live.kept.journal._SEARCHED_BYTES", 16)
    assert list(read_journal(path)) == [(DAMAGED, 14_000), ("rows", 1)]
    assert read < 6 * size


def test_a_full_disk_and_a_damaged_beginning_do_not_cost_the_session(
    out: Path, short_drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damage(live_folder(out) / "journal", starts_of(out, "begin"))
    monkeypatch.setattr(Journal, "_write", lambda journal: False)
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        assert live.is_resumed
        assert live.counts.frames == 6
        live.stop()


def test_a_block_without_a_frame_removes_only_what_it_began(out: Path, short_drive: Path) -> None:
    journal = live_folder(out) / "journal"
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


def test_frames_are_not_left_to_another_rig_where_the_beginning_is_damaged(
    out: Path, short_drive: Path
) -> None:
    journal = live_folder(out) / "journal"
    first, second = starts_of(out, "begin")
    with SessionFolder(out, None) as kept:
        sound = kept.read()
    damage(journal, [first])
    with open_recording(short_drive) as recording:
        other = replace(recording.rig, image_time_offset_ns=7)
        with pytest.raises(ConfigError, match="differs in its rig"):
            Live(out, other, name=recording.name)
    with SessionFolder(out, None) as kept:
        assert (kept.drive.frames, kept.drive.fixes) == (sound.frames, sound.fixes)
    # Where the damage took the other one, too, the rig cannot be compared.
    damage(journal, [second])
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        assert live.counts.frames == 6
        live.stop()


def test_the_beginning_is_written_again_from_time_to_time(out: Path) -> None:
    with SessionFolder(out, None) as kept:
        for number in range(6, 201):
            kept.add_frame(KeptFrame(number, None), f"{number:06d}", StageTimes())
    assert len(starts_of(out, "begin")) == 1 + 3


def test_whatever_is_damaged_can_be_discarded(
    out: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, data = live_folder(out), (whole / "journal").read_bytes()
    of_others = folder / "notes.txt"
    journals = [
        data.replace(b'["begin",', b'["begun",'),
        bytes(len(data)),  # a power cut left it unwritten
        b"",
        data.replace(b'["fix",[', b'["fix",{'),
    ]
    for journal in journals:
        shutil.copytree(whole, folder, dirs_exist_ok=True)
        of_others.write_text("mine")
        (folder / "journal").write_bytes(journal)
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
    journal = live_folder(out) / "journal"
    journal.write_text("what happened on the third of June")
    with pytest.raises(MapError, match="no journal"):
        discard_session(out)
    assert journal.exists()
    assert (journal.parent / "frames.grids").exists()


def test_what_cannot_be_removed_is_not_reported_as_removed(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_given: object, **_named: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.raises(MapWriteError, match="permissions"):
        discard_session(out)
