"""Many drives: processes, those that die, builds that are ended and go on, frames that are bad."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from fieldgrid.core import ConfigError, MapWriteError, RecordingError
from fieldgrid.maps import Patience, open_map
from fieldgrid.pipeline import PartlyBuiltError, Progress, drives, read_journal, work_folder
from fieldgrid.pipeline.staging import parts
from tests.cli.conftest import in_a_process
from tests.conftest import wait_for_end
from tests.pipeline.drives import failing
from tests.pipeline.drives.making import (
    COURSE,
    SMALL_SHARES,
    MakeDrive,
    build,
    content,
    count_staged,
    damage,
    frames_left,
)


@pytest.fixture(autouse=True)
def small_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "SHARE_FRAMES", 2)


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """So few frames are staged by threads, else."""
    monkeypatch.setattr(drives, "WORTH_FRAMES", 1)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """Two drives, one with a frame that cannot be read, and the map of them, built in one process
    and in one run."""
    from tests.conftest import make_small_drive

    folder = tmp_path_factory.mktemp("two")
    paths = [
        make_small_drive(folder / "first", range(3, 9)),
        make_small_drive(folder / "second", range(40, 45)),
    ]
    damage(paths[0] / "left" / "000005.jpg")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(parts, "SHARE_FRAMES", 100)
        build(paths, folder / "whole.gpkg", jobs=1, skip_bad=1)
    return paths, folder / "whole.gpkg"


@pytest.mark.usefixtures("processes")
@pytest.mark.usefixtures("worked_out_afresh")
def test_processes_give_the_same_bits_also_when_one_is_killed(
    two: tuple[list[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths, whole = two
    monkeypatch.setattr(drives, "open_drive", failing.opening("first", 5, 1, tmp_path / "marks"))
    out, seen = tmp_path / "m.gpkg", list[Progress]()
    reports = build(paths, out, jobs=2, skip_bad=1, progress=seen.append)
    assert (tmp_path / "marks").read_text() == "x"
    assert content(out) == content(whole)
    assert [report.session for report in reports] == ["first", "second"]
    assert [bad.frame_id for bad in reports[0].bad] == ["000005"]
    last = {now.session: (now.frames_done, now.frames_total) for now in seen}
    assert last == {"first": (6, 6), "second": (5, 5)}
    assert {path.name for path in tmp_path.iterdir()} == {"m.gpkg", "marks"}


@pytest.mark.usefixtures("processes")
def test_a_recording_that_kills_processes_is_named_and_left_out(
    two: tuple[list[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths, _ = two
    monkeypatch.setattr(drives, "open_drive", failing.opening("second", 2, 9, tmp_path / "marks"))
    with pytest.raises(PartlyBuiltError) as told:
        build(paths, tmp_path / "m.gpkg", jobs=2, skip_bad=1)
    (failed,) = told.value.failed
    assert failed[0] == "second"
    assert "Frames 2 to 3 of second have ended every process that staged them" in failed[1]
    assert (tmp_path / "marks").read_text() == "xx"
    with open_map(tmp_path / "m.gpkg") as universal:
        assert [info.name for info in universal.sessions()] == ["first"]
    assert {path.name for path in tmp_path.iterdir()} == {"m.gpkg", "marks"}


@pytest.mark.usefixtures("processes")
def test_a_process_that_cannot_start_is_reported(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where Python is embedded in another program, which is not to be started again."""
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with pytest.raises((ConfigError, RecordingError), match="--jobs 1"):
        build([make_drive()], tmp_path / "m.gpkg", jobs=2)


# --- a build that is ended


ENDED = """
import os, signal
from fieldgrid.pipeline.staging.parts import DriveParts
from pathlib import Path

usual, taken = DriveParts.add, []

def add(self, number, looked):
    usual(self, number, looked)
    taken.append(number)
    if len(taken) == {frames_done}:
        tasks = Path("/proc/self/task").glob("*/children")
        Path({notes!r}).write_text(" ".join(found.read_text() for found in tasks))
        os.kill(os.getpid(), signal.{how})

DriveParts.add = add
"""
"""Python to run first in a build, which notes its workers and gets a signal when it has kept so
many frames: from outside, it may be through before one has looked."""


