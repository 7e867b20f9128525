"""`fieldgrid track` as a user meets it: the table, what it prints, and how it fails."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import statistics
import sys
from pathlib import Path

import cv2
import pytest

from fieldgrid.poses.track.table import COLUMNS
from tests.cli.conftest import Run, a_terminal
from tests.conftest import TWO_LANES

RTK = TWO_LANES / "gnss" / "gnss_rtk.nmea"
SF1_LOG = RTK.with_name("gnss_sf1.nmea")
SF1 = ("--gnss", "gnss_sf1.nmea")
KEYS = {
    *("track", "figure", "drive", "gnss", "datum", "heading_source", "fixes", "ok", "held"),
    *("repeated", "rejected", "reasons", "duration_s", "distance_m"),
    *("forward_s", "reverse_s", "standing_s"),
    *("reversals", "heading_sigma_deg", "position_sigma_m", "conditioning", "recorded_heading"),
    *("clock_offset", "clock_change", "camera_contradiction", "camera_yaw"),
    *("gyro_bias_dps", "fix_offset", "camera_scale", "wheel_scale", "findings"),
    *("attitude", "georeference", "unseen"),
}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A name for a table, in a folder of its own."""
    (tmp_path / "out").mkdir()
    return tmp_path / "out" / "track.csv"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        table = csv.DictReader(file)
        found = list(table)
    assert tuple(table.fieldnames or ()) == COLUMNS
    return found


# --- when all is well


def test_the_table_of_a_recording(fieldgrid: Run, out: Path) -> None:
    text = fieldgrid("track", TWO_LANES, "-o", out, *SF1).output()
    lines = [line.rstrip() for line in text.splitlines()]
    assert lines[0] == "track two_lanes"
    assert lines[-1] == f"track {out}"
    found = rows(out)
    times = [int(row["time_ns"]) for row in found]
    assert times == sorted(times)
    assert re.search(rf"^fixes +{len(found)}$", text, re.MULTILINE)
    rejected = [row for row in found if row["status"] == "rejected"]
    assert re.search(rf"^written twice / rejected +0 / {len(rejected)}$", text, re.MULTILINE)
    assert all(row["reason"] for row in rejected)
    assert {row["status"] for row in found} == {"ok", "held", "rejected"}
    assert {row["gear"] for row in found} == {"1", "0", "-1"}
    assert re.search(r"^rejected \d+: HDOP \d+(\.\d+)? > 4$", text, re.MULTILINE)
    assert re.search(r"^datum: .* 41\.65, -4\.72, 787\.4$", text, re.MULTILINE)
    assert re.search(r"^gyro bias +-?\d\.\d{3} °/s$", text, re.MULTILINE)
    assert "info note: gnss_sf1.nmea: 6 damaged sentences skipped." in lines
    unseen = next(line for line in lines if line.startswith("info unseen: "))
    assert "farther left or right than declared or a receiver that drifts slowly" in unseen


