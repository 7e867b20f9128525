"""The commands that read a map: show, export, evaluate, sessions; and the command line itself."""

from __future__ import annotations

import importlib.metadata
import json
import re
import shlex
import shutil
import sqlite3
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import pytest

from fieldgrid.cli.listing import COMMANDS, load
from fieldgrid.maps import AlignmentRecord, Transform, open_map
from tests.cli.conftest import Run, in_a_process
from tests.conftest import TWO_LANES

MakeDrive = Callable[..., Path]
TRUTH = TWO_LANES / "truth"
READERS = ["show", "export", "evaluate", "sessions", "verify", "query", "diff", "merge"]


def commands() -> dict[str, Any]:
    return {name: load(name) for name in COMMANDS}


# --- the command line itself


def test_the_commands_there_are(fieldgrid: Run) -> None:
    text = fieldgrid("--help").output()
    assert {"build", "sessions", "show", "export", "evaluate"} <= set(commands())
    assert {"diff", "query", "merge", "verify", "repair"} <= set(commands())
    for name in commands():
        assert re.search(rf"^  {name} +[A-Z]", text, re.MULTILINE)


@pytest.mark.parametrize("name", sorted(commands()))
def test_every_command_has_help_with_an_example(name: str, fieldgrid: Run) -> None:
    text = fieldgrid(name, "--help-all").output()
    examples = re.findall(rf"^ {{4,}}fieldgrid {name} .+", text, re.MULTILINE)
    assert examples
    for example in examples:
        for option in re.findall(r"--?[a-z][-a-z]*", example.partition(name)[2]):
            assert re.search(rf"^  .*{option}\b", text, re.MULTILINE), option
    for parameter in commands()[name].params:
        if parameter.param_type_name == "option" and not parameter.hidden:
            assert max(parameter.opts, key=len) in text
            assert parameter.help, parameter.name


def test_an_example_of_help_is_understood(fieldgrid: Run) -> None:
    """The commands of the help pages get as far as the files that are not there."""
    for name in commands():
        text = fieldgrid(name, "--help").output()
        text = re.sub(r"\n {6}(?=--)", " ", text)  # an example that was wrapped
        for example in re.findall(rf"^ {{4,}}fieldgrid {name} (.+)", text, re.MULTILINE):
            result = fieldgrid(name, *shlex.split(example))
            if name == "info":  # needs no file
                assert result.status == 0
                continue
            assert result.status == 1, (example, result)
            # `inspect` says what is wrong as a finding, which is its output.
            said = result.out if name == "inspect" else result.sentence()
            assert re.search("There is no (map|vehicle file)|does not exist", said)


def test_without_a_command_there_is_help(fieldgrid: Run) -> None:
    assert "Drives:" in fieldgrid().output()


def test_version(fieldgrid: Run) -> None:
    version = importlib.metadata.version("fieldgrid")
    assert fieldgrid("--version").output() == f"fieldgrid {version}\n"


def test_a_command_that_is_none(fieldgrid: Run) -> None:
    assert "No such command 'bild'" in fieldgrid("bild").usage()


@pytest.mark.parametrize("name", [*READERS, "repair"])
def test_arguments_that_are_missing(name: str, fieldgrid: Run) -> None:
    assert "Missing argument 'MAP.gpkg" in fieldgrid(name).usage()


def arguments_for(name: str, map_: Path, tmp_path: Path) -> list[str]:
    others = {
        "show": ["-o", str(tmp_path / "out.png")],
        "export": [str(tmp_path / "out.tif")],
        "evaluate": [str(TRUTH)],
        "sessions": [],
        "verify": [],
        "repair": [],
        "query": ["1", "2"],
        "diff": ["--from", "2000-01-01", "--to", "2030-01-01"],
        "merge": ["-o", str(tmp_path / "new.gpkg")],
    }
    return [name, str(map_), *others[name]]


@pytest.mark.parametrize("name", [*READERS, "repair"])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"There is no map .*x\.gpkg; check the name, or build it first"),
        (b"notes " * 300, r"x\.gpkg is not a fieldgrid map"),
        (b"", r"x\.gpkg"),
    ],
)
def test_a_map_that_is_none(
    name: str, content: bytes | None, message: str, fieldgrid: Run, tmp_path: Path
) -> None:
    path = tmp_path / "x.gpkg"
    if content is not None:
        path.write_bytes(content)
    sentence = fieldgrid(*arguments_for(name, path, tmp_path)).sentence()
    assert re.search(message, sentence), sentence
    assert sorted(tmp_path.iterdir()) == ([] if content is None else [path])


