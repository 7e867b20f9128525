"""What a session keeps is there again, whatever was cut off or damaged; a kill loses one frame."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fieldgrid.core import BuildSettings, ConfigError, MapError, Quality
from fieldgrid.geometry import Datum, Fix
from fieldgrid.live import Live, finish_session, live_folder, replay
from fieldgrid.live.kept.journal import DAMAGED, MAGIC, Journal, read_journal
from fieldgrid.live.kept.kept_drive import PushedDrive, SessionStart
from fieldgrid.live.kept.session_folder import MOST_PAIRS, SessionFolder
from fieldgrid.live.pose.sensor_rows import fix_from_json, fix_to_json
from fieldgrid.maps import StageFile, open_map
from fieldgrid.recordings import open_recording
from tests.cli.conftest import in_a_process
from tests.live.making import begin
from tests.pipeline.drives.making import content
from tests.scenes import paper_rig

pytestmark = pytest.mark.usefixtures("worked_out_once")


def test_a_journal_that_is_cut_off_has_every_record_before(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    with Journal(path) as journal:
        for k in range(20):
            assert journal.append("rows", [k, "ä" * k, 0.1 * k])
        assert journal.sync()
    records, whole = list(read_journal(path)), path.read_bytes()
    assert [value[0] for _, value in records] == list(range(20))
    for end in random.Random(3).sample(range(24, len(whole)), 40):
        path.write_bytes(whole[:end])
        found = list(read_journal(path))
        assert found == records[: len(found)]
        with Journal(path) as journal:
            assert journal.append("fix", end)
        assert list(read_journal(path)) == [*found, ("fix", end)]


class SmallDisk:
    """Takes bytes while there is room, of the last write a part."""

    def __init__(self, room: int) -> None:
        self.room, self._pwrite = room, os.pwrite

    def pwrite(self, file: int, data: bytes | bytearray, offset: int) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        part = bytes(data[: self.room])
        self.room -= len(part)
        return self._pwrite(file, part, offset)


def test_a_full_disk_loses_only_what_memory_does_not_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, disk = tmp_path / "journal", SmallDisk(1_000_000)
    with Journal(path) as journal:
        disk.room = 1_000
        monkeypatch.setattr("fieldgrid.live.kept.journal.os.pwrite", disk.pwrite)
        monkeypatch.setattr("fieldgrid.live.kept.journal.MAX_WAITING_BYTES", 20_000)
        # A minute of a receiver and a gyro.
        taken = [journal.append("rows", [k, 0.1 * k]) for k in range(6000)]
        assert not journal.sync()
        assert taken[0]
        assert not taken[-1]
        assert journal.lost > 0
        assert len(list(read_journal(path))) == sum(taken)
        disk.room = 1 << 30
        assert journal.sync()
        assert journal.append("rows", [6000, 0.0])
    kept = [value[0] for _, value in read_journal(path)]
    assert len(kept) == 6001 - journal.lost
    assert kept == [*range(len(kept) - 1), 6000]


def test_a_damaged_record_costs_itself_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    with Journal(path) as journal:
        for k in range(9):
            journal.append("rows", k)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x55
    path.write_bytes(data)
    records = list(read_journal(path))
    values = [value for kind, value in records if kind == "rows"]
    assert len(values) == 8
    (lost,) = [value for kind, value in records if kind == DAMAGED]
    assert 0 < lost < len(data) / 8
    with Journal(path) as journal:
        journal.append("rows", 9)
    rows = [value for kind, value in read_journal(path) if kind == "rows"]
    assert rows == [*values, 9]
    path.write_bytes(b"something else altogether")
    with pytest.raises(MapError, match="no journal"):
        Journal(path)


def test_records_behind_a_long_damage_are_found_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.live.kept.journal._SEARCHED_BYTES", 64)
    path = tmp_path / "journal"
    with Journal(path) as journal:
        journal.append("rows", 1)
    first = path.read_bytes()
    hole = bytes(2_000)
    path.write_bytes(first + hole + first[len(MAGIC) :])
    for _ in range(2):
        assert list(read_journal(path)) == [("rows", 1), (DAMAGED, len(hole)), ("rows", 1)]
        Journal(path).close()
    # Its own first line may be what is damaged.
    path.write_bytes(b"\0" + first[1:])
    assert list(read_journal(path)) == [(DAMAGED, len(MAGIC)), ("rows", 1)]
    Journal(path).close()
    assert path.read_bytes() == first


def test_what_a_disk_did_not_take_is_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, disk = tmp_path / "journal", SmallDisk(1 << 20)
    with Journal(path) as journal:
        disk.room = 50  # the second record is written in part
        monkeypatch.setattr("fieldgrid.live.kept.journal.os.pwrite", disk.pwrite)
        for k in range(4):
            journal.append("rows", [k] * 5)
        on_disk = list(read_journal(path))
        assert len(on_disk) == 1
        assert [*on_disk, *journal.waiting()] == [("rows", [k] * 5) for k in range(4)]
        disk.room = 1 << 20
        assert journal.sync()
        assert journal.waiting() == []
    assert list(read_journal(path)) == [("rows", [k] * 5) for k in range(4)]


def test_a_fix_comes_back_as_it_was() -> None:
    fix = Fix(1, 0.1 + 0.2, -4.7, 1e-9, Quality.RTK_FIXED, 9, None, None, 0.017)
    assert fix_from_json(json.loads(json.dumps(fix_to_json(fix)))) == fix
    # Of a version that knew no roll and pitch of fixes.
    assert fix_from_json(fix_to_json(fix)[:-3]) == fix


def staged(drive: Path, out: Path) -> Path:
    """The folder of a session that has pushed a whole drive and was ended."""
    with open_recording(drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    return live_folder(out)


def test_files_that_are_cut_off_anywhere_lose_their_end_only(
    leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    """A power cut may leave any file shorter than the others."""
    out = tmp_path / "m.gpkg"
    folder = staged(leaning_drive, out)
    names = ("journal", "frames.grids", "frames.points")
    whole = {name: (folder / name).read_bytes() for name in names}
    frames = [f"{k:06d}" for k in range(20, 26)]
    draw = random.Random(11)
    for _ in range(12):
        for name, data in whole.items():
            (folder / name).write_bytes(data[: draw.randrange(len(data) // 2, len(data) + 1)])
        with SessionFolder(out, None) as kept:
            had = [entry.frame_id for entry in kept.staged().entries]
            assert had == frames[: len(had)]
    # The last of these is gone on with, and is the map of a build.
    with open_recording(leaning_drive) as recording, begin(recording, out) as live:
        assert live.counts.frames == len(had) < len(frames)
        replay(live, recording, rate=None)
    assert content(out) == content(built_level)


def test_a_session_whose_beginning_is_damaged_goes_on(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    journal = staged(short_drive, out) / "journal"
    data = journal.read_bytes()
    journal.write_bytes(data.replace(b'["begin",', b'["begun",'))  # each of them
    with pytest.raises(ConfigError, match="same rig and settings"):
        finish_session(out)
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        assert live.counts.frames == 6
        assert live.counts.fixes == len(recording.fixes())
        report = live.finish()
    (note,) = report.notes
    assert "journal were damaged" in note
    with open_map(out) as ours, open_map(built) as theirs:
        assert [f.pose for f in ours.frames("drive")] == [f.pose for f in theirs.frames("drive")]


def test_a_damaged_grid_costs_its_frame_alone_and_the_drive_stays(
    short_drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    grids = staged(short_drive, out) / "frames.grids"
    data = bytearray(grids.read_bytes())
    data[len(data) // 2] ^= 1
    grids.write_bytes(data)
    report = finish_session(out)
    assert (report.frames, report.used) == (5, 5)
    (note,) = (note for note in report.notes if "damaged" in note)
    assert note.startswith("1 frames are left out of the map, since their grids were damaged")
    assert "--finish-from RECORDING" in note
    assert grids.read_bytes() == data
    # No step of the camera leads over it.
    assert report.camera_refusal_reasons == {"a frame between the two was lost by damage": 1}
    with SessionFolder(out, None) as kept:
        assert [frame.number for frame in kept.drive.frames] == [0, 1, 2, 4, 5]


def test_zeros_behind_the_grids_are_no_frames(short_drive: Path, tmp_path: Path) -> None:
    grids = staged(short_drive, tmp_path / "m.gpkg") / "frames.grids"
    whole = grids.read_bytes()
    grids.write_bytes(whole + bytes(100_000))
    with StageFile(grids, passes_damage=True) as file:
        assert len(file) == 6


def test_pictures_of_others_beside_a_session_stop_nothing(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    folder = live_folder(out)
    folder.mkdir()
    (folder / "IMG_0001-left.png").write_bytes(b"a picture")
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    finish_session(out)
    assert content(out) == content(built)
    assert [path.name for path in folder.iterdir()] == ["IMG_0001-left.png"]


def test_files_of_others_beside_a_session_stay(short_drive: Path, tmp_path: Path) -> None:
    folder = live_folder(tmp_path / "m.gpkg")
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "00000000-left.png.txt").write_text("mine")
    (folder / ".00000000-left.png.0a1b2c3d.partial.png").touch()  # a kill left it
    staged(short_drive, tmp_path / "m.gpkg")
    finish_session(tmp_path / "m.gpkg")
    assert sorted(path.name for path in folder.iterdir()) == ["00000000-left.png.txt", "notes.txt"]


def test_an_end_that_was_killed_after_the_commit_is_not_done_twice(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    folder = staged(short_drive, out)
    shutil.copy(built, out)
    (note,) = finish_session(out).notes
    assert note == "The drive was in the map already."
    assert content(out) == content(built)
    assert not folder.exists()


def test_rows_of_a_long_drive_are_joined_and_read_once_at_its_end(
    leaning_drive: Path, built_level: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each piece takes fifty times what is in it."""
    monkeypatch.setattr("fieldgrid.live.kept.kept_drive.PIECES", 50)
    out, reads = tmp_path / "m.gpkg", list[PushedDrive]()
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        rows = live.counts.rows
        live.stop()
    read = SessionFolder.read

    def reading(kept: SessionFolder) -> PushedDrive:
        assert not kept.drive.fixes
        assert not kept.drive.parts
        reads.append(read(kept))
        for part, pieces in reads[-1].parts.items():
            count = sum(len(piece.time_ns) for piece in pieces)
            assert count == rows[part]
            assert len(pieces) <= count / 50 + 50
        return reads[-1]

    monkeypatch.setattr(SessionFolder, "read", reading)
    finish_session(out)
    assert len(reads) == 1
    assert content(out) == content(built_level)
    assert rows["inertial"] > 1000