def test_no_image_is_needed(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    """A folder of gnss/ and imu/ alone, with or without the calibration of a rig."""
    folder = tmp_path / "june-03"
    for name in ("gnss", "imu"):
        shutil.copytree(TWO_LANES / name, folder / name)
    bare = json.loads(fieldgrid("track", folder, "-o", out, *SF1, "--json").output())
    assert (bare["drive"], bare["gnss"]) == ("june-03", "gnss/gnss_sf1.nmea")
    assert bare["gyro_bias_dps"] is not None
    antenna = rows(out)
    shutil.copytree(TWO_LANES / "calibration", folder / "calibration")
    fieldgrid(
        "track", folder, "-o", out, "--overwrite", *SF1, "--datum", "41.65,-4.72,787.4"
    ).output()
    # With the rig, poses are those of the ground below the camera, not of the antenna.
    # Heights are smoothed where the lean is known, so the fixes' own noise lies between the two.
    height_m = [
        float(bare["height_m"]) - float(rigged["height_m"])
        for bare, rigged in zip(antenna, rows(out), strict=True)
        if bare["status"] == rigged["status"] == "ok"
    ]
    assert len(height_m) > 200
    assert statistics.median(height_m) == pytest.approx(2.65 + 0.35, abs=0.01)
    assert statistics.pstdev(height_m) < 0.1


def test_a_log_alone(fieldgrid: Run, out: Path) -> None:
    text = fieldgrid("track", RTK, "-o", out).output()
    assert text.startswith("track gnss_rtk")
    assert "gyro bias" not in text
    first, *_ = rows(out)
    # Its datum is its first fix, and its poses are the antenna's.
    assert abs(float(first["east_m"])) < 0.2
    assert abs(float(first["north_m"])) < 0.2
    assert float(first["lat_deg"]) == pytest.approx(41.65038, abs=1e-4)


def test_the_summary_without_a_table(fieldgrid: Run, out: Path) -> None:
    printed = fieldgrid("track", RTK, "-o", out).output()
    table, last = printed.rstrip().rsplit("\n", 1)
    assert last == f"track {out}"
    before = set(out.parent.iterdir())
    assert fieldgrid("track", RTK).output().rstrip() == table
    assert json.loads(fieldgrid("track", RTK, "--json").output())["track"] is None
    assert set(out.parent.iterdir()) == before


def test_json_is_one_object_and_nothing_else(fieldgrid: Run, out: Path) -> None:
    result = json.loads(fieldgrid("track", TWO_LANES, "-o", out, *SF1, "--json").output())
    assert set(result) == KEYS
    assert result["track"] == str(out)
    assert result["figure"] is None
    assert result["drive"] == "two_lanes"
    assert result["gnss"] == "gnss/gnss_sf1.nmea"
    assert result["datum"] == {"lat_deg": 41.65, "lon_deg": -4.72, "height_m": 787.4}
    assert result["fixes"] == len(rows(out))
    kinds = ("ok", "held", "repeated", "rejected")
    assert result["fixes"] == sum(result[kind] for kind in kinds)
    assert sum(reason["fixes"] for reason in result["reasons"]) == result["rejected"]
    assert result["reversals"] == 2
    assert result["heading_sigma_deg"]["median"] < result["heading_sigma_deg"]["p95"]
    assert "gnss_sf1.nmea: 6 damaged sentences skipped." in [
        one["message"] for one in result["findings"]
    ]


def test_a_drive_of_which_no_pose_can_be_used_exits_with_1(
    fieldgrid: Run, tmp_path: Path, out: Path
) -> None:
    """The track is written with its reasons, and a remedy is named."""
    log = tmp_path / "still.csv"
    lines = (f"{1_700_000_000 + k},48.1,11.5,400,4" for k in range(60))
    log.write_text("\n".join(("time,lat,lon,height,quality", *lines)))
    result = fieldgrid("track", log, "-o", out)
    assert result.status == 1
    assert "No pose can be used, mostly because: heading unknown" in result.out
    assert "Log while the vehicle drives, or record its heading" in result.out
    assert {row["status"] for row in rows(out)} == {"rejected"}


def test_what_is_known_of_a_drive_can_be_said(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    """The receiver's accuracy or quality, the gear at the start, and gears of spans."""
    stated = json.loads(fieldgrid("track", SF1_LOG, "-o", out, "--json").output())
    better = json.loads(
        fieldgrid(
            "track", SF1_LOG, "-o", out, "--overwrite", "--accuracy", "0.1", "--json"
        ).output()
    )
    assert better["position_sigma_m"]["median"] < 0.5 * stated["position_sigma_m"]["median"]
    float_too = json.loads(
        fieldgrid(
            "track",
            SF1_LOG,
            "-o",
            out,
            "--overwrite",
            "--quality",
            "rtk-float",
            "--json",
        ).output()
    )
    assert set(
        float_too["quality"] if "quality" in float_too else float_too["conditioning"]["quality"]
    ) == {"RTK float"}
    first = fieldgrid("track", SF1_LOG, "-o", out, "--overwrite", "--starts", "reverse", "--json")
    assert json.loads(first.output())["reverse_s"] > json.loads(first.out)["forward_s"]
    times = [int(row["time_ns"]) for row in rows(out)]
    gears = tmp_path / "gears.csv"
    gears.write_text(f"from,to,gear\n{times[0] - 1},{times[-1]},forward\n")
    known = fieldgrid("track", SF1_LOG, "-o", out, "--overwrite", "--gear", gears, "--json")
    assert json.loads(known.output())["reverse_s"] < 0.5 * stated["reverse_s"]
    wrong = fieldgrid("track", SF1_LOG, "-o", out, "--overwrite", "--quality", "superb")
    assert wrong.status == 1
    assert "there is no quality 'superb' of a fix; give one of" in wrong.err


@pytest.mark.parametrize("suffix", ["gpx", "geojson", "tum"])
def test_a_track_for_other_programs(suffix: str, fieldgrid: Run, tmp_path: Path) -> None:
    path = tmp_path / f"track.{suffix}"
    assert str(path) in fieldgrid("track", RTK, "-o", path).output()
    assert path.stat().st_size > 1000
    wrong = fieldgrid("track", RTK, "-o", tmp_path / "track.kml")
    assert wrong.status == 1
    assert "ends in none of .csv, .gpx, .geojson, .tum" in wrong.err


def test_the_datum_can_be_given(fieldgrid: Run, out: Path) -> None:
    text = fieldgrid("track", RTK, "-o", out, "--datum", "41.6501,-4.7201,780", "--json").output()
    assert json.loads(text)["datum"] == {"lat_deg": 41.6501, "lon_deg": -4.7201, "height_m": 780.0}
    assert float(rows(out)[0]["north_m"]) == pytest.approx(31.4, abs=0.5)


@pytest.mark.parametrize("source", ["course", "constant:-143"])
def test_the_heading_can_be_chosen(source: str, fieldgrid: Run, out: Path) -> None:
    arguments = ("track", TWO_LANES, "-o", out, "--gnss", RTK.name, "--heading", source, "--json")
    assert json.loads(fieldgrid(*arguments).output())["heading_source"] == source
    if source != "course":
        assert {row["heading_deg"] for row in rows(out)} == {"-143.000"}


def test_columns_can_be_named(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    log = tmp_path / "hof.csv"
    lines = [f"{1_308_133_811 + k / 5:.1f},{41.65 + 3e-6 * k:.9f},-4.72,4" for k in range(60)]
    log.write_text("\n".join(["Zeit,Breite,Laenge,Guete", *lines]) + "\n")
    mapping = "time=Zeit,time_units=s,lat=Breite,lon=Laenge,quality=Guete"
    fieldgrid("track", log, "-o", out, "--columns", mapping).output()
    assert len(rows(out)) == 60
    assert float(rows(out)[30]["heading_deg"]) == pytest.approx(0.0, abs=1.0)


def test_settings_reach_the_verdicts(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    config = tmp_path / "strict.toml"
    config.write_text("[pose]\nmax_heading_sigma_deg = 0.01\n")
    refused = fieldgrid("track", RTK, "-o", out, "--config", config)
    text = refused.out
    assert refused.status == 1
    assert {row["status"] for row in rows(out)} == {"rejected"}
    assert re.search(r"^rejected \d+: heading sigma .* > 0\.01°$", text, re.MULTILINE)
    assert re.search(r"^heading sigma, median / 95 % \(smooth\) +-$", text, re.MULTILINE)


@pytest.mark.parametrize("end", ["png", "svg", "PDF"])
def test_a_figure_beside_the_table(end: str, fieldgrid: Run, out: Path) -> None:
    figure = out.with_name(f"track.{end}")
    text = fieldgrid("track", RTK, "-o", out, "--figure", figure).output()
    assert text.endswith(f"track {out}\nfigure {figure}\n")
    assert sorted(os.listdir(out.parent)) == sorted([out.name, figure.name])
    if end == "png":
        picture = cv2.imread(str(figure))
        assert picture is not None
        assert picture.shape[1] > picture.shape[0] > 700
        assert picture.min() < 60


def test_a_second_track_replaces_the_first(fieldgrid: Run, out: Path) -> None:
    fieldgrid("track", RTK, "-o", out).output()
    once = out.read_bytes()
    assert str(out) in fieldgrid("track", RTK, "-o", out).sentence()
    fieldgrid("track", RTK, "-o", out, "--overwrite").output()
    assert out.read_bytes() == once  # the same drive, the same bits


# --- when something is wrong


def test_a_path_that_is_not_there(fieldgrid: Run, out: Path) -> None:
    sentence = fieldgrid("track", "nowhere", "-o", out).sentence()
    assert sentence == (
        "nowhere does not exist; give the folder of a recording, a bag, or a GNSS log."
    )


def test_a_folder_that_holds_no_drive(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    (tmp_path / "photos").mkdir()
    sentence = fieldgrid("track", tmp_path / "photos", "-o", out).sentence()
    assert "photos is no recording; looked for" in sentence


def test_an_empty_log(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    (tmp_path / "empty.nmea").touch()
    sentence = fieldgrid("track", tmp_path / "empty.nmea", "-o", out).sentence()
    assert "holds no position at all" in sentence
    assert os.listdir(out.parent) == []


def test_a_folder_without_a_log(fieldgrid: Run, tmp_path: Path, out: Path) -> None:
    (tmp_path / "drive" / "gnss").mkdir(parents=True)
    sentence = fieldgrid("track", tmp_path / "drive", "-o", out).sentence()
    assert sentence.startswith("drive has no GNSS log, without which nothing can be placed; ")


def test_several_logs(fieldgrid: Run, out: Path) -> None:
    sentence = fieldgrid("track", TWO_LANES, "-o", out).sentence()
    assert "several GNSS logs: gnss_rtk.nmea, gnss_sf1.nmea; give --gnss NAME" in sentence


def test_a_log_in_which_nothing_can_be_picked(fieldgrid: Run, out: Path) -> None:
    sentence = fieldgrid("track", RTK, "-o", out, "--gnss", "x.nmea").sentence()
    assert "is a log already, in which none can be picked; leave --gnss out" in sentence


def test_the_log_itself_is_never_replaced(fieldgrid: Run, tmp_path: Path) -> None:
    log = tmp_path / "rtk.csv"
    shutil.copy(RTK, log)
    before = log.read_bytes()
    sentence = fieldgrid("track", log, "-o", log).sentence()
    assert "rtk.csv exists already and is no track" in sentence
    assert log.read_bytes() == before
    assert list(tmp_path.iterdir()) == [log]


@pytest.mark.parametrize("place", ["not/track.csv", "folder.csv"])
def test_a_place_that_cannot_be_written(place: str, fieldgrid: Run, out: Path) -> None:
    (out.parent / "folder.csv").mkdir()
    assert "folder" in fieldgrid("track", RTK, "-o", out.parent / place).sentence()
    assert os.listdir(out.parent) == ["folder.csv"]


def test_a_datum_of_another_country(fieldgrid: Run, out: Path) -> None:
    sentence = fieldgrid("track", RTK, "-o", out, "--datum", "52,13,40").sentence()
    assert "km from the datum 52.0" in sentence
    assert "over 50 km; build a map of its own" in sentence
    assert os.listdir(out.parent) == []


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--heading", "east", "'east' is none of smooth, course, recorded, constant:DEG"),
        ("--columns", "lat", "'lat' is not KEY=COLUMN"),
        ("--config", "none.toml", "none.toml cannot be read"),
        ("--heading", "recorded", "has a heading of its own"),
    ],
)
def test_values_that_cannot_be(
    option: str, value: str, message: str, fieldgrid: Run, out: Path
) -> None:
    assert message in fieldgrid("track", RTK, "-o", out, option, value).sentence()
    assert os.listdir(out.parent) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "Missing argument 'RECORDING|LOG'"),
        ((RTK, "-o", "t.csv", "--figure", "t.txt"), "t.txt ends in none of .png, .svg, .pdf"),
        ((RTK, "-o", "t.csv", "--datum", "41"), "'41' is not LAT,LON,HEIGHT"),
    ],
)
def test_wrong_use(arguments: tuple[object, ...], message: str, fieldgrid: Run) -> None:
    assert message in " ".join(fieldgrid("track", *arguments).usage().split())


# --- poses of another program


def test_given_poses(fieldgrid: Run, out: Path) -> None:
    """A track that was written, read back by its fixes and where it is declared."""
    tum, rtk = out.with_suffix(".tum"), ("--gnss", "gnss_rtk.nmea")
    fieldgrid("track", TWO_LANES, "-o", tum, *rtk).output()
    text = fieldgrid("track", TWO_LANES, "-o", out, *rtk, "--poses", tum).output()
    assert re.search(r"^heading of the poses' frame \(fixes\) +\d\d\.\d\d ± 0\.\d\d °$", text, re.M)
    assert re.search(r"^poses minus 437 fixes, median / 95 % / most +0\.0\d\d / ", text, re.M)
    assert "info note: The poses are 437 of track.tum, body axes flu, frame z up." in text
    again = out.with_name("again.tum")
    frame = ("--frame-origin", "41.65,-4.72,787.4", "--frame-heading", "90")
    told = fieldgrid("track", TWO_LANES, "-o", again, *rtk, "--poses", tum, *frame, "--json")
    found = json.loads(told.output())
    assert (found["heading_source"], found["georeference"]["by"]) == ("given poses", "declared")
    one, two = (
        [line.split() for line in path.read_text().splitlines()[1:]] for path in (tum, again)
    )
    assert [row[0] for row in one] == [row[0] for row in two]
    off = [
        abs(float(a) - float(b))
        for p, q in zip(one, two, strict=True)
        for a, b in zip(p, q, strict=True)
    ]
    assert max(off) < 1e-3


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--poses", "nowhere.tum"), "nowhere.tum cannot be read: No such file"),
        (("--poses-axes", "rdf"), "give --poses FILE"),
        (("--frame-heading", "90"), "give --poses FILE with the heading smooth"),
        (("--poses", RTK), "a line; give a trajectory of TUM"),
    ],
)
def test_poses_that_cannot_be(
    options: tuple[object, ...], sentence: str, fieldgrid: Run, out: Path
) -> None:
    rtk = ("--gnss", "gnss_rtk.nmea")
    assert sentence in fieldgrid("track", TWO_LANES, "-o", out, *rtk, *options).sentence()
    assert not out.exists()