@pytest.mark.parametrize("name", READERS)
def test_reading_does_not_change_a_map(
    name: str, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    path = tmp_path / "m" / "map.gpkg"
    path.parent.mkdir()
    shutil.copy(two_lanes_map, path)
    before = path.read_bytes()
    result = fieldgrid(*arguments_for(name, path, tmp_path))
    if name == "diff":
        assert "has no session up to 2000-01-01" in result.sentence()
    else:
        result.output()
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("name", READERS)
def test_a_map_that_was_cut_short(
    name: str, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    path = tmp_path / "m.gpkg"
    data = two_lanes_map.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    assert str(path) in fieldgrid(*arguments_for(name, path, tmp_path)).sentence()
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_that_goes_away_is_no_error(two_lanes_map: Path) -> None:
    child = subprocess.Popen(
        in_a_process("sessions", two_lanes_map, "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    assert child.stderr is not None
    child.stdout.close()
    errors = child.stderr.read()
    child.stderr.close()
    assert child.wait(60) in (0, 1)
    assert errors == ""


# --- sessions


def test_sessions_table(fieldgrid: Run, two_lanes_map: Path) -> None:
    header, *rows = fieldgrid("sessions", two_lanes_map).output().splitlines()
    assert header.split() == ["session", "driven", "GNSS", "used", "rejected"]
    (row,) = rows
    assert row.split()[0] == "two_lanes"
    assert row.split()[2] == "gnss/gnss_rtk.nmea"
    assert sum(int(count) for count in row.split()[3:]) == 50


def test_sessions_json(fieldgrid: Run, two_lanes_map: Path) -> None:
    result = json.loads(fieldgrid("sessions", two_lanes_map, "--json").output())
    assert result["map"] == str(two_lanes_map)
    assert result["datum"] == {"lat_deg": 41.65, "lon_deg": -4.72, "height_m": 787.4}
    assert result["cell_m"] == 0.05
    bounds = result["bounds_m"]
    assert bounds["west_m"] < -20 < 15 < bounds["east_m"]
    assert bounds["south_m"] < 40 < 80 < bounds["north_m"]
    (session,) = result["sessions"]
    assert session["name"] == "two_lanes"
    assert session["frames_used"] + session["frames_rejected"] == 50


def test_a_row_is_a_line_whatever_the_names(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path
) -> None:
    name = "2026-06-03 Riesling, upper terrace, second pass after the rain of the night"
    path = tmp_path / "m.gpkg"
    fieldgrid("build", make_drive(), "-o", path, "--name", name).output()
    assert len(fieldgrid("sessions", path).output().splitlines()) == 2


# --- show


@pytest.mark.parametrize("figure", ["sheet", "grid", "trajectory", "heading"])
def test_each_figure(figure: str, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.png"
    crop = ["--bounds", "-10", "50", "0", "60"] if figure in ("sheet", "grid") else []
    text = fieldgrid("show", two_lanes_map, "-o", out, "--figure", figure, *crop).output()
    assert text == f"figure {out}\n"
    picture = cv2.imread(str(out))
    assert picture is not None
    assert min(picture.shape[:2]) > 300
    assert picture.min() < 60
    assert picture.max() == 255


@pytest.mark.parametrize(("ending", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_other_kinds_of_picture(
    ending: str, start: bytes, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / f"x.{ending}"
    fieldgrid("show", two_lanes_map, "-o", out, "--figure", "heading").output()
    assert out.read_bytes().startswith(start)


def test_cells_bounds_session_and_rule_reach_the_picture(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fieldgrid.export import figures

    drawn: list[Any] = []
    original = figures.universal_grid

    def spy(view: Any, drives: Any, **options: Any) -> Any:
        drawn.append((view, drives, options["title"]))
        return original(view, drives, **options)

    monkeypatch.setattr(figures, "universal_grid", spy)
    flags = "--figure grid --cell 0.25 --bounds -10 50 0.1 60 --at two_lanes --averaging paper"
    fieldgrid("show", two_lanes_map, "-o", tmp_path / "x.png", *flags.split()).output()
    ((view, (drive,), title),) = drawn
    assert view.lattice.cell_m == 0.25
    assert view.bounds == pytest.approx((-10.0, 50.0, 0.25, 60.0))
    assert len(drive.frames) == 50
    assert "vineyard" in title
    assert "25 cm" in title
    with open_map(two_lanes_map) as universal:
        mean = universal.read(view.bounds, 0.25)
    assert (mean.observed == view.observed).all()
    assert (mean.density != view.density).any()


def test_a_large_map_is_drawn_with_larger_cells(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fieldgrid.cli.commands import show

    monkeypatch.setattr(show, "MAX_PIXELS", 400)
    out = tmp_path / "x.svg"
    fieldgrid("show", two_lanes_map, "-o", out, "--figure", "grid").output()
    assert "cells of 15 cm" in re.sub(r"<!--|-->", "", out.read_text())


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("-o OUT/x", r"x names no format .*; end it in \.png, \.pdf or \.svg"),
        ("-o OUT/x.foo", r"x\.foo names no format .*; end it in \.png, \.pdf or \.svg"),
        (
            "-o OUT/not/x.png",
            r"not/x\.png was not written: its folder does not exist; make it first",
        ),
        ("-o OUT/x.png --cell 0.02", r"0\.02 m are smaller than the local cells of 0\.05 m"),
        ("-o OUT/x.png --cell 0", r"cell of 0\.0 m is outside"),
        ("-o OUT/x.png --cell nan", "cell of nan m is outside"),
        (
            "-o OUT/x.png --bounds 1 1 1 1",
            r"Bounds \(1\.0, .* are empty; give west south east north",
        ),
        ("-o OUT/x.png --bounds 5 0 1 9 --cell 0.05", r"Bounds \(5\.0, .* are empty"),
        ("-o OUT/x.png --bounds 0 0 9e9 99 --cell 0.05", "over 400 million cells; give smaller"),
        (
            "-o OUT/x.png --at june",
            r"'june' is neither a session of .*\('two_lanes'\) nor a date as in 2026",
        ),
    ],
)
def test_pictures_that_cannot_be(
    flags: str, message: str, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    words = flags.replace("OUT", str(tmp_path)).split()
    sentence = fieldgrid("show", two_lanes_map, *words).sentence()
    assert re.search(message, sentence), sentence
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bounds", ["nan 0 1 1", "0 0 inf 1"])
def test_bounds_that_are_no_numbers(
    bounds: str, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x.png"
    result = fieldgrid("show", two_lanes_map, "-o", out, "--bounds", *bounds.split())
    assert result.status in (1, 2)
    assert "Bounds" in result.err or "--bounds" in result.err


def test_bounds_far_too_large(fieldgrid: Run, two_lanes_map: Path, tmp_path: Path) -> None:
    bounds = ["--bounds", "0", "0", "1e9", "1e9"]
    sentence = fieldgrid("show", two_lanes_map, "-o", tmp_path / "x.png", *bounds).sentence()
    assert sentence.startswith("Bounds")


def test_a_picture_that_would_be_a_folder(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    assert str(folder) in fieldgrid("show", two_lanes_map, "-o", folder).sentence()
    assert list(tmp_path.iterdir()) == [folder]


def test_the_picture_that_is_announced_is_there(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    result = fieldgrid("show", two_lanes_map, "-o", tmp_path / "map", "--figure", "heading")
    if result.status == 0:
        assert Path(result.out.removeprefix("figure ").rstrip("\n")).is_file()
    else:
        result.sentence()


def test_a_picture_is_replaced_only_by_a_whole_one(
    fieldgrid_process: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x.png"
    out.write_bytes(b"the old picture")
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))"
    result = fieldgrid_process(
        "show", two_lanes_map, "-o", out, "--figure", "heading", before=limit
    )
    assert "x.png" in result.sentence()
    assert out.read_bytes() == b"the old picture"


def test_wrong_use_of_show(fieldgrid: Run, two_lanes_map: Path, tmp_path: Path) -> None:
    out = ["-o", tmp_path / "x.png"]
    assert "Missing option '--out'" in fieldgrid("show", two_lanes_map).usage()
    assert "--figure" in fieldgrid("show", two_lanes_map, *out, "--figure", "map").usage()
    few = fieldgrid("show", two_lanes_map, *out, "--bounds", "1", "2")
    assert (few.status, few.out) == (2, "")
    assert "'--bounds' requires 4 arguments" in few.err
    text = fieldgrid("show", two_lanes_map, *out, "--averaging", "median").usage()
    assert "'median' is neither mean nor paper" in text
    assert list(tmp_path.iterdir()) == []


# --- evaluate


def test_evaluate_table(fieldgrid: Run, two_lanes_map: Path) -> None:
    text = fieldgrid("evaluate", two_lanes_map, TRUTH).output()
    assert "forward on the rows" in text.splitlines()[0]
    assert "all frames" in text.splitlines()[0]
    for row in (
        r"frames used / rejected +31 / 0 +\d+ / \d+",
        r"precision within 10 cm +9\d\.\d % +\d+\.\d %",
        r"recall within 25 cm +\d+\.\d % +\d+\.\d %",
        r"free cells with an obstacle +0\.\d\d % +0\.\d\d %",
        r"heading error, median +0\.\d\d ° +0\.\d\d °",
        r"position error, largest +0\.\d\d\d m +0\.\d\d\d m",
    ):
        assert re.search(f"^{row}$", text, re.MULTILINE), row
    assert "000000" not in text
    assert "lean" not in text  # the gyro and accelerometer of the example tell it


def test_evaluate_frames(fieldgrid: Run, two_lanes_map: Path) -> None:
    text = fieldgrid("evaluate", two_lanes_map, TRUTH, "--frames").output()
    rows = re.findall(r"^(\d{6}) +(\w+) +(forward|reverse|stopped) ", text, re.MULTILINE)
    assert [row[0] for row in rows] == [f"{k:06d}" for k in range(50)]
    assert ("000026", "turn_1_fishtail", "reverse") in rows


def test_evaluate_json(fieldgrid: Run, two_lanes_map: Path) -> None:
    text = fieldgrid("evaluate", two_lanes_map, TRUTH, "--json", "--min-pixels", "200").output()
    result = json.loads(text)
    assert result["observable_pixels"] == 200
    assert result["unmatched_frames"] == 0
    assert [group["name"] for group in result["groups"]] == ["forward on the rows", "all frames"]
    assert len(result["frames"]) == 50


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        ("nowhere", "no truth folder .*nowhere; give the folder"),
        (str(TWO_LANES / "gnss"), r"The truth folder lacks obstacle_raster_5cm\.npz; looked for"),
    ],
)
def test_a_truth_that_is_none(
    truth: str, message: str, fieldgrid: Run, two_lanes_map: Path
) -> None:
    sentence = fieldgrid("evaluate", two_lanes_map, truth, "--json").sentence()
    assert re.search(message, sentence), sentence


def test_a_map_of_another_datum_names_what_to_build(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path
) -> None:
    path = tmp_path / "m.gpkg"
    drive = make_drive(frames=range(5, 8))
    fieldgrid("build", drive, "-o", path, "--datum", "41.6501,-4.72,787.4").output()
    sentence = fieldgrid("evaluate", path, TRUTH).sentence()
    datum = re.search(r"build the map with --datum (\S+)\.$", sentence)
    assert datum
    fieldgrid("build", drive, "-o", path, "--datum", datum[1], "--overwrite").output()
    assert "forward on the rows" in fieldgrid("evaluate", path, TRUTH).output()


def test_wrong_use_of_evaluate(fieldgrid: Run, two_lanes_map: Path) -> None:
    assert "Missing argument 'TRUTH'" in fieldgrid("evaluate", two_lanes_map).usage()
    assert (
        "--min-pixels" in fieldgrid("evaluate", two_lanes_map, TRUTH, "--min-pixels", "0").usage()
    )


@pytest.fixture(scope="module")
def aligned_map(tmp_path_factory: pytest.TempPathFactory, two_lanes_map: Path) -> Path:
    """The map of the example with an alignment to be undone; copy it."""
    path = Path(shutil.copy(two_lanes_map, tmp_path_factory.mktemp("aligned")))
    with open_map(path, writable=True) as universal:
        aligned = AlignmentRecord(0.1, 0.1, ("another",))
        universal.set_transforms({"two_lanes": Transform(0.1, aligned=aligned)})
    return path


@pytest.mark.parametrize(
    "change",
    [
        ("sessions", "--remove", "two_lanes"),
        ("mark", "--point", "1,1", "--kind", "free"),
        ("align", "--undo"),
        ("repair",),
    ],
)
def test_another_writer_is_waited_for_as_long_as_is_said(
    fieldgrid: Run, aligned_map: Path, tmp_path: Path, change: tuple[str, ...]
) -> None:
    path = Path(shutil.copy(aligned_map, tmp_path / "m.gpkg"))
    command, *flags = change
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        result = fieldgrid(command, path, *flags, "--wait", 0.1)
    assert result.status == 1
    told, refused = result.err.splitlines()
    assert told == "fieldgrid: waiting for another program that writes m.gpkg, up to 0.1 s"
    assert "is in use by another program, and was not changed" in refused
    assert sorted(file.name for file in tmp_path.iterdir()) == ["m.gpkg"]
    fieldgrid(command, path, *flags, "--wait", 0.1).output()


def test_a_commit_that_holds_up_readers_is_waited_for_as_long_as_is_said(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    path = Path(shutil.copy(two_lanes_map, tmp_path / "m.gpkg"))
    merge = ("merge", path, "-o", tmp_path / "new.gpkg", "--wait", 0.1)
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        result = fieldgrid(*merge)
    assert result.status == 1
    told, refused = result.err.splitlines()
    assert told == "fieldgrid: waiting for another program that writes m.gpkg, up to 0.1 s"
    assert "is being written by another program; try again shortly" in refused
    assert sorted(file.name for file in tmp_path.iterdir()) == ["m.gpkg"]
    fieldgrid(*merge).output()
