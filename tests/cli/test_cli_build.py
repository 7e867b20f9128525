"""`fieldgrid build` as a user meets it: what it prints, and how it fails."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import sqlite3
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import fieldgrid.field as fieldgrid_field
import fieldgrid.pipeline as fieldgrid_pipeline
from fieldgrid.core import BuildSettings, ClusterError, ConfigError, grouped_reasons
from fieldgrid.core.workers import connecting
from fieldgrid.geometry import Bounds
from fieldgrid.maps import Transfer, open_map
from fieldgrid.pipeline import build_map
from tests.cli.conftest import Result, Run, a_terminal
from tests.conftest import TWO_LANES

MakeDrive = Callable[..., Path]


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too, with its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A name for a map, in a folder of its own."""
    (tmp_path / "out").mkdir()
    return tmp_path / "out" / "m.gpkg"


@pytest.fixture
def existing(out: Path, two_lanes_map: Path) -> Path:
    """A map that is there already, with a session two_lanes."""
    shutil.copy(two_lanes_map, out)
    return out


# --- when all is well


def test_the_table(fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    drive = make_drive("june-03")
    fixes = (drive / "gnss" / "gnss_rtk.nmea").read_text().count("GPGGA")
    assert 150 < fixes < 250
    text = fieldgrid("build", drive, "-o", out).output()
    lines = [line.rstrip() for line in text.splitlines()]
    assert lines[0] == "session june-03"
    assert lines[-1] == f"map {out}"
    assert re.search(r"^frames used +3 of 3$", text, re.MULTILINE)
    assert re.search(rf"^fixes accepted +\d+ of {fixes}$", text, re.MULTILINE)
    assert re.search(r"^rate +\d+\.\d frames/s$", text, re.MULTILINE)
    assert re.search(r"^heading sigma, median \(smooth\) +0\.\d\d °$", text, re.MULTILINE)
    assert re.search(r"^camera steps +2 of 2$", text, re.MULTILINE)
    assert "rejected" not in text


def test_without_the_camera_s_motion_the_table_says_so(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    text = fieldgrid("build", make_drive(), "-o", out, "--no-visual-odometry").output()
    assert re.search(r"^camera steps +not used$", text, re.MULTILINE)
    with open_map(out) as universal:
        (info,) = universal.sessions()
    assert info.config["settings"]["pose"]["visual_odometry"] is False


def test_json_is_one_object_and_nothing_else(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    drives = [make_drive("june-03"), make_drive("june-10", range(40, 42))]
    result = json.loads(fieldgrid("build", *drives, "-o", out, "--json").output())
    assert result["map"] == str(out)
    assert [s["session"] for s in result["sessions"]] == ["june-03", "june-10"]
    assert [s["frames"] for s in result["sessions"]] == [3, 2]
    first = result["sessions"][0]
    assert first["used"] == 3
    assert first["reasons"] == {}
    assert first["frames_per_s"] > 0
    stages = {"decode_s", "match_s", "grid_s", "odometry_s", "pose_s", "map_s"}
    assert set(first["stages"]) == stages
    assert (first["camera_steps"], first["camera_refusals"]) == (2, 0)
    assert first["heading_source"] == "smooth"


def test_drives_that_fail_are_named_and_the_others_are_built(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    good, broken = make_drive("june-03"), make_drive("june-10", range(40, 43))
    image = broken / "left" / "000041.jpg"
    image.unlink()
    image.write_bytes(b"no image")
    result = fieldgrid("build", good, broken, "-o", out)
    assert result.status == 1
    assert "fieldgrid: 1 of 2 drives are in the map. june-10: " in result.err
    assert "000041.jpg is no PNG" in result.err
    table = re.findall(r"^june-\S+ +(?:in the map|failed) +\S.*$", result.out, re.MULTILINE)
    assert [line.split() for line in table] == [
        ["june-03", "in", "the", "map", "3", "of", "3", "0"],
        ["june-10", "failed", "-", "-"],
    ]
    flags = "--overwrite", "--json", "--skip-bad", "40%"
    result = fieldgrid("build", good, broken, "-o", out, *flags)
    found = json.loads(result.output())
    assert [session["session"] for session in found["sessions"]] == ["june-03", "june-10"]
    assert [bad["frame_id"] for bad in found["sessions"][1]["bad"]] == ["000041"]
    assert found["failed"] == []


def test_waiting_for_another_writer_is_told(
    fieldgrid: Run, make_drive: MakeDrive, existing: Path
) -> None:
    other = sqlite3.connect(existing, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    result = fieldgrid("build", make_drive(), "-o", existing, "--append", "--wait", 0.1)
    other.close()
    assert result.status == 1
    told, refused = result.err.splitlines()
    assert told == "fieldgrid: waiting for another program that writes m.gpkg, up to 0.1 s"
    assert refused.endswith("the same command with --resume goes on from there.")
    fieldgrid("build", make_drive("drive-2"), "-o", existing, "--append", "--no-resume").output()
    assert [path.name for path in existing.parent.iterdir()] == ["m.gpkg"]


def test_every_flag_reaches_the_map(fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    drive = make_drive(frames=range(3, 7))
    shutil.copy(TWO_LANES / "gnss" / "gnss_sf1.nmea", drive / "gnss")
    flags = (
        "--gnss gnss_rtk.nmea --heading constant:-100 --name rows --datum 41.6501,-4.7201,780 "
        "--cell 0.2 --grid 6.6x14 --local-cell 0.1 --slice 0.3:1.8 --max-range 9 --matcher bm "
        "--transfer area --every 2 --jobs 1"
    )
    fieldgrid("build", drive, "-o", out, *flags.split()).output()
    with open_map(out) as universal:
        (info,) = universal.sessions()
        records = list(universal.frames(with_grid=True))
        assert (universal.cell_m, universal.transfer) == (0.2, Transfer.AREA)
        assert universal.datum.height_m == 780.0
        assert universal.datum.lat_deg == 41.6501
    settings = BuildSettings.model_validate(info.config["settings"])
    assert info.name == "rows"
    assert info.heading_source == "constant:-100"
    assert info.source == "gnss/gnss_rtk.nmea"
    assert (settings.density.slice_bottom_m, settings.density.slice_top_m) == (0.3, 1.8)
    assert settings.density.max_range_m == 9.0
    assert settings.stereo.matcher == "bm"
    assert [r.frame_id for r in records] == ["000003", "000005"]
    assert records[0].grid().density.shape == (140, 66)
    assert records[0].pose.heading_deg == -100.0


def test_a_flag_beats_the_settings_file(
    fieldgrid: Run, make_drive: MakeDrive, out: Path, tmp_path: Path
) -> None:
    config = tmp_path / "field.toml"
    config.write_text("[grid]\nwidth_m = 6.0\nlength_m = 12.0\n[pose]\nheading = 'constant:1'\n")
    fieldgrid(
        "build", make_drive(), "-o", out, "--config", config, "--heading", "constant:2"
    ).output()
    with open_map(out) as universal:
        record = next(iter(universal.frames()))
    assert record.pose.heading_deg == 2.0
    assert (record.spec.width_m, record.spec.length_m) == (6.0, 12.0)


def test_append_and_overwrite(fieldgrid: Run, make_drive: MakeDrive, existing: Path) -> None:
    drive = make_drive("june-10")
    existing = existing.rename(existing.with_name("map"))  # as a new map may not be called
    fieldgrid("build", drive, "-o", existing, "--append").output()
    with open_map(existing) as universal:
        assert [info.name for info in universal.sessions()] == ["two_lanes", "june-10"]
    fieldgrid("build", drive, "-o", existing, "--overwrite").output()
    with open_map(existing) as universal:
        assert [info.name for info in universal.sessions()] == ["june-10"]
    assert os.listdir(existing.parent) == [existing.name]


def test_rejected_frames_are_told_by_reason(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    drive = make_drive(frames=[4, 5, 22, 23, 40])
    shutil.copy(TWO_LANES / "gnss" / "gnss_sf1.nmea", drive / "gnss")
    # The camera would carry the poses over the hole in the log.
    flags = ["--gnss", "gnss_sf1.nmea", "--heading", "course"]
    text = fieldgrid("build", drive, "-o", out, *flags).output()
    assert re.search(r"^frames used +3 of 5$", text, re.MULTILINE)
    assert re.search(r"^rejected 2: no usable pose for \d+\.\d\d s around it: ", text, re.MULTILINE)
    assert re.search(
        r"^info note: gnss_sf1.nmea: 6 damaged sentences skipped\.$", text, re.MULTILINE
    )


def test_reasons_that_differ_in_numbers_are_counted_together() -> None:
    reasons = {"0.5 s before": 1, "gone": 2, "1.26 s before": 3, "0.85 s before": 1}
    assert grouped_reasons(reasons) == [(5, "1.26 s before"), (2, "gone")]
    assert grouped_reasons({}) == []


def test_in_a_process_of_its_own_stderr_is_silent(
    fieldgrid_process: Run, make_drive: MakeDrive, out: Path
) -> None:
    result = fieldgrid_process("build", make_drive(), "-o", out, "--json")
    assert json.loads(result.output())["sessions"][0]["used"] == 3


def test_on_a_terminal_there_is_progress_on_stderr_alone(
    fieldgrid: Run, make_drive: MakeDrive, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = make_drive("june-03", range(3, 9))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with a_terminal() as (stream, shown), monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", stream)
        text = fieldgrid("build", drive, "-o", out, "--jobs", 1).output()
    assert text.startswith("session june-03")
    assert "\x1b" not in text
    progress = b"".join(shown).decode()
    assert "june-03" in progress
    assert re.search(r"\d+/6", progress)
    assert re.search(r"\d m\b", progress)
    assert "frames/s" in progress


def test_a_log_without_heights_gives_a_map_in_the_plane(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    drive = make_drive()
    without_sentences(drive, "GGA")
    text = fieldgrid("build", drive, "-o", out).output()
    assert re.search(r"^frames used +3 of 3$", text, re.MULTILINE)
    assert "without a height: taken as 0 m" in " ".join(text.split())


# --- what is wrong with the data: one sentence, exit status 1, nothing left behind


def missing_image(drive: Path) -> None:
    (drive / "right" / "000004.jpg").unlink()


def unreadable_image(drive: Path) -> None:
    (drive / "left" / "000004.jpg").unlink()
    (drive / "left" / "000004.jpg").write_bytes(b"\x00" * 1000)


def truncated_image(drive: Path) -> None:
    data = (TWO_LANES / "left" / "000004.jpg").read_bytes()
    (drive / "left" / "000004.jpg").unlink()
    (drive / "left" / "000004.jpg").write_bytes(data[:5000])


def empty_image(drive: Path) -> None:
    (drive / "left" / "000004.jpg").unlink()
    (drive / "left" / "000004.jpg").touch()


def images_of(drive: Path, sides: tuple[str, ...], size: tuple[int, int]) -> None:
    for side in sides:
        path = drive / side / "000004.jpg"
        path.unlink()
        cv2.imwrite(str(path), np.full(size, 128, dtype=np.uint8))


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def without_sentences(drive: Path, *types: str) -> None:
    path = drive / "gnss" / "gnss_rtk.nmea"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if line[3:6] not in types))


def without_fixes(drive: Path) -> None:
    without_sentences(drive, "GGA", "RMC")


def swap_sides(drive: Path) -> None:
    left, right = drive / "left", drive / "right"
    left.rename(drive / "was_left")
    right.rename(left)
    (drive / "was_left").rename(right)


CALIBRATION, MOUNTING = "calibration/stereo_opencv.yaml", "calibration/mounting.json"

FAULTS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing image": (missing_image, r"1 of 6 images are missing from .*right/000004\.jpg"),
    "unreadable image": (unreadable_image, r"left/000004\.jpg is no PNG, JPEG, .*convert it, or"),
    "truncated image": (truncated_image, r"left/000004\.jpg is truncated or damaged; copy it"),
    "empty image": (empty_image, r"left/000004\.jpg is empty; record or copy it again"),
    "pair of different sizes": (
        lambda drive: images_of(drive, ("right",), (240, 320)),
        r"The pair of frame 000004 differs in size: .* 640 x 480 px, .* 320 x 240 px; record both",
    ),
    "calibration of another size": (
        lambda drive: images_of(drive, ("left", "right"), (240, 320)),
        r"left/000004\.jpg has 320 x 240 px, but the calibration is for 640 x 480 px; give",
    ),
    "calibration that cannot be": (
        lambda drive: edit(drive / CALIBRATION, "-162.972", "162.972"),
        r"stereo_opencv\.yaml: A stereo baseline of -0\.18\d* m is outside",
    ),
    "calibration and mounting at odds": (
        lambda drive: edit(drive / MOUNTING, '"stereo_baseline_m": 0.18', '"stereo_baseline_m": 1'),
        r"mounting\.json.*stereo_baseline_m is 1(\.0)?, but the calibration says",
    ),
    "no calibration": (
        lambda drive: (drive / CALIBRATION).unlink(),
        r"calibration has neither stereo_opencv\.yaml nor .*; put the calibration",
    ),
    "no mounting": (
        lambda drive: (drive / MOUNTING).unlink(),
        r"run `fieldgrid mount .* --write --antenna FORWARD LEFT UP`",
    ),
    "neither calibration nor mounting nor log": (
        lambda drive: [shutil.rmtree(drive / name) for name in ("calibration", "gnss")],
        r"has neither stereo_opencv\.yaml nor .*\. Also: .*run `fieldgrid mount .*\. Also: .* has "
        r"no GNSS log",
    ),
    "no overlap in time": (
        lambda drive: edit(drive / "frames.csv", ",13081338", ",13081438"),
        r"Images \(2011-06-15T13:16:59\.840Z to .*\) and fixes \(2011-06-15T10:30:.*\) do not "
        r"overlap in time; if it is the log .* give --time-offset -\d+ or .* otherwise choose the "
        r"log of this drive with --gnss",
    ),
    "no log": (
        lambda drive: (drive / "gnss" / "gnss_rtk.nmea").unlink(),
        r"has no GNSS log, .*put the log of this drive into its folder gnss/, name it with",
    ),
    "no fix in the log": (without_fixes, "holds no position at all; .*--gnss"),
    "no frame": (
        lambda drive: (drive / "frames.csv").write_text("frame_id,timestamp_utc_s,left,right\n"),
        "has no stereo pair; a recording needs at least one",
    ),
    "left and right swapped": (
        swap_sides,
        r"with left and right exchanged, so the two are swapped, .* Swap the two folders",
    ),
    "several logs": (
        lambda drive: shutil.copy(TWO_LANES / "gnss" / "gnss_sf1.nmea", drive / "gnss"),
        r"has several GNSS logs: gnss_rtk\.nmea, gnss_sf1\.nmea; give --gnss NAME",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("mode", ["new", "append", "overwrite"])
def test_a_recording_with_a_fault(
    fault: str, mode: str, fieldgrid: Run, make_drive: MakeDrive, out: Path, two_lanes_map: Path
) -> None:
    spoil, message = FAULTS[fault]
    drive = make_drive()
    spoil(drive)
    flags = []
    if mode != "new":
        shutil.copy(two_lanes_map, out)
        flags = [f"--{mode}"]
    before = tree(out.parent)
    sentence = fieldgrid("build", drive, "-o", out, *flags).sentence()
    assert re.search(message, sentence), sentence
    assert tree(out.parent) == before


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (
            "--matcher orb",
            r"stereo\.matcher = 'orb' \(--matcher\) is not possible: .* 'sgbm3way', 'sgbm'",
        ),
        (
            "--transfer best",
            r"map\.transfer = 'best' \(--transfer\) is not possible: input .* 'centre' or 'area'",
        ),
        ("--heading north", "'north' is none of smooth, course, recorded, constant:DEG"),
        ("--heading auto", "'auto' is none of smooth, course, recorded, constant:DEG"),
        ("--heading constant:400", "'constant:400' is none of"),
        ("--heading recorded", "has a heading of its own; use --heading smooth"),
        ("--gnss nowhere.nmea", r"'nowhere\.nmea' is neither in .* has: gnss_rtk\.nmea"),
        ("--config nowhere.toml", r"nowhere\.toml cannot be read \(No such file or directory\)"),
        ("--cell 0.02", r"0\.02 m are smaller than the local cells of 0\.05 m"),
        (
            "--cell 0",
            r"map\.cell_m = 0\.0 \(--cell\) is not possible: .* be greater than 0",
        ),
        ("--cell nan", r"map\.cell_m = nan \(--cell\) is not possible"),
        ("--local-cell 0.07", r"width of 10\.0 m is not a whole number of cells of 0\.07 m"),
        ("--grid 0x0", r"width of 0\.0 m is outside 0\.05\.\.200 m"),
        ("--slice 2:1", r"slice from 2\.0 to 1\.0 m has no height"),
        ("--max-range -1", r"density\.max_range_m = -1\.0 \(--max-range\) is not possible"),
        ("--max-range inf", r"density\.max_range_m = inf \(--max-range\) is not possible"),
        ("--datum 99,0,0", r"latitude 99\.0 and longitude 0\.0 are not on Earth"),
        ("--datum 0,0,0", r"are 4\d\d\d km from the datum .*, over 50 km"),
        ("--append", r"There is no map .*m\.gpkg to append to; leave out --append to make it"),
        ("--append --overwrite", "--append and --overwrite exclude each other; give one of them"),
    ],
)
def test_values_that_cannot_be(
    flags: str, message: str, fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    sentence = fieldgrid("build", make_drive(), "-o", out, *flags.split()).sentence()
    assert re.search(message, sentence), sentence
    assert tree(out.parent) == {}


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("", "exists already; give another name, --append to add a session to it, or --overwrite"),
        ("--append --name two_lanes", "has a session 'two_lanes' already; .*--name"),
        ("--append --cell 0.25", r"has cells of 0\.05 m, not 0\.25 m"),
        ("--append --datum 41.65,-4.72,700", r"is 41\.65.* for good, not 41\.65.* 700\.000 m"),
        ("--append --local-cell 0.1", r"0\.05 m are smaller than the local cells of 0\.1 m"),
    ],
)
def test_an_existing_map_that_does_not_fit(
    flags: str, message: str, fieldgrid: Run, make_drive: MakeDrive, existing: Path
) -> None:
    before = tree(existing.parent)
    sentence = fieldgrid("build", make_drive(), "-o", existing, *flags.split()).sentence()
    assert re.search(message, sentence), sentence
    assert tree(existing.parent) == before


@pytest.mark.parametrize("content", [b"", b"my notes\n" * 200, b"SQLite format 3\x00" + b"x" * 500])
def test_appending_to_what_is_no_map(
    content: bytes, fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    out.write_bytes(content)
    sentence = fieldgrid("build", make_drive(), "-o", out, "--append").sentence()
    assert str(out) in sentence
    assert tree(out.parent) == {out.name: content}


def test_appending_to_another_program_s_database(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    connection = sqlite3.connect(out)
    connection.execute("CREATE TABLE contacts (name)")
    connection.commit()
    connection.close()
    before = tree(out.parent)
    assert "m.gpkg" in fieldgrid("build", make_drive(), "-o", out, "--append").sentence()
    assert tree(out.parent) == before


@pytest.mark.parametrize("flags", [[], ["--overwrite"], ["--append"]])
def test_a_folder_as_output(
    flags: list[str], fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    sentence = fieldgrid("build", make_drive(), "-o", out.parent, *flags).sentence()
    assert str(out.parent) in sentence
    assert tree(out.parent) == {}


def test_an_output_below_no_folder(fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    drive = make_drive()
    sentence = fieldgrid("build", drive, "-o", out.parent / "not" / "m.gpkg").sentence()
    assert "its folder does not exist; make it first" in sentence
    out.write_text("notes")
    sentence = fieldgrid("build", drive, "-o", out / "m.gpkg").sentence()
    assert str(out / "m.gpkg") in sentence
    assert tree(out.parent) == {out.name: b"notes"}


def test_what_is_no_regular_file_is_not_overwritten(
    fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    os.mkfifo(out)
    result = fieldgrid("build", make_drive(), "-o", out, "--overwrite")
    assert out.is_fifo()
    assert str(out) in result.sentence()


def test_a_link_to_a_map_stays_a_link(
    fieldgrid: Run, make_drive: MakeDrive, existing: Path
) -> None:
    link = existing.with_name("latest.gpkg")
    link.symlink_to(existing.name)
    fieldgrid("build", make_drive("new"), "-o", link, "--overwrite").output()
    assert link.is_symlink()
    with open_map(existing) as universal:
        assert [info.name for info in universal.sessions()] == ["new"]


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("nowhere", r"nowhere does not exist; give the folder of a recording"),
        ("frames.csv", r"frames\.csv lists the frames of a recording; give its folder\."),
        ("gnss", r"gnss is no recording; looked for one KITTI drive .*frames\.csv, or left/ and"),
    ],
)
def test_what_is_no_recording(
    path: str, message: str, fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    drive = make_drive()
    sentence = fieldgrid("build", drive, drive / path, "-o", out, "--fail-fast").sentence()
    assert re.search(message, sentence), sentence
    assert tree(out.parent) == {}


# --- the same in a process of its own, and what only that can show


@pytest.mark.long  # the sentence: `test_a_recording_with_a_fault`; a process: the folder below
def test_an_error_in_a_process_of_its_own(
    fieldgrid_process: Run, make_drive: MakeDrive, out: Path
) -> None:
    drive = make_drive()
    truncated_image(drive)
    result = fieldgrid_process("build", drive, "-o", out, "--json")
    assert "left/000004.jpg is truncated or damaged" in result.sentence()
    assert tree(out.parent) == {}


@contextmanager
def no_file_beyond(size: int) -> Iterator[None]:
    """What this process writes, only."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("mode", "room"),
    [
        pytest.param("new", 0, marks=pytest.mark.long),
        pytest.param("new", 60_000, marks=pytest.mark.long),
        ("new", 250_000),
        pytest.param("append", 0, marks=pytest.mark.long),
        ("append", 1),
    ],
)
def test_a_disk_with_too_little_room(
    mode: str,
    room: int,
    fieldgrid: Run,
    make_drive: MakeDrive,
    out: Path,
    two_lanes_map: Path,
) -> None:
    """No file may grow beyond `room` bytes, or an existing map beyond what it has."""
    flags = []
    if mode == "append":
        shutil.copy(two_lanes_map, out)
        flags = ["--append"]
        room *= out.stat().st_size + 20_000
    before = tree(out.parent)
    drive = make_drive(frames=range(19, 30, 2))
    with no_file_beyond(room):
        result = fieldgrid("build", drive, "-o", out, *flags, "--jobs", 1)
    assert str(out) in result.sentence()
    left = tree(out.parent)
    kept = {name for name in left if name.startswith("m.gpkg.work/")}
    assert bool(kept) == ("the same command with --resume goes on" in result.sentence())
    assert {name: data for name, data in left.items() if name not in kept} == before
    fieldgrid("build", drive, "-o", out, *flags, "--jobs", 1, "--resume").output()
    assert set(tree(out.parent)) == {"m.gpkg"}


def test_a_folder_that_may_not_be_written(
    fieldgrid_process: Run, make_drive: MakeDrive, out: Path
) -> None:
    prefix: tuple[str, ...] = ()
    if os.geteuid() == 0:  # whom no permission stops, unless that power is given up
        if shutil.which("setpriv") is None:
            pytest.skip("root without setpriv")
        prefix = ("setpriv", "--bounding-set=-dac_override,-dac_read_search")
    drive = make_drive()
    out.parent.chmod(0o555)
    try:
        result = fieldgrid_process("build", drive, "-o", out, prefix=prefix)
    finally:
        out.parent.chmod(0o755)
    sentence = result.sentence()
    assert "m.gpkg could not be written (Permission denied); check the folder" in sentence
    assert tree(out.parent) == {}


SIGNALLED = """
import os, signal
from pathlib import Path
from fieldgrid.pipeline.staging import shares

usual = shares.perceive_frame

def perceive_frame(*frame, **options):
    if any(Path({folder!r}).iterdir()):
        shares.perceive_frame = usual
        os.kill(os.getpid(), signal.{name})
    return usual(*frame, **options)

shares.perceive_frame = perceive_frame
"""
"""Python to run first in a build, which gets a signal with the first frame after it has begun to
write into a folder."""


def signalled(
    fieldgrid_process: Run, made_by: signal.Signals, make_drive: MakeDrive, out: Path
) -> Result:
    """A build that got a signal while it read its frames."""
    before = SIGNALLED.format(folder=str(out.parent), name=made_by.name)
    drive = make_drive(frames=range(3, 9))
    return fieldgrid_process("build", drive, "-o", out, "--jobs", 1, before=before)


def test_ctrl_c_is_answered_and_leaves_nothing(
    fieldgrid_process: Run, out: Path, make_drive: MakeDrive
) -> None:
    result = signalled(fieldgrid_process, signal.SIGINT, make_drive, out)
    assert result.status == 130
    assert result.out == ""
    assert result.err.startswith("fieldgrid: interrupted")
    assert "Traceback" not in result.err
    assert tree(out.parent) == {}


def test_a_terminated_build_leaves_nothing(
    fieldgrid_process: Run, out: Path, make_drive: MakeDrive
) -> None:
    result = signalled(fieldgrid_process, signal.SIGTERM, make_drive, out)
    assert result.status not in (0, 1, 2)
    assert tree(out.parent) == {}


# --- wrong use: exit status 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("build", "Invalid value for RECORDING...: it is needed, unless there is --repose"),
        ("build DRIVE", "Invalid value for --out: it is needed, unless there is --repose"),
        ("build DRIVE -o OUT --wrong", "No such option: --wrong"),
        ("build DRIVE -o OUT --every 0", "Invalid value for '--every'"),
        ("build DRIVE -o OUT --every two", "Invalid value for '--every'"),
        ("build DRIVE -o OUT --jobs 0", "Invalid value for '--jobs'"),
        ("build DRIVE -o OUT --skip-bad few", "'few' is neither a number of frames, as in 3, nor"),
        ("build DRIVE -o OUT --cell wide", "Invalid value for '--cell'"),
        ("build DRIVE -o OUT --grid 10", "value for --grid: '10' is not WxL, as in 10x15"),
        ("build DRIVE -o OUT --grid 1x5x2", "'1x5x2' is not WxL"),
        ("build DRIVE -o OUT --slice 1", "value for --slice: '1' is not BOTTOM:TOP, as in 0.2:2.2"),
        (
            "build DRIVE -o OUT --datum 41,2",
            "for --datum: '41,2' is not LAT,LON,HEIGHT, as in 41.65",
        ),
        ("build DRIVE -o OUT --datum a,b,c", "'a,b,c' is not LAT,LON,HEIGHT"),
        ("build DRIVE DRIVE -o OUT --name x", "--name is for a single recording"),
    ],
)
def test_wrong_use(
    arguments: str, message: str, fieldgrid: Run, make_drive: MakeDrive, out: Path
) -> None:
    places = {"DRIVE": str(make_drive()), "OUT": str(out)}
    usage = fieldgrid(*(places.get(word, word) for word in arguments.split())).usage()
    assert message in " ".join(usage.split())
    assert tree(out.parent) == {}


# --- names


@pytest.mark.parametrize("name", ["Riesling, Süd 3", "2024-06-03", "a 'b' \"c\"", "-"])
def test_names_of_sessions(name: str, fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    text = fieldgrid("build", make_drive(), "-o", out, "--name", name).output()
    assert text.startswith(f"session {name}")
    with open_map(out) as universal:
        assert [info.name for info in universal.sessions()] == [name]


def test_a_name_that_cannot_be_printed(fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    sentence = fieldgrid("build", make_drive(), "-o", out, "--name", "a\nb").sentence()
    assert r"cannot be called 'a\nb'; give a printable name" in sentence
    assert tree(out.parent) == {}


def test_an_empty_name(fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    assert "printable name" in fieldgrid("build", make_drive(), "-o", out, "--name", "").sentence()


@pytest.mark.parametrize("name", ["lane [north] 3", "lane [/b] 3"])
def test_a_name_with_brackets(name: str, fieldgrid: Run, make_drive: MakeDrive, out: Path) -> None:
    text = fieldgrid("build", make_drive(), "-o", out, "--name", name).output()
    assert text.startswith(f"session {name}")


def test_a_map_made_by_the_command_is_the_map_of_the_function(
    fieldgrid: Run, two_lanes_map: Path, out: Path
) -> None:
    fieldgrid("build", TWO_LANES, "-o", out, "--gnss", "gnss_rtk.nmea").output()
    bounds = Bounds(-10.0, 50.0, 0.0, 60.0)
    with open_map(out) as one, open_map(two_lanes_map) as other:
        np.testing.assert_array_equal(one.read(bounds).density, other.read(bounds).density)


# --- on a cluster


def test_a_scheduler_that_is_not_there_is_told_before_anything_is_done(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "CONNECT_S", 0.2)
    drive = make_drive()
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        said = fieldgrid("build", drive, "-o", tmp_path / "m.gpkg", "--scheduler", address)
    assert f"No Dask scheduler answers at {address} (" in said.sentence()
    assert "start one there with: dask scheduler, or check" in said.sentence()
    assert [path.name for path in tmp_path.iterdir()] == ["drive"]


@pytest.mark.parametrize(
    "answer",
    [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"-ERR wrong number of arguments\r\n"],
)
def test_another_program_at_the_address_of_the_scheduler_is_told(
    answer: bytes,
    fieldgrid: Run,
    make_drive: MakeDrive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("distributed")
    if not answer:
        monkeypatch.setattr(connecting, "CONNECT_S", 0.3)
    drive, taken = make_drive(), []

    def serve() -> None:
        with suppress(OSError):  # the server is closed
            while True:
                taken.append(server.accept()[0])
                taken[-1].recv(1)
                taken[-1].sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as opened:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        said = fieldgrid("build", drive, "-o", tmp_path / "m.gpkg", "--scheduler", address)
        for one in taken:
            opened.enter_context(one)
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
    why = "another program does" if answer else "TimeoutError"
    assert f"No Dask scheduler answers at {address} ({why})" in said.sentence()
    assert [path.name for path in tmp_path.iterdir()] == ["drive"]


def test_without_dask_the_way_to_get_it_is_told(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    said = fieldgrid("build", make_drive(), "-o", tmp_path / "m.gpkg", "--scheduler", "tcp://a:1")
    assert "is not installed; run: pip install 'fieldgrid[dask]'" in said.err
    assert said.status == 1


def test_jobs_and_a_scheduler_exclude_each_other(fieldgrid: Run, tmp_path: Path) -> None:
    out = tmp_path / "m.gpkg"
    said = fieldgrid("build", "drive", "-o", out, "--jobs", 2, "--scheduler", "tcp://a:1")
    assert "the workers of the --scheduler do the work" in said.usage()
    with pytest.raises(ConfigError, match="leave out --jobs"):
        build_map([tmp_path], out, BuildSettings(), jobs=2, scheduler="tcp://a:1")


@pytest.fixture
def gone(monkeypatch: pytest.MonkeyPatch) -> str:
    """A cluster that has staged all drives, and is gone when they are compared."""
    build, align = fieldgrid_pipeline.build_map, fieldgrid_field.align_map

    def built(*given: Any, scheduler: str, **more: Any) -> Any:
        return build(*given, **more)

    def compared(*given: Any, scheduler: str | None, **more: Any) -> Any:
        if scheduler is not None:
            raise ClusterError(f"The Dask scheduler {scheduler} is gone; start it again.")
        return align(*given, **more)

    monkeypatch.setattr(fieldgrid_pipeline, "build_map", built)
    monkeypatch.setattr(fieldgrid_field, "align_map", compared)
    return "tcp://127.0.0.1:1"


def test_drives_that_cannot_be_aligned_on_the_cluster_are_reported(
    fieldgrid: Run, make_drive: MakeDrive, out: Path, gone: str
) -> None:
    drives = [make_drive("june-03"), make_drive("june-10", range(3, 7))]
    asked = "build", *drives, "-o", out, "--overwrite", "--scheduler", gone
    assert fieldgrid(*asked).status == 0  # nothing is compared there
    result = fieldgrid(*asked, "--align")
    assert result.status == 1
    assert "session june-10" in result.out
    assert f"map {out}" in result.out
    assert "nothing was aligned" not in result.out
    assert f"fieldgrid: The Dask scheduler {gone} is gone; start it again.\n" in result.err
    broken = make_drive("june-17", range(40, 43))
    (broken / "left" / "000041.jpg").unlink()
    (broken / "left" / "000041.jpg").write_bytes(b"no image")
    result = fieldgrid("build", broken, *asked[1:], "--align", "--json")
    assert result.status == 1
    told = json.loads(result.out)
    assert [one["session"] for one in told["sessions"]] == ["june-03", "june-10"]
    assert [one["session"] for one in told["failed"]] == ["june-17"]
    assert "is gone; start it again." in result.err
    assert "fieldgrid: 2 of 3 drives are in the map. june-17: " in result.err


def test_cells_of_centimetres_given_as_metres_are_asked_about(
    fieldgrid: Run, out: Path, make_drive: MakeDrive
) -> None:
    build = ("build", make_drive(), "-o", out, "--cell", "5")
    assert "--cell 0.05" in fieldgrid(*build).sentence()
    assert tree(out.parent) == {}
    fieldgrid(*build, "--accept", "coarse-cells").output()


def test_a_map_is_built_without_settings(out: Path, make_drive: MakeDrive) -> None:
    (report,) = build_map([make_drive()], out)
    with open_map(out) as universal:
        assert [one.name for one in universal.sessions()] == [report.session]