@pytest.mark.parametrize(
    ("flag", "value"),
    [("--poses-point", "1,2"), ("--poses-offset", "nan"), ("--poses-offset", "soon")],
)
def test_flags_of_poses(flag: str, value: str, fieldgrid: Run, out: Path) -> None:
    told = fieldgrid("track", TWO_LANES, "-o", out, "--poses", "a.tum", flag, value).usage()
    assert flag in told


# --- on a terminal


@pytest.mark.parametrize("quiet", [False, True])
def test_a_long_log_is_not_silent(
    quiet: bool, fieldgrid: Run, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On stderr alone, where a terminal watches; `--quiet` says nothing there."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with a_terminal() as (stream, shown), monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", stream)
        text = fieldgrid("track", RTK, "-o", out, *(["--quiet"] if quiet else [])).output()
    assert "reading and estimating" not in text
    assert (b"gnss_rtk.nmea: reading and estimating" in b"".join(shown)) is not quiet


@pytest.mark.parametrize("start", ["20", "2011-06-15T10:30:31Z"])
def test_a_part_of_a_drive(start: str, fieldgrid: Run) -> None:
    asked = ("track", RTK, "--from", start, "--json", "--until")
    assert json.loads(fieldgrid(*asked, "50").output())["fixes"] == 150
    assert "Invalid value for --until" in fieldgrid(*asked, "soon").usage()


