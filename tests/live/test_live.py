"""A live session gives the map of a build, whatever its sensors, its disk and its clients do."""

from __future__ import annotations

import errno
import re
import shutil
import threading
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import (
    BuildSettings,
    ConfigError,
    GnssError,
    MapExistsError,
    MapWriteError,
    RecordingError,
)
from fieldgrid.geometry import Rig
from fieldgrid.live import (
    Live,
    LiveGrid,
    LiveOptions,
    LivePose,
    LiveResult,
    LiveWindow,
    discard_session,
    finish_session,
    live_folder,
    perceiver,
    replay,
)
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.live.perceiver import PerceivedFrame
from fieldgrid.live.pose.poser import Poser
from fieldgrid.maps import StagedFrame, open_map
from fieldgrid.perception import CameraStep
from fieldgrid.pipeline import Journal, Perception, build_map, encoded, perceive_frame, read_journal
from fieldgrid.pipeline.staging import shares
from fieldgrid.recordings import Frame, Recording, open_recording
from tests.conftest import make_small_drive
from tests.live.making import Told, begin, drive_live
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")


def some_frames(drive: Path, folder: Path, frames: Iterable[int]) -> Path:
    """A drive of some of the frames, with the same log."""
    made = make_small_drive(folder, frames)
    shutil.copy(drive / "gnss" / "gnss_rtk.nmea", made / "gnss")
    return made


def push_fixes(live: Live, recording: Recording) -> None:
    for fix in recording.fixes():
        live.push_fix(fix)


def test_the_map_is_that_of_a_build(short_drive: Path, built: Path, tmp_path: Path) -> None:
    out, told = tmp_path / "m.gpkg", Told()
    drive_live(short_drive, out, told)
    assert content(out) == content(built)
    with open_map(out) as universal:
        assert universal.verify(deep=True).sound
    assert [path.name for path in tmp_path.iterdir()] == ["m.gpkg"]
    frames = [f"{k:06d}" for k in range(20, 26)]
    assert [grid.frame_id for grid in told.of(LiveGrid)] == frames
    settled = {one.frame_id: one.pose for one in told.of(LivePose) if one.is_settled}
    assert sorted(settled) == frames
    # At the end of the log the vehicle is elsewhere, and the window with it.
    window = max(told.of(LiveWindow), key=lambda one: one.view.observed.sum())
    assert window.view.observed.sum() > 10_000
    seen = window.view.observed
    assert np.isfinite(window.age_s[seen]).all()
    assert np.isnan(window.age_s[~seen]).all()
    assert window.costmap.costs.shape == seen.shape


def test_pushed_arrays_and_bytes_make_a_map(short_drive: Path, tmp_path: Path) -> None:
    out, log = tmp_path / "m.gpkg", (short_drive / "gnss" / "gnss_rtk.nmea").read_bytes()
    with open_recording(short_drive) as recording:
        fixes = len(recording.fixes())
        with Live(out, recording.rig, name="pushed") as live:
            made = sum(live.push_nmea(log[k : k + 777]) for k in range(0, len(log), 777))
            for frame in recording.frames():
                assert live.push_pair(*frame.images(), frame.time_ns, wait=True)
            assert made + 1 == fixes  # the last one is whole at the end
    with open_map(out) as universal:
        (session,) = universal.sessions()
        assert (session.frames, session.accepted) == (6, 6)
        assert len(universal.session_inputs("pushed")["fix.time_ns"]) == fixes
        assert next(frame.frame_id for frame in universal.frames("pushed")) == "000001"


