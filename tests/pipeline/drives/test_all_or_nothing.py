"""A build that fails leaves nothing, and fails early where it can."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from fieldgrid.core import (
    ConfigError,
    FieldgridError,
    GnssError,
    MapExistsError,
    RecordingError,
    resolve,
)
from fieldgrid.geometry import Status
from fieldgrid.maps import open_map
from fieldgrid.pipeline import (
    Progress,
    estimate_mount,
    inspect_recording,
    visual_odometry,
    work_folder,
)
from fieldgrid.pipeline.staging.perception import CameraMotion
from fieldgrid.recordings import DriveOptions, open_recording
from tests.conftest import TWO_LANES
from tests.pipeline.drives.making import (
    COURSE,
    MakeDrive,
    build,
    damage,
    fog,
    no_image_is_read,
    pipeline_threads,
)


def test_a_drive_that_fails_half_way_leaves_no_file(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(3, 11))
    damage(drive / "right" / "000008.jpg")
    (tmp_path / "out").mkdir()
    done: list[Progress] = []
    with pytest.raises(RecordingError, match=r"right/000008\.jpg is truncated"):
        build([drive], tmp_path / "out" / "m.gpkg", progress=done.append)
    assert 0 < max(now.frames_done for now in done) < 6
    assert list((tmp_path / "out").iterdir()) == []
    assert pipeline_threads() == []


def test_an_existing_map_is_replaced_only_by_a_whole_one(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "out" / "m.gpkg"
    out.parent.mkdir()
    build([make_drive("first")], out)
    before = out.read_bytes()
    second = make_drive("second", range(5, 9))
    with pytest.raises(MapExistsError, match=r"exists already; .*--append.*--overwrite"):
        build([second], out)
    assert out.read_bytes() == before
    image = second / "left" / "000007.jpg"
    damage(image)
    with pytest.raises(RecordingError, match="truncated"):
        build([second], out, overwrite=True)
    assert out.read_bytes() == before
    image.unlink()
    image.symlink_to(TWO_LANES / "left" / "000007.jpg")
    build([second], out, overwrite=True)
    with open_map(out) as universal:
        assert [info.name for info in universal.sessions()] == ["second"]
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("append", [False, True])
def test_an_interrupt_leaves_what_was_staged_and_nothing_else(
    append: bool, make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "out" / "m.gpkg"
    out.parent.mkdir()
    if append:
        build([make_drive("first")], out)
    before = {path: path.read_bytes() for path in out.parent.iterdir()}

    def interrupt(now: Progress) -> None:
        if now.frames_done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build([make_drive(frames=range(3, 9))], out, append=append, progress=interrupt)
    shutil.rmtree(work_folder(out))
    assert {path: path.read_bytes() for path in out.parent.iterdir()} == before


@pytest.fixture
def opencv_threads() -> Iterator[int]:
    """How many threads OpenCV was told to use before the test."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    yield 2
    cv2.setNumThreads(before)


def test_after_an_interrupt_the_process_is_as_it_was(
    make_drive: MakeDrive, tmp_path: Path, opencv_threads: int
) -> None:
    def interrupt(now: Progress) -> None:
        if now.frames_done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        build([make_drive(frames=range(3, 9))], tmp_path / "m.gpkg", jobs=3, progress=interrupt)
    # `caught` keeps the traceback, as an interactive Python does.
    assert pipeline_threads() == []
    assert cv2.getNumThreads() == opencv_threads
    del caught