def test_rows_that_are_written_twice_are_no_loss(fieldgrid: Run, tmp_path: Path) -> None:
    """A log of 20 Hz of a receiver that solves at 10 Hz."""
    log = tmp_path / "log.csv"
    lines = ["time,lat,lon,height,quality"]
    for k in range(400):
        place = k // 2 * 2
        lat = 48.1 + 1e-6 * place + 1e-8 * (place * 79 % 17)
        lines.append(f"{1_700_000_000 + 0.05 * k:.2f},{lat:.8f},11.5,400,4")
    log.write_text("\n".join(lines))
    told = json.loads(fieldgrid("track", log, "--json").output())
    assert (told["repeated"], told["rejected"], told["reasons"]) == (200, 0, [])


def test_a_column_of_times_is_known_by_its_values(fieldgrid: Run, tmp_path: Path) -> None:
    """A name that says nothing; a number that does not rise is no time."""
    log = tmp_path / "log.csv"
    lines = ["serial,clock,lat,lon,height,quality"]
    for k in range(100):
        lines.append(f"1500000000,{1477388576.379 + k:.3f},{48.1 + 1e-5 * k:.7f},11.5,400,4")
    log.write_text("\n".join(lines))
    out = tmp_path / "track.csv"
    text = fieldgrid("track", log, "-o", out).output()
    assert "time from 'clock' (s since 1970)" in text
    assert rows(out)[0]["time_ns"] == "1477388576379000000"
    log.write_text("\n".join(line.replace("1477388576", "147") for line in lines))
    assert "no column with UTC times" in fieldgrid("track", log, "-q").sentence()
