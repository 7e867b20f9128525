"""A whole session through sources, and what is told of clocks."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import pytest

from fieldgrid.core import BuildSettings
from fieldgrid.live import ImageFolder, LiveGrid, Receiver, Sources
from fieldgrid.live.intake import CLOCK_SAMPLES, Intake, SourceEndedError, _Clocks
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import open_growing, open_recording
from tests.live.making import begin
from tests.live.sources import (
    QUICK,
    Heard,
    append,
    drop,
    empty_copy,
    listening,
    rows_of,
    running,
)
from tests.pipeline.drives.making import content
from tests.scenes import paper_rig

pytestmark = pytest.mark.usefixtures("worked_out_once")


def test_the_map_through_a_socket_and_a_folder_is_that_of_a_build(
    short_drive: Path, tmp_path: Path
) -> None:
    """The receiver is lost in between, and images come twice and late."""
    out, heard = tmp_path / "m.gpkg", Heard()
    folder = empty_copy(short_drive, tmp_path / "drive")
    (folder / "gnss").mkdir()
    kept = folder / "gnss" / "gnss_rtk.nmea"
    log = (short_drive / "gnss" / "gnss_rtk.nmea").read_bytes()
    half = log.index(b"$GPGGA", len(log) // 2)
    watched = open_growing(folder)
    with open_recording(short_drive) as recording, listening() as (server, place):
        assert watched.rig == recording.rig
        live = begin(recording, out, on_result=heard)
        with Sources(live, (Receiver(f"tcp://{place}", kept), ImageFolder(watched)), QUICK):
            heard.wait_text("is watched for frames.")
            link, _ = server.accept()
            with link:
                link.sendall(log[:half])
            heard.wait_text("is not there")
            for count, row in enumerate(rows_of(short_drive), 1):
                drop(short_drive, folder, row)
                heard.wait(lambda count=count: len(heard.of(LiveGrid)) == count)  # type: ignore[misc]
            append(folder, rows_of(short_drive)[0])
            heard.wait(lambda: bool(heard.texts("frame late")))
            link, _ = server.accept()
            with link:
                link.sendall(log[half:])
                heard.wait_text("is there again")
            heard.wait_text("is not there", 2)
        assert live.counts.late == 1
        live.finish()
    # The folder becomes the recording of the drive.
    assert kept.read_bytes() == log
    shutil.copy(short_drive / "frames.csv", folder)
    build_map([folder], tmp_path / "built.gpkg", BuildSettings())
    assert content(out) == content(tmp_path / "built.gpkg")


def test_a_source_that_fails_or_ends_stops_no_other() -> None:
    class Failing:
        name = "A source"

        def run(self, intake: Intake) -> NoReturn:
            raise ZeroDivisionError("a mistake of its own")

        def finish(self, intake: Intake) -> NoReturn:
            raise FileNotFoundError("gone")

    with running(Failing()) as notes:
        notes.wait_told("A source is not there (ZeroDivisionError('a mistake of its own'))")
    assert notes.told[1:] == ["A source could not be finished: gone"]

    class Ending:
        name = "A source"

        def run(self, intake: Intake) -> NoReturn:
            raise SourceEndedError("has come to its end.")

        def finish(self, intake: Intake) -> None:
            pass

    class Going(Ending):
        def run(self, intake: Intake) -> None:  # type: ignore[override]
            intake.stop.wait()

    both = Sources(notes, (Ending(), Going()))  # type: ignore[arg-type]
    notes.wait_told("A source has come to its end.")
    assert not both.wait(0.0)
    both.close()
    assert both.wait(0.0)


@pytest.mark.parametrize("apart_s", [0.0, 0.9, 18.0, -7200.0])
def test_stamps_of_clocks_that_differ_are_told_and_moved_by_nobody(apart_s: float) -> None:
    """Fixes and images come as fast as can be here, each with its own clock."""
    now_ns = 1_750_000_000_000_000_000
    clocks, told = _Clocks(3.0), []
    for _ in range(CLOCK_SAMPLES):
        told += [clocks.fix(now_ns), clocks.frame(now_ns + round(apart_s * 1e9))]
    said = [text for text in told if text]
    if abs(apart_s) < 1.0:
        assert said == []
        return
    (text,) = said
    assert f"Images are stamped {apart_s:+.1f} s against the fixes" in text
    assert ("GPS time" if apart_s == 18.0 else "2 h is that of a time zone") in text
    assert f"--time-offset {3.0 - apart_s:.1f}." in text
    again = [clocks.frame(now_ns) for _ in range(CLOCK_SAMPLES)]
    assert [text for text in again if text] == [
        "Images and fixes that come together are stamped alike again."
    ]


def test_nothing_is_told_of_clocks_while_a_recording_comes_as_fast_as_it_is_read() -> None:
    """A frame each 1.6 s and eight fixes between: the last ten of each are of other times."""
    clocks, told = _Clocks(0.0), []
    for k in range(200):
        now_ns = 1_750_000_000_000_000_000 + 200_000_000 * k
        told.append(clocks.fix(now_ns))
        if k % 8 == 0:
            told.append(clocks.frame(now_ns))
    assert not any(told)


def test_frames_are_compared_by_the_receivers_clock(short_drive: Path) -> None:
    """An offset that is given counts: with it the clocks agree."""
    with open_recording(short_drive) as recording:
        (frame, *_), fix = list(recording.frames()), next(iter(recording.fixes()))
    offset_ns = 40_000_000_000
    moved = replace(frame, time_ns=fix.time_ns - offset_ns)

    class Both:
        name = "Both"

        def run(self, intake: Intake) -> NoReturn:
            for _ in range(CLOCK_SAMPLES):
                intake.push_fix(fix)
                intake.push_frame(moved)
            raise SourceEndedError("ends.")

        def finish(self, intake: Intake) -> None:
            pass

    for given_ns, count in ((offset_ns, 1), (0, 2)):
        rig = replace(paper_rig(), image_time_offset_ns=given_ns)
        with running(Both(), rig=rig) as notes:
            notes.wait_told("ends.")
        assert len(notes.told) == count, notes.told
