"""What an end that fails or is interrupted says of the drive is true."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.core import ConfigError
from fieldgrid.live import Live, finish_from, finish_session
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.pipeline import Journal
from fieldgrid.recordings import Recording, open_recording
from tests.live.making import begin


def push_all(live: Live, recording: Recording) -> None:
    for frame in recording.frames():
        live.push_frame(frame, wait=True)
    for fix in recording.fixes():
        live.push_fix(fix)
    live.drain()


def refuse(monkeypatch: pytest.MonkeyPatch, where: str, error: BaseException) -> None:
    def refused(*_given: object, **_named: object) -> None:
        raise error

    monkeypatch.setattr(f"fieldgrid.live.finish.{where}", refused)


def test_an_end_without_any_record_on_the_disk_says_that_nothing_is_kept(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Journal, "_write", lambda _self: False)
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        push_all(live, recording)
        with pytest.raises(ConfigError, match="Nothing of the drive is kept") as caught:
            live.finish()
    assert "--finish" not in str(caught.value)


def test_an_interrupted_end_says_what_the_disk_did_not_take(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        push_all(live, recording)
        write = Journal._write
        monkeypatch.setattr(Journal, "_write", lambda _self: False)
        live.push_gyro(1, 0.0)
        refuse(monkeypatch, "NewSession", KeyboardInterrupt())
        with pytest.raises(KeyboardInterrupt) as caught:
            live.finish()
    (note,) = caught.value.__notes__
    assert f"kept in {live.folder}, but for the last 1 records, which the full disk" in note
    assert f"fieldgrid live -o {out} --finish makes the map of it" in note
    # Where the disk takes again what waits, nothing is missing.
    monkeypatch.setattr(Journal, "_write", write)
    with pytest.raises(KeyboardInterrupt) as caught:
        finish_session(out)
    assert "but for" not in caught.value.__notes__[-1]
    refuse(monkeypatch, "build_map", SystemExit(143))
    with pytest.raises(SystemExit) as ended:
        finish_from(out, short_drive)
    assert f"--finish-from {short_drive} makes the map" in ended.value.__notes__[-1]


def test_an_end_that_is_interrupted_when_the_map_is_made_says_so(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, remove = tmp_path / "m.gpkg", SessionFolder.remove

    def interrupted(kept: SessionFolder) -> None:
        remove(kept)
        raise KeyboardInterrupt

    monkeypatch.setattr(SessionFolder, "remove", interrupted)
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        push_all(live, recording)
        with pytest.raises(KeyboardInterrupt) as caught:
            live.finish()
    assert caught.value.__notes__ == [f"The drive is in the map {out}."]
    assert out.exists()
