"""The command `live`: replay, signals, lines of JSON, and how it is used wrongly."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import threading
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from fieldgrid.cli.commands.live import kept_when_interrupted
from fieldgrid.live import live_folder
from fieldgrid.maps import open_map
from fieldgrid.recordings import open_recording
from tests.cli.conftest import Run, in_a_process
from tests.conftest import make_small_drive
from tests.live.making import begin, cut_log, slam
from tests.live.sources import drop, empty_copy, rows_of


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = make_small_drive(tmp_path_factory.mktemp("live") / "june", range(20, 24))
    cut_log(made)
    return made


def test_a_replay_tells_what_it_kept_and_makes_the_map(
    drive: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    out = tmp_path / "m.gpkg"
    result = fieldgrid("live", "-o", out, "--replay", drive, "--rate", "max", "--name", "row")
    assert result.status == 0
    assert re.search("^frames kept +4$", result.out, re.MULTILINE)
    assert "session row" in result.out
    assert result.out.endswith(f"map {out}\n")
    assert all(line.startswith("fieldgrid: ") for line in result.err.splitlines())
    sentence = fieldgrid("live", "-o", out, "--replay", drive).sentence()
    assert "exists already" in sentence
    assert "--append" in sentence


def test_a_replay_takes_poses_of_another_program(
    drive: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    tum, out = slam(drive, tmp_path / "slam.tum"), tmp_path / "m.gpkg"
    live = ("live", "-o", out, "--replay", drive, "--rate", "max", "--poses", tum)
    result = fieldgrid(*live)
    assert result.status == 0
    assert "axes flu, frame z up" in result.out
    with open_map(out) as universal:
        assert universal.sessions()[0].config["poses"] == "slam.tum"
    turned = fieldgrid(*live[:2], tmp_path / "n.gpkg", *live[3:], "--poses-axes", "rdf")
    assert "--poses-axes" in turned.sentence()


@pytest.mark.parametrize(
    "request_to_end", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)]
)
def test_a_request_to_end_makes_the_map_of_what_was_driven(
    request_to_end: signal.Signals, tmp_path: Path
) -> None:
    # The last frame comes long after the others, which are far enough apart to tell a heading.
    drive = make_small_drive(tmp_path / "drives" / "june", (20, 25, 30, 49))
    cut_log(drive)
    out = tmp_path / "m.gpkg"
    arguments = ("live", "-o", out, "--replay", drive, "--rate", "8", "--json")
    said = []
    with subprocess.Popen(
        in_a_process(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        for line in process.stdout:
            said.append(json.loads(line))
            if sum("grid" in one for one in said) == 3 and "grid" in said[-1]:
                os.kill(process.pid, request_to_end)
        told = process.stderr.read()
    assert process.returncode == 0, told
    assert told == "fieldgrid: ending the drive and making its map; interrupt again to cancel\n"
    assert said[-1]["map"] == str(out)
    assert said[-1]["pushed"]["frames"] == said[-1]["session"]["frames"] >= 3
    assert {next(iter(one)) for one in said} >= {"grid", "pose", "window", "map"}
    with open_map(out) as universal:
        assert universal.verify(deep=True).sound
    assert not (tmp_path / "m.gpkg.work").exists()


@pytest.mark.parametrize(("ends", "status"), [(KeyboardInterrupt(), 130), (SystemExit(143), 143)])
def test_who_interrupts_the_making_of_the_map_is_told_where_the_drive_is(
    ends: BaseException, status: int, drive: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    out = tmp_path / "m.gpkg"

    def interrupted(*_given: object, **_named: object) -> None:
        raise ends

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fieldgrid.live.finish.NewSession", interrupted)
        replay = "live", "-o", out, "--replay", drive, "--rate", "max"
        for attempt in (replay, ("live", "-o", out, "--finish")):
            result = fieldgrid(*attempt)
            assert result.status == status
            assert f"interrupted. The drive is kept in {out}.work; fieldgrid live" in result.err
            assert "--finish makes the map of it" in result.err
    fieldgrid("live", "-o", out, "--finish").output()


def test_another_writer_is_waited_for_as_long_as_is_said(
    drive: Path, tmp_path: Path, two_lanes_map: Path, fieldgrid: Run
) -> None:
    out = Path(shutil.copy(two_lanes_map, tmp_path / "m.gpkg"))
    with closing(sqlite3.connect(out, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        replay = "live", "-o", out, "--replay", drive, "--rate", "max", "--append", "--name", "new"
        for attempt in (replay, ("live", "-o", out, "--finish")):
            result = fieldgrid(*attempt, "--wait", 0.1)
            assert result.status == 1
            assert "waiting for another program that writes m.gpkg, up to 0.1 s" in result.err
            assert "is in use by another program" in result.err
    with pytest.MonkeyPatch.context() as patch:  # four frames are too few to be compared
        patch.setattr(
            "fieldgrid.cli.commands.live.compare", lambda out, new, wait_s: [apart(new[0])]
        )
        text = fieldgrid("live", "-o", out, "--finish", "--wait", 0.1).output()
    told = (
        f"\nnew against june: +0.50 m east, +0.00 m north ± 0.10 m; `fieldgrid align {out}` makes"
    )
    assert told in text


def apart(name: str) -> dict[str, Any]:
    """That a new drive lies beside an older one."""
    lies = {"of": name, "against": "june", "lay_apart_m": [0.5, 0.0], "sigma_m": 0.1}
    return {**lies, "doubt": None, "aligned": False}


def test_a_drive_whose_end_is_refused_is_finished_or_discarded_later(
    drive: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    out = tmp_path / "m.gpkg"
    replay = ("live", "-o", out, "--replay", drive, "--rate", "max", "--time-offset", "-500")
    result = fieldgrid(*replay)
    assert result.status == 1
    assert f"The drive is kept in {tmp_path / 'm.gpkg.work'}" in result.err
    assert "do not overlap in time" in fieldgrid("live", "-o", out, "--finish").sentence()
    made = fieldgrid("live", "-o", out, "--finish", "--cell", "0.2").usage()
    assert "the drive is over" in made
    again = fieldgrid("live", "-o", out, "--replay", drive)
    assert "--discard" in again.sentence()
    text = fieldgrid("live", "-o", out, "--discard").output()
    assert text == "removed the session june with 4 frames\n"
    assert not (tmp_path / "m.gpkg.work").exists()
    assert "no live session" in fieldgrid("live", "-o", out, "--finish").sentence()


def test_a_session_of_which_nothing_can_be_read_is_discarded(
    tmp_path: Path, fieldgrid: Run
) -> None:
    folder = tmp_path / "m.gpkg.work"
    folder.mkdir()
    (folder / "live").write_bytes(bytes(300))  # as a power cut may leave it
    out = tmp_path / "m.gpkg"
    assert "--discard" in fieldgrid("live", "-o", out, "--finish").sentence()
    assert fieldgrid("live", "-o", out, "--discard").output() == "removed an unreadable session\n"
    assert not folder.exists()


def test_an_interruption_before_the_end_has_begun_names_the_folder(tmp_path: Path) -> None:
    def notes() -> list[str]:
        kept = kept_when_interrupted(tmp_path / "live", tmp_path / "m", "--finish-from june")
        with pytest.raises(KeyboardInterrupt) as end, kept:
            raise KeyboardInterrupt
        return getattr(end.value, "__notes__", [])

    assert notes() == []
    (tmp_path / "live").mkdir()
    assert "-o " + str(tmp_path / "m") + " --finish-from june makes the map" in notes()[0]


def test_wrong_uses(drive: Path, tmp_path: Path, fieldgrid: Run) -> None:
    out = tmp_path / "m.gpkg"
    assert "--images, --camera, --mcap, --replay" in fieldgrid("live", "-o", out).usage()
    assert "one of" in fieldgrid("live", "-o", out, "--replay", drive, "--finish").usage()
    for rate in ("0", "fast", "nan", "-1"):
        assert "--rate" in fieldgrid("live", "-o", out, "--replay", drive, "--rate", rate).usage()
    assert "--discard only" in fieldgrid("live", "-o", out, "--discard", "--cell", "1").usage()
    assert "does not exist" in fieldgrid("live", "-o", out, "--replay", "nowhere").sentence()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "request_to_end", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_a_drive_through_a_pipe_and_a_folder_ends_cleanly(
    drive: Path, request_to_end: signal.Signals, tmp_path: Path
) -> None:
    """Fixes come through standard input, images into a folder, the window goes out; a signal ends
    it."""
    folder, out = empty_copy(drive, tmp_path / "row"), tmp_path / "m.gpkg"
    arguments = ("live", "-o", out, "--images", folder, "--gnss", "-", "--json")
    with subprocess.Popen(
        in_a_process(*arguments, "--feed", "tcp://127.0.0.1:0", "--view", "0", "--foxglove", "0"),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        said: list[Any] = []
        # A frame that is dropped on a busy machine is not waited for without end.
        watchdog = threading.Timer(240.0, process.kill)
        watchdog.daemon = True
        watchdog.start()

        def until(part: str) -> None:
            while True:
                said.append(process.stdout.readline().decode())  # type: ignore[union-attr]
                assert said[-1], (process.stderr.read(), said[-6:])  # type: ignore[union-attr]
                if part in said[-1]:
                    return

        feed = process.stderr.readline().decode()
        port = re.search(r"every client of tcp://127\.0\.0\.1:(\d+)\n", feed)
        assert port is not None
        link = re.search(
            r"follows the vehicle is (http://\S+/)#", process.stderr.readline().decode()
        )
        assert link is not None
        assert b"Foxglove can connect to ws://127.0.0.1:" in process.stderr.readline()
        until("is watched for frames.")
        with socket.create_connection(("127.0.0.1", int(port[1])), 60) as client:
            process.stdin.write((drive / "gnss" / "gnss_rtk.nmea").read_bytes())
            process.stdin.close()
            # A frame that comes when the fixes before it are still being read is stamped ahead of
            # all else, and is held or left out.
            until("The receiver at - has come to its end.")
            for row in rows_of(drive):
                drop(drive, folder, row)
                until('{"grid"')
            client.settimeout(60)
            assert client.recv(4, socket.MSG_WAITALL) == b"FGWN"
            with urlopen(f"{link[1]}api/live", timeout=60) as news:
                # The first windows may be of before the fixes were used.
                told = next(
                    one
                    for line in news
                    if line.startswith(b"data: ")
                    and (one := json.loads(line.removeprefix(b"data: ")))["window"]
                    and one["window"]["fixes"]
                )
            assert told["session"] == "row"
            os.kill(process.pid, request_to_end)
            last = [json.loads(line) for line in process.stdout]
        told = process.stderr.read().decode()
        watchdog.cancel()
    assert process.returncode == 0, told
    assert told == "fieldgrid: ending the drive and making its map; interrupt again to cancel\n"
    assert last[-1]["pushed"]["frames"] == last[-1]["session"]["frames"] == 4
    texts = [one["text"] for one in (*map(json.loads, said), *last) if "event" in one]
    assert "The receiver at - has come to its end." in texts
    with open_map(out) as ours:
        (session,) = ours.sessions()
        assert (session.name, session.accepted) == ("row", 4)
        assert ours.verify(deep=True).sound


def test_a_session_to_which_no_frame_came_leaves_nothing(drive: Path, tmp_path: Path) -> None:
    """It would be in the way of the next one, whose receiver is at another address."""
    out = tmp_path / "m.gpkg"
    ended = subprocess.run(
        in_a_process("live", "-o", out, "--mcap", "-", "--rig", drive),
        stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip
    assert ended.returncode == 1, ended.stderr
    assert ended.stderr.endswith("kept; check where the images come from.\n")
    assert list(tmp_path.iterdir()) == []


def test_fixes_to_which_no_frame_came_are_kept(drive: Path, tmp_path: Path) -> None:
    """A recording may have the frames."""
    folder, out = empty_copy(drive, tmp_path / "row"), tmp_path / "m.gpkg"
    with subprocess.Popen(
        in_a_process("live", "-o", out, "--images", folder, "--gnss", "-", "--json"),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.write((drive / "gnss" / "gnss_rtk.nmea").read_bytes())
        process.stdin.close()
        assert any(b"The receiver at - has come to its end." in line for line in process.stdout)
        os.kill(process.pid, signal.SIGTERM)
        said = process.stderr.read().decode()
    assert process.returncode == 1
    assert "has no frame" in said
    assert "--finish-from RECORDING builds it" in said
    assert live_folder(out).exists()
    done = subprocess.run(
        in_a_process("live", "-o", out, "--finish-from", drive), check=False, timeout=240
    )
    assert done.returncode == 0
    with open_map(out) as universal:
        assert universal.read().observed.any()


def test_a_session_without_a_frame_that_was_killed_is_not_finished(
    drive: Path, tmp_path: Path, fieldgrid: Run
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(drive) as recording:
        live = begin(recording, out)
        live.push_fix(next(iter(recording.fixes())))
        live.stop()
    said = fieldgrid("live", "-o", out, "--finish").sentence()
    assert "has no frame" in said
    assert "--finish-from RECORDING builds it" in said
    assert "tries again" not in said
    assert fieldgrid("live", "-o", out, "--discard").status == 0


def test_wrong_uses_of_sources(drive: Path, tmp_path: Path, fieldgrid: Run) -> None:
    live = ("live", "-o", tmp_path / "m.gpkg")
    images, gnss = ("--images", drive), ("--gnss", "tcp://127.0.0.1:1")
    assert "where the receiver is" in fieldgrid(*live, *images).usage()
    assert "one of --images" in fieldgrid(*live, *images, "--camera", "0", *gnss).usage()
    for idle in (("--rate", "2"), ("--topic", "left=/a"), ("--rig", drive), ("--camera-fps", "3")):
        assert "does not take it" in fieldgrid(*live, *images, *gnss, *idle).usage()
    slam = ("--poses", "slam.tum")
    assert "does not take it" in fieldgrid(*live, *images, *gnss, *slam).usage()
    assert "does not take it" in fieldgrid(*live, "--mcap", "-", *slam).usage()
    axes = ("--mcap", "-", "--rig", drive, "--poses-axes", "rdf")
    assert "--poses-topic" in fieldgrid(*live, *axes).usage()
    assert "--rig" in fieldgrid(*live, "--camera", "0", *gnss).usage()
    assert "--rig" in fieldgrid(*live, "--mcap", "-").usage()
    assert "--camera-fps" in fieldgrid(*live, "--mcap", "-", "--camera-fps", "3").usage()
    assert "does not exist" in fieldgrid(*live, "--images", "nowhere", *gnss).sentence()
    assert "is no camera" in fieldgrid(*live, "--camera", "x", "--rig", drive, *gnss).sentence()
    assert "is no source" in fieldgrid(*live, *images, "--gnss", "http://a:1").sentence()
    replay = ("--replay", drive, "--gnss-log", "x")
    assert "does not take it" in fieldgrid(*live, *replay).usage()
    nowhere = ("--gnss-log", tmp_path / "nowhere" / "log")
    assert "cannot be written" in fieldgrid(*live, *images, *gnss, *nowhere).sentence()
    assert (
        "is no address; give --view" in fieldgrid(*live, *images, *gnss, "--view", "x").sentence()
    )
    assert "is no feed" in fieldgrid(*live, *images, *gnss, "--feed", "7007").sentence()
    assert list(tmp_path.iterdir()) == []