def ended(paths: list[Path], out: Path, frames_done: int, how: signal.Signals) -> str:
    """A build by two processes that is ended once it has staged so many frames; what it said."""
    notes = out.with_suffix(".workers")
    before = SMALL_SHARES + ENDED.format(frames_done=frames_done, notes=str(notes), how=how.name)
    child = subprocess.run(
        in_a_process("build", *paths, "-o", out, "--jobs", 2, "--skip-bad", 1, before=before),
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    errors = child.stderr
    workers = [int(word) for word in notes.read_text().split()]
    assert workers or not Path("/proc").exists()
    notes.unlink()
    for worker in workers:
        wait_for_end(worker)
    return errors


@pytest.mark.parametrize(
    ("frames_done", "how"),
    [pytest.param(8, signal.SIGKILL, marks=pytest.mark.long), (1, signal.SIGINT)],
)
@pytest.mark.usefixtures("worked_out_afresh")
def test_an_ended_build_goes_on_to_the_same_bits(
    frames_done: int,
    how: signal.Signals,
    two: tuple[list[Path], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    paths, whole = two
    out = tmp_path / "m.gpkg"
    errors = ended(paths, out, frames_done, how)
    assert not out.exists()
    if how is signal.SIGINT:
        assert f"What was staged is kept in {out}.work; the same command with --resume" in errors
        assert "Traceback" not in errors
    done = frames_left(out)
    staged = count_staged(monkeypatch)
    build(paths, out, jobs=1, skip_bad=1, resume=True)
    assert done >= frames_done
    assert sum(staged) == 11 - done
    assert content(out) == content(whole)
    assert list(tmp_path.iterdir()) == [out]


@pytest.fixture
def left(make_drive: MakeDrive, tmp_path: Path) -> tuple[Path, Path]:
    """A drive, and a map of which an interrupted build has left some frames of it."""
    drive, out = make_drive(frames=range(3, 9)), tmp_path / "out" / "m.gpkg"
    out.parent.mkdir()

    def interrupt(now: Progress) -> None:
        if now.frames_done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build([drive], out, jobs=1, progress=interrupt)
    assert frames_left(out) == 3
    return drive, out


def test_what_a_build_left_that_was_killed_before_its_first_frame_is_removed(
    left: tuple[Path, Path],
) -> None:
    drive, out = left
    (path,) = work_folder(out).iterdir()
    path.write_bytes(path.read_bytes()[:60])
    os.utime(path, (1e9, 1e9))
    build([drive], out, settings=COURSE)  # of another key
    assert list(out.parent.iterdir()) == [out]


def test_parts_that_are_there_are_told(left: tuple[Path, Path]) -> None:
    drive, out = left
    with pytest.raises(ConfigError, match=r"m\.gpkg\.work holds staged frames .*\(drive\); give"):
        build([drive], out)
    build([drive], out, resume=False)
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("change", ["settings", "image", "how images are read"])
def test_parts_of_other_inputs_or_settings_are_refused(
    change: str, left: tuple[Path, Path]
) -> None:
    drive, out = left
    before = sorted(out.parent.rglob("*"))
    if change == "image":
        image = drive / "left" / "000003.jpg"
        data = image.read_bytes()
        image.unlink()  # it is a link
        image.write_bytes(data)
    if change == "how images are read":
        (drive / "recording.toml").write_text("[images]\nbits = 8\n")
    settings = {"settings": COURSE} if change == "settings" else {}
    differs = "settings" if change == "settings" else "recording or use of --every"
    said = (
        rf"holds the session 'drive', .* differs in its {differs}\. Repeat the command that made it"
    )
    with pytest.raises(ConfigError, match=said):
        build([drive], out, resume=True, **settings)
    assert sorted(out.parent.rglob("*")) == before


@pytest.mark.parametrize("what", ["cells", "record", "end"])
def test_a_damaged_frame_is_made_again(what: str, left: tuple[Path, Path], tmp_path: Path) -> None:
    drive, out = left
    (path,) = work_folder(out).iterdir()
    frames = [record for record in read_journal(path) if record.kind == "frame"]
    data = bytearray(path.read_bytes())
    data[frames[1].blobs[0].start if what == "cells" else frames[1].start + 40] ^= 1
    path.write_bytes(data[:-5] if what == "end" else data)
    build([drive], out, resume=True)
    build([drive], tmp_path / "anew.gpkg")
    assert content(out) == content(tmp_path / "anew.gpkg")


def test_a_drive_that_was_refused_at_its_commit_is_not_staged_again(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    build([make_drive("first")], out)
    paths = [make_drive("second", range(5, 9)), make_drive("third", range(8, 10))]
    other = sqlite3.connect(out, isolation_level=None)
    waited: list[float] = []

    def stop(waited_s: float) -> None:
        waited.append(waited_s)

    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(MapWriteError, match=r"in use by another program.* --resume goes on"):
        build(paths, out, append=True, jobs=1, patience=Patience(0.01, stop))
    other.execute("ROLLBACK")
    other.close()
    assert waited
    staged = count_staged(monkeypatch)
    build(paths, out, append=True, jobs=1, resume=True)
    assert staged == [2]  # those of the third drive alone
    with open_map(out) as universal:
        assert [info.name for info in universal.sessions()] == ["first", "second", "third"]
    assert not work_folder(out).exists()


def test_a_build_that_was_ended_after_a_commit_knows_its_sessions(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    drive = make_drive(frames=range(3, 7))
    with monkeypatch.context() as patched:
        patched.setattr(drives, "drop_journal", lambda *_: None)  # it ends just before that
        build([drive], out)
    before = out.read_bytes()
    (report,) = build([drive], out, resume=True)
    assert "The drive was in the map already." in report.notes
    assert out.read_bytes() == before
    assert not work_folder(out).exists()
    with pytest.raises(ConfigError, match=r"session 'drive' already, .* that build had finished"):
        build([drive], out, resume=True)
    assert out.read_bytes() == before
    assert not work_folder(out).exists()


# --- frames that are bad


def bad(drive: Path) -> None:
    damage(drive / "left" / "000004.jpg")
    (drive / "right" / "000006.jpg").unlink()


@pytest.mark.parametrize("bound", [2, 0.4])
def test_bad_frames_are_left_out_up_to_a_bound(
    bound: float, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive, out = make_drive(frames=range(3, 8)), tmp_path / "m.gpkg"
    bad(drive)
    (report,) = build([drive], out, skip_bad=bound)
    assert (report.frames, [one.frame_id for one in report.bad]) == (3, ["000004", "000006"])
    assert "truncated" in report.bad[0].reason
    assert "No such file" in report.bad[1].reason
    assert report.as_dict()["bad"][1]["frame_id"] == "000006"
    with open_map(out) as universal:
        config = universal.sessions()[0].config
        assert [record.frame_id for record in universal.frames()] == ["000003", "000005", "000007"]
    assert config["bad_frames"] == 2
    assert [frame_id for frame_id, _ in config["bad"]] == ["000004", "000006"]


@pytest.mark.parametrize(("bound", "most"), [(1, 1), (0.39, 1)])
def test_more_bad_frames_than_the_bound_are_refused(
    bound: float, most: int, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=range(3, 8))
    bad(drive)
    said = (
        rf"2 of 5 frames of drive cannot be read, and --skip-bad allows {most}; .*First: .*000004"
    )
    with pytest.raises(RecordingError, match=said):
        build([drive], tmp_path / "m.gpkg", skip_bad=bound)
    assert list(tmp_path.iterdir()) == [drive]


def test_a_drive_without_a_frame_that_can_be_read(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(3, 5))
    shutil.rmtree(drive / "right")
    with pytest.raises(RecordingError, match="None of the 2 frames of drive can be read"):
        build([drive], tmp_path / "m.gpkg", skip_bad=1.0)
    assert list(tmp_path.iterdir()) == [drive]
