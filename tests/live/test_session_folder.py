"""What a session keeps is there again, whatever was cut off or damaged; a kill loses one frame."""

from __future__ import annotations

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

import numpy as np
import pytest

from fieldgrid.core import BuildSettings, ConfigError, MapError, Quality
from fieldgrid.geometry import Datum, Fix
from fieldgrid.live import Live, finish_session, live_folder, replay
from fieldgrid.live.kept.kept_drive import PushedDrive
from fieldgrid.live.kept.session_folder import MOST_PAIRS, SessionFolder
from fieldgrid.live.pose.sensor_rows import fix_from_json, fix_to_json
from fieldgrid.maps import open_map
from fieldgrid.pipeline import DriveStart, read_journal
from fieldgrid.recordings import open_recording
from tests.cli.conftest import in_a_process
from tests.live.making import begin
from tests.pipeline.drives.making import content
from tests.scenes import paper_rig

pytestmark = pytest.mark.usefixtures("worked_out_once")


def test_a_fix_comes_back_as_it_was() -> None:
    fix = Fix(1, 0.1 + 0.2, -4.7, 1e-9, Quality.RTK_FIXED, 9, None, None, 0.017)
    assert fix_from_json(json.loads(json.dumps(fix_to_json(fix)))) == fix
    # Of a version that knew no roll and pitch of fixes.
    assert fix_from_json(fix_to_json(fix)[:-3]) == fix


def staged(drive: Path, out: Path) -> Path:
    """The file of a session that has pushed a whole drive and was ended."""
    with open_recording(drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    return live_folder(out) / "live"


def test_a_file_that_is_cut_off_anywhere_loses_its_end_only(
    leaning_drive: Path, built_level: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    path = staged(leaning_drive, out)
    whole = path.read_bytes()
    frames = [f"{k:06d}" for k in range(20, 26)]
    draw = random.Random(11)
    for _ in range(12):
        path.write_bytes(whole[: draw.randrange(len(whole) // 3, len(whole) - 1000)])
        with SessionFolder(out, None) as kept:
            had = [frame.entry.frame_id for frame in kept.drive.frames]
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
    journal = staged(short_drive, out)
    journal.write_bytes(journal.read_bytes().replace(b'["begin",', b'["begun",'))
    with pytest.raises(ConfigError, match="same rig and settings"):
        finish_session(out)
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        assert live.counts.frames == 6
        assert live.counts.fixes == len(recording.fixes())
        report = live.finish()
    (note,) = (one.message for one in report.findings if one.code == "note")
    assert "journal were damaged" in note
    with open_map(out) as ours, open_map(built) as theirs:
        assert [f.pose for f in ours.frames("drive")] == [f.pose for f in theirs.frames("drive")]


def test_a_damaged_grid_costs_its_frame_alone_and_the_drive_stays(
    short_drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    path = staged(short_drive, out)
    frames = [record for record in read_journal(path) if record.kind == "frame"]
    data = bytearray(path.read_bytes())
    data[frames[3].blobs[0].start] ^= 1
    path.write_bytes(data)
    report = finish_session(out)
    assert (report.frames, report.used) == (5, 5)
    (note,) = (note for note in report.notes if "damaged" in note)
    assert note.startswith("1 frames are left out of the map, since their grids were damaged")
    assert "--finish-from RECORDING" in note
    assert path.exists()
    # No step of the camera leads over it.
    assert report.camera_refusal_reasons == {"a frame between the two was lost by damage": 1}
    with SessionFolder(out, None) as kept:
        assert [frame.number for frame in kept.drive.frames] == [0, 1, 2, 4, 5]


def test_files_of_others_beside_a_session_stay(short_drive: Path, tmp_path: Path) -> None:
    folder = live_folder(tmp_path / "m.gpkg")
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    staged(short_drive, tmp_path / "m.gpkg")
    finish_session(tmp_path / "m.gpkg")
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_an_end_that_was_killed_after_the_commit_is_not_done_twice(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    path = staged(short_drive, out)
    shutil.copy(built, out)
    (note,) = finish_session(out).notes
    assert note == "The drive was in the map already."
    assert content(out) == content(built)
    assert not path.parent.exists()


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
        reads.append(drive := read(kept))
        for part, pieces in drive.parts.items():
            count = sum(len(piece.time_ns) for piece in pieces)
            assert count == rows[part]
            assert len(pieces) <= count / 50 + 50
        return drive

    monkeypatch.setattr(SessionFolder, "read", reading)
    finish_session(out)
    assert len(reads) == 1
    assert content(out) == content(built_level)
    assert rows["inertial"] > 1000


def test_some_pairs_over_all_of_the_drive_check_the_cameras(
    short_drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        pair = next(iter(recording.frames())).images()
        for number in range(100):
            if live._kept.claim_pair(number, 600_000_000 * number):
                left = pair[0].copy()
                left[0, 0] = number
                live._kept.add_pair(number, left, pair[1])
        live.stop()
        with SessionFolder(out, None) as kept:
            drive = kept.read()
            drive.bad_ns = list(range(100))
            found = [frame.images() for frame in kept.recording(drive).frames()]
    np.testing.assert_array_equal(found[0][1], pair[1])
    numbers = sorted({int(left[0, 0]) for left, _ in found})
    assert len(numbers) <= MOST_PAIRS
    assert numbers == list(range(0, 100, numbers[1]))
    assert numbers[-1] >= 80
    assert len(drive.pairs) < 40


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
    begun = DriveStart("row", rig, settings, source="serial:/dev/ttyACM0")
    SessionFolder(out, begun).close()
    # A plug may have changed the receiver's address.
    SessionFolder(out, replace(begun, source="serial:/dev/ttyACM1")).close()
    others = {
        "rig": replace(begun, rig=replace(rig, image_time_offset_ns=7)),
        "name and settings": replace(begun, name="x", settings=BuildSettings(map={"cell_m": 0.2})),
        "log of fixes": replace(begun, source="rtk.nmea", source_sha256="07"),
        "use of --append": replace(begun, append=True),
        "version of this program": replace(begun, version="0.0.1"),
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
            had = [frame.entry.frame_id for frame in kept.drive.frames]
        # What was told may be one ahead of what is kept.
        assert len(had) >= len(set(told)) - 1
    with open_recording(leaning_drive) as recording, begin(recording, out) as live:
        replay(live, recording, rate=None)
    assert content(out) == content(built_level)
