"""`fieldgrid inspect` as a user meets it, and the options that it shares with others."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from fieldgrid.cli import output
from fieldgrid.pipeline import inspect_recording
from tests.cli.conftest import Run
from tests.conftest import TWO_LANES
from tests.pipeline.inspection.broken import FEW, RTK, copy_of

LOG = ("--gnss", RTK)


@pytest.fixture
def few(tmp_path: Path) -> Path:
    """Some frames of the example."""
    return copy_of(tmp_path / "few", FEW)


def test_the_tables_of_a_sound_drive(fieldgrid: Run, few: Path) -> None:
    text = fieldgrid("inspect", few).output()
    lines = [line.rstrip() for line in text.splitlines()]
    assert lines[0] == "inspect few"
    assert lines[-1] == f"inspect {few}: a build would succeed"
    for told in (
        "plain folder",
        "640 x 480 px, f 905.4 px, baseline 0.180 m",
        "2.65 m, 16.0°, 0.0°, 0.0°",
        "frames with a usable pose",
        "100.00 Hz",
    ):
        assert told in text
    assert "\nerror " not in text


def test_json_is_what_the_function_gives(fieldgrid: Run, few: Path) -> None:
    told = json.loads(fieldgrid("inspect", few, "--json").output())
    assert told.pop("figure") is None
    expected = json.loads(json.dumps(inspect_recording(few).as_dict()))
    assert told == output.with_texts(expected)
    assert told["builds"] is True
    assert {finding["severity"] for finding in told["findings"]} <= {"warning", "info"}
    roles = {stream["role"]: stream for stream in told["streams"]}
    assert roles["fix"]["rate_hz"] == pytest.approx(5.0)
    assert roles["left"]["messages"] == len(FEW)


def test_a_drive_that_would_not_build(fieldgrid: Run, tmp_path: Path) -> None:
    folder = copy_of(tmp_path / "late", FEW, moved_s=7200.0)
    result = fieldgrid("inspect", folder)
    assert (result.status, result.err.count("fieldgrid: a build of")) == (1, 1)
    assert "error no-overlap: " in result.out
    assert "--time-offset -7200" in result.out
    assert result.out.rstrip().endswith("a build would fail")
    again = fieldgrid("inspect", folder, "--time-offset", "-7200", "--json")
    assert json.loads(again.output())["declared_offset_s"] == -7200.0


def test_what_cannot_be_opened_is_json_too(fieldgrid: Run, tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        result = fieldgrid("inspect", path, "--json")
        assert (result.status, result.err.count("fieldgrid: a build of")) == (1, 1)
        told = json.loads(result.out)
        assert told["builds"] is False
        assert [finding["severity"] for finding in told["findings"]] == ["error"]
    result = fieldgrid("inspect", TWO_LANES)
    assert result.status == 1
    assert "several GNSS logs" in result.out


def test_a_log_alone(fieldgrid: Run) -> None:
    result = fieldgrid("inspect", TWO_LANES / "gnss" / RTK, "--json")
    assert (result.status, result.err.count("fieldgrid: a build of")) == (1, 1)
    told = json.loads(result.out)
    assert told["kind"] == "GNSS log"
    assert told["fixes"]["accepted"] == 437
    assert told["findings"][0]["code"] == "no-images"
    assert told["findings"][0]["severity"] == "error"


def test_a_figure(fieldgrid: Run, few: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.png"
    assert f"figure {out}" in fieldgrid("inspect", few, "--figure", out).output()
    image = cv2.imread(str(out))
    assert image is not None
    assert image.std() > 10.0
    assert "ends in none of" in fieldgrid("inspect", few, "--figure", "x.bmp").usage()


# --- options that several commands share


@pytest.mark.parametrize("command", ["inspect", "track", "build"])
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--topic", "left"), "'left' is not ROLE=TOPIC"),
        (("--topic", "left=/a", "--topic", "left=/b"), "left is given twice"),
        (("--time-offset", "nan"), "is no number of seconds"),
        (("--time-offset", "1e300"), "is no number of seconds"),
        (("--gnss-offset", "inf"), "is no number of seconds"),
    ],
)
def test_options_that_are_wrong(
    fieldgrid: Run, tmp_path: Path, command: str, options: tuple[str, ...], told: str
) -> None:
    out = () if command == "inspect" else ("-o", tmp_path / "out.gpkg")
    assert told in " ".join(fieldgrid(command, TWO_LANES, *LOG, *out, *options).usage().split())


@pytest.mark.parametrize("command", ["track", "build"])
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--topic", "left=/a"), "is no bag and has no topics"),
        (("--topic", "middle=/a"), "'middle' is nothing that a topic can be"),
        (("--time-offset", "2e9"), "An image time offset of 2000000000.0 s is beyond 40 years"),
        (("--gnss-offset", "-2e9"), "A GNSS time offset of -2000000000.0 s is beyond 40 years"),
        (("--mounting", "nowhere.json"), "nowhere.json cannot be read"),
    ],
)
def test_options_reach_the_recording(
    fieldgrid: Run, few: Path, tmp_path: Path, command: str, options: tuple[str, ...], told: str
) -> None:
    out = {"track": "out.csv", "build": "out.gpkg"}[command]
    result = fieldgrid(command, few, "-o", tmp_path / out, *options)
    assert told in result.sentence()


def test_a_log_takes_no_mounting(fieldgrid: Run, few: Path, tmp_path: Path) -> None:
    log = TWO_LANES / "gnss" / RTK
    result = fieldgrid("track", log, "-o", tmp_path / "t.csv", "--time-offset", "1")
    assert "no recording with images; leave --time-offset out" in result.sentence()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--time-offset", "1"), ("no recording with images.", "Leave --time-offset out.")),
        (("--mounting", "m.json"), ("no recording with images.", "Leave --mounting out.")),
        (("--topic", "fix=/fix"), ("no bag and has no topics.", "Leave --topic fix out.")),
    ],
)
def test_inspect_refuses_for_a_log_what_track_does(
    fieldgrid: Run, options: tuple[str, ...], told: tuple[str, str]
) -> None:
    result = fieldgrid("inspect", TWO_LANES / "gnss" / RTK, *options, "--json")
    assert (result.status, result.err.count("fieldgrid: a build of")) == (1, 1)
    (one,) = json.loads(result.out)["findings"]
    assert one["message"].endswith(told[0])
    assert one["remedy"] == told[1]


def test_build_says_what_would_bring_images_and_fixes_together(
    fieldgrid: Run, tmp_path: Path
) -> None:
    folder = copy_of(tmp_path / "late", FEW, moved_s=-3600.0)
    out = tmp_path / "map.gpkg"
    sentence = fieldgrid("build", folder, "-o", out).sentence()
    assert "images were 3600 s later (1 h is that of a time zone" in sentence
    assert "give --time-offset 3600 or image_time_offset_s = 3600" in sentence
    assert not out.exists()
    text = fieldgrid("build", folder, "-o", out, "--time-offset", "3600").output()
    assert "frames used" in text


def test_build_refuses_gps_time(fieldgrid: Run, tmp_path: Path) -> None:
    folder = copy_of(tmp_path / "gps", range(50), moved_s=15.0)
    sentence = fieldgrid("build", folder, "-o", tmp_path / "map.gpkg").sentence()
    assert "stamped +15.000 s" in sentence
    assert "GPS time is 15 s ahead of UTC, so the images carry GPS time" in sentence
    assert "Add -15.0" in sentence
    assert not (tmp_path / "map.gpkg").exists()


def test_another_mounting(fieldgrid: Run, few: Path, tmp_path: Path) -> None:
    own = few / "calibration" / "mounting.json"
    other = tmp_path / "other.json"
    other.write_text(own.read_text().replace("2.65", "2.75", 1))
    told = json.loads(fieldgrid("inspect", few, "--mounting", other, "--json").output())
    assert told["rig"]["mount"]["height_m"] == 2.75