def test_fixes_may_come_late_twice_and_in_any_order(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        fixes = list(recording.fixes())
        rng = np.random.default_rng(7)
        order = np.argsort(np.arange(len(fixes)) + rng.uniform(0.0, 8.0, len(fixes)))
        with begin(recording, out) as live:
            for k in order.tolist():
                live.push_fix(fixes[k])
                if k % 9 == 0:
                    live.push_fix(fixes[k])
            for frame in recording.frames():
                live.push_frame(frame, wait=True)
    with open_map(out) as ours, open_map(built) as theirs:
        assert [f.pose for f in ours.frames("drive")] == [f.pose for f in theirs.frames("drive")]
        np.testing.assert_array_equal(ours.read().density, theirs.read().density)


def test_a_receiver_whose_clock_jumps_costs_no_frame(short_drive: Path, tmp_path: Path) -> None:
    told = Told()
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg", on_result=told)
        for k, fix in enumerate(recording.fixes()):
            ahead_s = 300 if 40 <= k < 45 else 0
            live.push_fix(fix._replace(time_ns=fix.time_ns + ahead_s * 10**9))
        for frame in recording.frames():
            live.push_frame(frame, wait=True)
        live.drain()
        assert live.finish().used == 6
    assert len([text for text in told.texts("fix refused") if "ahead of all else" in text]) == 5


def test_images_that_come_late_or_twice_are_left_out_and_told(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out, told = tmp_path / "m.gpkg", Told()
    with open_recording(short_drive) as recording:
        frames = list(recording.frames())
        with begin(recording, out, on_result=told) as live:
            push_fixes(live, recording)
            pushed = [frames[0], *frames, frames[2], frames[5]]
            taken = [live.push_frame(frame, wait=True) for frame in pushed]
            assert taken == [True, False, *[True] * 5, False, False]
            assert live.counts.late == 3
    assert len(told.texts("frame late")) == 3
    assert content(out) == content(built)


def test_of_frames_that_wait_the_oldest_is_dropped(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free, begun, told = threading.Event(), threading.Semaphore(0), Told()

    def slow(*arguments: Any, **options: Any) -> Any:
        begun.release()
        assert free.wait(60)
        return perceive_frame(*arguments, **options)

    monkeypatch.setattr(shares, "perceive_frame", slow)
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        frames = list(recording.frames())
        live = begin(recording, out, on_result=told)
        for frame in frames[: perceiver.WORKERS]:
            live.push_frame(frame)
            assert begun.acquire(timeout=60)
        for frame in frames[perceiver.WORKERS :]:
            live.push_frame(frame)  # returns at once
        assert live.counts.dropped == 2
        free.set()
        live.stop()
    kept = ["000020", "000021", "000024", "000025"]
    assert [grid.frame_id for grid in told.of(LiveGrid)] == kept
    drops = told.texts("frame dropped")
    assert ["000022" in text for text in drops] == [True, False]
    assert ["--row-step 2" in text for text in drops] == [True, False]


def test_frames_that_are_perceived_beside_each_other_are_kept_in_order(
    short_drive: Path, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The grid of the second is made before that of the first."""
    later, told = threading.Event(), Told()

    def uneven(frame: Frame, *arguments: Any, **options: Any) -> Any:
        if frame.frame_id == "000020":
            assert later.wait(60)
        tell = options.pop("gridded")

        def gridded(*made: Any) -> None:
            if frame.frame_id == "000021":
                later.set()
            tell(*made)

        return perceive_frame(frame, *arguments, gridded=gridded, **options)

    monkeypatch.setattr(shares, "perceive_frame", uneven)
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording, begin(recording, out, on_result=told) as live:
        replay(live, recording, rate=None)
    assert [grid.frame_id for grid in told.of(LiveGrid)] == [f"{k:06d}" for k in range(20, 26)]
    assert content(out) == content(built)


def passed_on(monkeypatch: pytest.MonkeyPatch) -> dict[str, PerceivedFrame]:
    """The frames that go on to poses and the window from now on, by name."""
    passed: dict[str, PerceivedFrame] = {}
    put = Poser.put

    def putting(self: Poser, said: Any) -> None:
        if isinstance(said, PerceivedFrame):
            passed[said.frame_id] = said
        put(self, said)

    monkeypatch.setattr(Poser, "put", putting)
    return passed


def test_no_window_waits_until_a_frame_is_encoded(
    short_drive: Path, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    passed, before = passed_on(monkeypatch), list[bool]()

    def encoding(seen: Perception, rig: Rig) -> StagedFrame:
        before.append(seen.frame.frame_id in passed)
        return encoded(seen, rig)

    monkeypatch.setattr(perceiver, "encoded", encoding)
    drive_live(short_drive, tmp_path / "m.gpkg")
    assert before == [True] * 6
    assert content(tmp_path / "m.gpkg") == content(built)


def test_the_camera_is_followed_over_a_frame_that_a_full_disk_refused(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pose goes on from frame to frame; the map has the step between those that it has."""
    passed, append, out = passed_on(monkeypatch), Journal.append, tmp_path / "m.gpkg"
    drive_live(short_drive, tmp_path / "whole.gpkg")
    whole = {name: frame.step for name, frame in passed.items()}

    def appending(self: Journal, kind: str, value: Any, *blobs: bytes) -> bool:
        is_full = kind == "frame" and value[1][0] == "000022"
        return not is_full and append(self, kind, value, *blobs)

    monkeypatch.setattr(Journal, "append", appending)
    passed.clear()
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    assert {name: frame.step for name, frame in passed.items()} == whole
    with SessionFolder(out, None) as kept:
        found = [one.found for one in kept.drive.frames]
    assert isinstance(whole["000023"], CameraStep)
    assert found[1] == whole["000021"]
    assert found[2] != whole["000023"]  # over 3 m the images have too little in common
    assert found[3] == whole["000024"]


@pytest.mark.parametrize("kind", ["raises", "blocks"])
def test_a_client_that_fails_changes_nothing(
    kind: str, short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.live.results.CLIENT_S", 0.1)
    held = threading.Event()

    def client(result: LiveResult) -> None:
        if kind == "raises":
            raise RuntimeError("the client's own mistake")
        held.wait(60)

    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg", on_result=client)
        for frame in recording.frames(0, 2):
            live.push_frame(frame, wait=True)
        assert live.drain(60)
        live.stop()  # returns, whatever the client does
    held.set()
    counts = live.counts
    assert counts.frames == 2
    assert (counts.callback_errors > 0) is (kind == "raises")


def test_a_disk_that_is_full_for_a_while_costs_the_frames_of_that_while(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, told, append, write = tmp_path / "m.gpkg", Told(), Journal.append, Journal._write
    full = [False]

    def appending(self: Journal, kind: str, value: Any, *blobs: bytes) -> bool:
        if kind == "frame":
            full[0] = value[1][0] in ("000022", "000023")
        return append(self, kind, value, *blobs)

    monkeypatch.setattr(Journal, "append", appending)
    monkeypatch.setattr(Journal, "_write", lambda self: not full[0] and write(self))
    drive_live(short_drive, out, told)
    monkeypatch.undo()
    assert len(told.of(LiveGrid)) == 6
    assert len(told.texts("disk")) >= 2
    kept = some_frames(short_drive, tmp_path / "kept" / "drive", (20, 21, 24, 25))
    build_map([kept], tmp_path / "kept.gpkg", BuildSettings())
    with open_map(out) as ours, open_map(tmp_path / "kept.gpkg") as theirs:
        assert [f.pose for f in ours.frames("drive")] == [f.pose for f in theirs.frames("drive")]
        np.testing.assert_array_equal(ours.read().density, theirs.read().density)


def test_fixes_and_rows_that_a_full_disk_costs_are_told(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, write = Told(), Journal._write
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg", on_result=told)
        monkeypatch.setattr(Journal, "_write", lambda _self: False)
        monkeypatch.setattr("fieldgrid.pipeline.staging.journal.MAX_WAITING_BYTES", 2_000)
        push_fixes(live, recording)
        monkeypatch.setattr(Journal, "_write", write)
        live.push_gyro(1, 0.0)  # too large for memory yet, and then the disk takes what waits
        live._kept.journal.sync()
        live.push_gyro(2, 0.0)
        live.stop()
        pushed = live.counts.fixes + 2
    full, again = told.texts("disk")
    assert "takes nothing" in full
    found = re.search(r"again\. (\d+) records did not fit", again)
    assert found
    assert 0 < int(found[1]) < pushed
    journal = list(read_journal(live.folder / "live"))
    assert sum(record.kind in ("fix", "rows") for record in journal) == pushed - int(found[1])


def test_an_end_that_is_interrupted_lets_go_of_the_session(
    short_drive: Path, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    out = tmp_path / "m.gpkg"
    before = set(threading.enumerate())
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.drain()
        close = live._perceiver.close
        monkeypatch.setattr(live._perceiver, "close", interrupted)
        with pytest.raises(KeyboardInterrupt):
            live.finish()
        close()
    assert set(threading.enumerate()) == before
    finish_session(out)
    assert content(out) == content(built)


def test_a_frame_that_is_refused_is_not_heard(short_drive: Path, tmp_path: Path) -> None:
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        grey = np.zeros((480, 640), np.uint8)
        with pytest.raises(ConfigError, match="no number of nanoseconds"):
            live.push_pair(grey, grey, 1 << 70)
        assert live._heard_ns == 0
        live.stop()


def test_fixes_that_a_full_disk_never_took_are_in_the_map(
    short_drive: Path, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        for frame in recording.frames():
            live.push_frame(frame, wait=True)
        live.drain()
        monkeypatch.setattr(Journal, "_write", lambda _self: False)
        push_fixes(live, recording)
        live.finish()
    assert content(out) == content(built)


def test_an_end_on_a_full_disk_says_what_is_lost(
    short_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        push_fixes(live, recording)
        for frame in recording.frames():
            live.push_frame(frame, wait=True)
        live.drain()
        monkeypatch.setattr(Journal, "_write", lambda _self: False)
        live.push_gyro(1, 0.0)

        def full(*_given: object, **_options: object) -> None:
            raise MapWriteError(errno.ENOSPC, "The disk is full.")

        monkeypatch.setattr("fieldgrid.live.finish.made_map", full)
        with pytest.raises(MapWriteError, match="but for the last 1 records") as caught:
            live.finish()
        assert "--finish tries again" in str(caught.value)
        monkeypatch.undo()
    assert finish_session(out).used == 6


def test_times_that_no_map_can_have_are_refused_and_not_kept(
    short_drive: Path, tmp_path: Path
) -> None:
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        fix, frame = next(iter(recording.fixes())), next(iter(recording.frames()))
        for time_ns in (-1, 1 << 63, 1 << 70):
            with pytest.raises(ConfigError, match=f"UTC\\): {time_ns}"):
                live.push_fix(fix._replace(time_ns=time_ns))
            with pytest.raises(ConfigError, match=f"UTC\\): {time_ns}"):
                live.push_pair(*frame.images(), time_ns)
        live.stop()
        assert (live.counts.fixes, live.counts.frames) == (0, 0)
    assert [record.kind for record in read_journal(live.folder / "live")] == ["begin"]


def test_images_of_another_kind_are_told_and_left_out(short_drive: Path, tmp_path: Path) -> None:
    told = Told()
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg", on_result=told)
        left, right = next(iter(recording.frames())).images()
        wrong: list[Any] = [np.dstack([left] * 3), left.astype(np.uint16), None]
        for k, image in enumerate(wrong):
            live.push_pair(image, right, 1_000_000_000 + k, wait=True)
        live.stop()
    texts = told.texts("frame bad")
    for text, what in zip(texts, ("uint8 [480, 640, 3]", "uint16", "NoneType"), strict=True):
        assert f"/left is {what}" in text
        assert "push a grey image of 8 bit" in text


def test_frames_of_a_clock_that_was_put_back_say_what_to_do(
    short_drive: Path, tmp_path: Path
) -> None:
    told = Told()
    with open_recording(short_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg", on_result=told)
        left, right = next(iter(recording.frames())).images()
        day_s = 86_400
        assert live.push_pair(left, right, 2 * day_s * 10**9, wait=True)
        assert not live.push_pair(left, right, day_s * 10**9)
        live.stop()
    (text,) = told.texts("frame late")
    assert "86400 s before the newest one" in text
    assert "end this session and begin another" in text


def test_a_frame_that_cannot_be_read_is_told_and_left_out(
    short_drive: Path, tmp_path: Path
) -> None:
    out, told = tmp_path / "m.gpkg", Told()
    with open_recording(short_drive) as recording, begin(recording, out, on_result=told) as live:
        push_fixes(live, recording)
        for k, frame in enumerate(recording.frames()):
            size = (9, 9) if k == 2 else (480, 640)
            left, right = frame.images()
            live.push_pair(
                *(left[: size[0], : size[1]], right[: size[0], : size[1]], frame.time_ns),
                wait=True,
            )
        live.drain()
        assert live.counts.bad == 1
    (text,) = told.texts("frame bad")
    assert "9 x 9 px" in text
    with open_map(out) as universal:
        assert universal.sessions()[0].frames == 5
        assert universal.sessions()[0].config["bad_frames"] == 1


def test_a_session_without_a_frame_is_removed_but_for_fixes(
    short_drive: Path, tmp_path: Path
) -> None:
    """A recording may have their frames."""
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        begin(recording, out).close()
        assert not live_folder(out).exists()
        with begin(recording, out) as live:
            live.push_fix(next(iter(recording.fixes())))
        assert live_folder(out).exists()
        with begin(recording, out) as again:
            assert again.counts.fixes == 1
        assert live_folder(out).exists()


def test_an_end_that_is_refused_keeps_the_drive_and_says_how_to_finish_it(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        push_fixes(live, recording)
        for frame in recording.frames():
            left, right = frame.images()
            live.push_pair(left, np.roll(right, 5, axis=0), frame.time_ns, wait=True)
        with pytest.raises(RecordingError, match="--accept vertical-misalignment") as told:
            live.close()
    assert f"The drive is kept in {live_folder(out)}" in str(told.value)
    assert "--finish" in str(told.value)
    assert not out.exists()
    with pytest.raises(ConfigError, match="grids, which are made"):
        finish_session(out, {"grid": {"cell_m": 0.1}})
    report = finish_session(out, {"checks": {"accept": ["vertical-misalignment"]}})
    assert report.frames == 6
    assert any("Accepted vertical-misalignment" in note for note in report.notes)
    assert not live_folder(out).exists()


def test_a_session_without_a_fix_is_kept_until_it_is_discarded(
    short_drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        for frame in recording.frames(0, 2):
            live.push_frame(frame, wait=True)
        with pytest.raises(GnssError, match="no position at all"):
            live.close()
        # Of other settings it is another session.
        with pytest.raises(ConfigError, match="holds the session 'drive'"):
            begin(recording, out, settings=BuildSettings(map={"cell_m": 0.2}))
    assert discard_session(out) == ("drive", 2)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ConfigError, match="no live session"):
        finish_session(out)


def test_what_the_map_would_refuse_is_refused_before_the_drive(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    with open_recording(short_drive) as recording:
        with pytest.raises(MapExistsError, match="--append"):
            begin(recording, built)
        with pytest.raises(ConfigError, match="has a session 'drive' already"):
            begin(recording, built, append=True)
        with pytest.raises(ConfigError, match="no map"):
            begin(recording, tmp_path / "m.gpkg", append=True)
        with begin(recording, tmp_path / "m.gpkg") as live:
            with pytest.raises(ConfigError, match="not finite"):
                live.push_gyro(1, float("nan"))
            with pytest.raises(ConfigError, match="shape"):
                live.push_gyro([1, 2], [0.0, 0.0, 0.0])
    with pytest.raises(RecordingError, match="has ended"):
        live.push_gyro(1, 0.0)
    assert list(tmp_path.iterdir()) == []  # nothing was driven
    for wrong in ({"queue_frames": 0}, {"lag_s": -1.0}, {"window_s": 1.0}, {"map_side_m": 1e9}):
        with pytest.raises(ConfigError, match="is outside"):
            LiveOptions(**wrong)  # type: ignore[arg-type]


def test_a_drive_is_added_to_a_map_as_a_build_does(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    ours, theirs = tmp_path / "ours.gpkg", tmp_path / "theirs.gpkg"
    for copy in (ours, theirs):
        shutil.copy(built, copy)
    with open_recording(short_drive) as recording:
        named = replace(recording, name="again")
        with begin(named, ours, append=True) as live:
            replay(live, named, rate=None)
    build_map([short_drive], theirs, BuildSettings(), append=True, name="again")
    assert content(ours) == content(theirs)


def test_an_error_of_the_clients_program_keeps_the_drive(short_drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        live.push_frame(next(recording.frames()), wait=True)
        error = ZeroDivisionError("the client's own")
        live.__exit__(type(error), error, None)
        assert not out.exists()
        told = Told()
        live = begin(recording, out, on_result=told)
        assert live.is_resumed
        assert live.counts.frames == 1
        live.stop()
    assert "goes on: 1 frames are kept" in told.texts("session")[0]