@pytest.mark.parametrize("work", ["odometry", "mount", "inspect"])
def test_after_another_interrupt_the_process_is_as_it_was(
    work: str, make_drive: MakeDrive, opencv_threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    drive = make_drive(frames=range(3, 9))

    def begin() -> None:
        if work == "odometry":
            monkeypatch.setattr(CameraMotion, "add", interrupt)
            with open_recording(drive) as recording:
                visual_odometry(recording, jobs=3)
        elif work == "mount":
            estimate_mount(drive, progress=interrupt)
        else:
            inspect_recording(drive, tell=interrupt)

    with pytest.raises(KeyboardInterrupt) as caught:
        begin()
    assert pipeline_threads() == []
    assert cv2.getNumThreads() == opencv_threads
    del caught


def test_after_a_build_the_process_is_as_it_was(
    make_drive: MakeDrive, tmp_path: Path, opencv_threads: int
) -> None:
    build([make_drive()], tmp_path / "m.gpkg", jobs=3)
    assert pipeline_threads() == []
    assert cv2.getNumThreads() == opencv_threads


# --- what can be checked is checked before the first image is read


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def a_day_later(table: str) -> str:
    return table.replace(",13081338", ",13082202")


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (
            lambda drive: rewrite(drive / "frames.csv", a_day_later),
            GnssError,
            r"Images \(2011-06-16T10:30:19\.840Z to .*\) and fixes \(2011-06-15T.*Z to .*Z\) do "
            r"not overlap in time; .* \(1 day: one of the two has a wrong date\): .* --time-offset "
            r"-86400 or image_time_offset_s = -86400 in recording.toml, else .*",
        ),
        (
            lambda drive: (drive / "gnss" / "gnss_rtk.nmea").write_text(""),
            GnssError,
            "holds no position at all; record one, or choose another with --gnss",
        ),
        (
            lambda drive: (drive / "gnss" / "gnss_rtk.nmea").unlink(),
            GnssError,
            "has no GNSS log, without which nothing can be placed",
        ),
        (
            lambda drive: (drive / "left" / "000004.jpg").unlink(),
            RecordingError,
            r"1 of 6 images are missing .*000004\.jpg",
        ),
    ],
)
def test_a_drive_without_a_place(
    spoil: Callable[[Path], object],
    error: type[FieldgridError],
    message: str,
    make_drive: MakeDrive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    no_image_is_read(monkeypatch)
    drive = make_drive()
    spoil(drive)
    with pytest.raises(error, match=message):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"append": True, "overwrite": True}, "--append and --overwrite exclude each other"),
        ({"append": True}, r"There is no map .*m\.gpkg to append to; leave out --append"),
        (
            {"settings": resolve(None, {"pose": {"heading": "north"}})},
            "Heading source 'north' is none of smooth, course, recorded, constant:DEG",
        ),
        (
            {"settings": resolve(None, {"pose": {"heading": "recorded"}})},
            "has a heading of its own; use --heading smooth",
        ),
    ],
)
def test_options_that_cannot_be(
    options: dict[str, Any],
    message: str,
    make_drive: MakeDrive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    no_image_is_read(monkeypatch)
    drive = make_drive()
    with pytest.raises(FieldgridError, match=message):
        build([drive], tmp_path / "m.gpkg", **options)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_cells_finer_than_the_local_ones_leave_no_file(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive()
    fine = resolve(None, {"map": {"cell_m": 0.02}})
    with pytest.raises(ConfigError, match=r"0\.02 m are smaller than the local cells of 0\.05 m"):
        build([drive], tmp_path / "m.gpkg", settings=fine)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_a_drive_of_which_no_frame_can_be_placed_leaves_no_file(
    make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive(frames=[3, 4])

    def without_fixes_around_the_frames(text: str) -> str:
        lines = text.splitlines(keepends=True)
        return "".join(line for line in lines if not ",10301" < line[6:12] < ",10303")

    rewrite(drive / "gnss" / "gnss_rtk.nmea", without_fixes_around_the_frames)
    with pytest.raises(GnssError, match=r"None of the 2 frames of drive has a usable pose, mostly"):
        build([drive], tmp_path / "m.gpkg")
    assert sorted(tmp_path.iterdir()) == [drive]


def test_a_frame_without_ground_is_rejected(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(frames=range(4, 8)), tmp_path / "m.gpkg"
    fog(drive, "000005")
    (report,) = build([drive], out)
    assert (report.used, report.rejected, report.ground_refined) == (3, 1, 3)
    (reason,) = report.reasons
    assert "no ground was found in the image" in reason
    with open_map(out) as universal:
        rejected = [r.frame_id for r in universal.frames() if r.status is not Status.OK]
    assert rejected == ["000005"]


def test_a_drive_without_ground_is_no_matter_of_gnss(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive(frames=range(4, 6))
    fog(drive, "000004", "000005")
    with pytest.raises(FieldgridError, match=r"no ground was found .* mounting") as caught:
        build([drive], tmp_path / "m.gpkg")
    assert "--gnss" not in str(caught.value)
    assert sorted(tmp_path.iterdir()) == [drive]


def test_a_pose_that_was_rejected_keeps_its_reason(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(frames=[4, 5, 22]), tmp_path / "m.gpkg"
    shutil.copy(TWO_LANES / "gnss" / "gnss_sf1.nmea", drive / "gnss")
    fog(drive, "000022")
    build([drive], out, options=DriveOptions("gnss_sf1.nmea"), settings=COURSE)
    with open_map(out) as universal:
        reasons = {record.frame_id: record.reason for record in universal.frames()}
    assert "usable pose" in reasons["000022"]