def test_some_pairs_over_all_of_the_drive_are_kept(short_drive: Path, tmp_path: Path) -> None:
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        pair = next(iter(recording.frames())).images()
        kept = live._kept
        for number in range(100):
            if kept.claim_pair(number, 600_000_000 * number):
                kept.add_pair(number, *pair)
        numbers = sorted(int(path.name[:8]) for path in live.folder.glob("*-left.png"))
        live.stop()
    assert len(numbers) <= MOST_PAIRS
    assert numbers == list(range(0, 100, numbers[1]))
    assert numbers[-1] >= 80


def test_a_pair_that_is_kept_takes_little_time(short_drive: Path, tmp_path: Path) -> None:
    """OpenCV's own setting is two to three times as fast as any that it is given, and loses nothing
    either."""
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        pair = next(iter(recording.frames())).images()
        live._kept.add_pair(0, *pair)
        for side, image in zip(("left", "right"), pair, strict=True):
            data = (live.folder / f"00000000-{side}.png").read_bytes()
            assert data == cv2.imencode(".png", image)[1].tobytes()
            kept = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(kept, image)
        live.stop()


def test_of_frames_that_follow_fast_few_pairs_are_kept(short_drive: Path, tmp_path: Path) -> None:
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        claimed = [k for k in range(30) if live._kept.claim_pair(k, 10**18 + 100_000_000 * k)]
        live.stop()
    assert claimed == [0, 5, 10, 15, 20, 25]


def test_no_frame_waits_for_the_pair_of_another(
    short_drive: Path, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk may take long for a pair; the other thread goes on meanwhile."""
    free, begun, add = threading.Event(), threading.Event(), SessionFolder.add_pair

    def slow(kept: SessionFolder, number: int, left: Any, right: Any) -> None:
        if number == 0:
            begun.set()
            assert free.wait(60)
        add(kept, number, left, right)

    monkeypatch.setattr(SessionFolder, "add_pair", slow)
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording, begin(recording, out) as live:
        replay(live, recording, rate=None)
        assert begun.wait(60)
        assert live.counts.frames == 6
        free.set()
    assert content(out) == content(built)


def test_what_keeps_a_session_from_going_on_is_named(tmp_path: Path) -> None:
    out, rig, settings = tmp_path / "m.gpkg", paper_rig(), BuildSettings()
    begun = SessionStart("row", rig, settings, source="serial:/dev/ttyACM0")
    SessionFolder(out, begun).close()
    # A plug may have changed the receiver's address.
    SessionFolder(out, replace(begun, source="serial:/dev/ttyACM1")).close()
    others = {
        "rig": replace(begun, rig=replace(rig, image_time_offset_ns=7)),
        "name and settings": replace(begun, name="x", settings=BuildSettings(map={"cell_m": 0.2})),
        "log of fixes": replace(begun, source="rtk.nmea", source_sha256="07"),
        "use of --append": replace(begun, append=True),
        "datum": replace(begun, datum=Datum(41.0, 2.0, 0.0), datum_hint=Datum(41.0, 2.0, 0.0)),
    }
    for words, other in others.items():
        with pytest.raises(ConfigError, match=rf"'row'.* differs in its {words}\. Finish it with"):
            SessionFolder(out, other)


def test_one_program_at_a_time_has_a_session(short_drive: Path, tmp_path: Path) -> None:
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        with pytest.raises(MapError, match="Another program"):
            Live(tmp_path / "m.gpkg", recording.rig, name=recording.name)
        live.stop()


def killed_after(lines: int, drive: Path, out: Path) -> list[str]:
    """Replay in a process that is killed when it has told so much; the frames of which it told."""
    arguments = ("live", "-o", out, "--replay", drive, "--rate", "max", "--json")
    told: list[str] = []
    with subprocess.Popen(in_a_process(*arguments), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for count, line in enumerate(process.stdout):
            if line.startswith('{"grid"'):
                told.append(json.loads(line)["grid"])
            if told and count >= lines:
                os.kill(process.pid, signal.SIGKILL)
    return told


def test_a_kill_loses_the_last_frame_at_most_and_the_session_goes_on(
    leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    out, draw = tmp_path / "m.gpkg", random.Random(5)
    told: list[str] = []
    for _ in range(2):
        told += killed_after(draw.randrange(2, 6), leaning_drive, out)
        with SessionFolder(out, None) as kept:
            had = [entry.frame_id for entry in kept.staged().entries]
        # What was told may be one ahead of what is kept.
        assert len(had) >= len(set(told)) - 1
    with open_recording(leaning_drive) as recording, begin(recording, out) as live:
        replay(live, recording, rate=None)
    assert content(out) == content(built_level)
