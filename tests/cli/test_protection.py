"""What nobody asked for does not happen: inputs stay, and no option is ignored."""

from __future__ import annotations

import ast
import inspect
import shutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.cli.listing import COMMANDS, load
from fieldgrid.cli.settings_flags import SettingsFlags
from tests.cli.conftest import Run

MakeDrive = Callable[..., Path]


def tree(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


# --- inputs


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("build DRIVE -o IMAGE --overwrite", "is not a map that fieldgrid has written"),
        ("build DRIVE -o DRIVE/frames.csv --overwrite", "is not a map that fieldgrid has written"),
        ("build DRIVE -o DRIVE --overwrite", "is read here and never replaced"),
        ("track DRIVE -o DRIVE/frames.csv", "exists already and is no track"),
        ("track DRIVE -o IMAGE", "ends in none of .csv, .gpx"),
        ("track DRIVE -o x.track", "ends in none of .csv, .gpx"),
        ("show MAP -o IMAGE --overwrite", "names no format that a figure can have"),
        ("show MAP -o x.csv", "end it in .png, .pdf or .svg"),
        ("export MAP IMAGE --format png --overwrite", "is not a PNG that fieldgrid"),
        ("export MAP DRIVE/frames.csv --overwrite", "is not a CSV that fieldgrid has written"),
        ("export MAP MAP --overwrite", "which no export replaces"),
        ("merge MAP -o MAP --overwrite", "is read here and never replaced"),
        ("merge MAP -o IMAGE --overwrite", "is not a map that fieldgrid has written"),
        ("diff MAP --from 2000-01-01 --to june -o MAP", "is read here and never replaced"),
        ("view MAP --html OTHER.gpkg", "ends in none of .html"),
        ("view MAP --html IMAGE", "ends in none of .html"),
        ("view MAP --html OTHER.html", "is not a page that fieldgrid has written"),
        ("rows MAP -o MAP --overwrite", "is read here and never replaced"),
        ("rows MAP -o DRIVE/frames.csv", "exists already; give another name"),
        ("rows MAP -o OTHER.gpkg --overwrite", "is not features in a .gpkg that fieldgrid"),
        ("rows MAP --agopengps DRIVE", "exists already; give another name"),
        ("route MAP --cover -o x.csv --swaths MAP --overwrite", "is read here and never replaced"),
        ("route MAP --cover --swaths DRIVE/frames.csv", "exists already; give another name"),
        ("mark MAP -o DRIVE/frames.csv --overwrite", "is not features in a .csv that fieldgrid"),
        ("farm FOLDER --stac DRIVE --overwrite", "holds other things than a STAC catalogue"),
        ("live -o x.gpkg --images DRIVE --gnss - --gnss-log DRIVE/frames.csv", "is no log of a"),
        ("live --replay DRIVE -o MAP", "exists already; give another name"),
    ],
)
def test_no_input_is_replaced(
    arguments: str,
    message: str,
    fieldgrid: Run,
    make_drive: MakeDrive,
    two_lanes_map: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = make_drive("june")
    map_ = tmp_path / "field.gpkg"
    shutil.copy(two_lanes_map, map_)
    other = tmp_path / "other"  # another map, and a page of somebody else
    shutil.copy(two_lanes_map, other.with_suffix(".gpkg"))
    other.with_suffix(".html").write_text("<html>")
    before = tree(tmp_path)
    image = min((drive / "left").iterdir())
    text = arguments.replace("DRIVE", str(drive)).replace("MAP", str(map_))
    text = text.replace("IMAGE", str(image)).replace("OTHER", str(other))
    text = text.replace("FOLDER", str(tmp_path))
    result = fieldgrid(*text.split())
    assert result.status == 1, result
    if not arguments.startswith("diff"):  # whose --from is refused first
        assert message in result.sentence()
    assert tree(tmp_path) == before


def test_a_converted_drive_does_not_replace_itself(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path
) -> None:
    out = tmp_path / "a.mcap"
    fieldgrid("convert", make_drive(), out).output()
    before = out.read_bytes()
    sentence = fieldgrid("convert", out, out, "--overwrite").sentence()
    assert sentence == f"{out} is read here and never replaced; give another name."
    assert out.read_bytes() == before
    fieldgrid("convert", make_drive("b"), out, "--overwrite").output()  # but it is one of ours


def test_our_own_are_replaced(fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, map_ = make_drive("june"), tmp_path / "a.gpkg"
    for _ in range(2):
        fieldgrid("build", drive, "-o", map_, "--overwrite").output()
        fieldgrid("merge", map_, "-o", tmp_path / "b.gpkg", "--overwrite").output()
        fieldgrid("track", drive, "-o", drive / "track.csv", "--overwrite").output()
        fieldgrid("show", map_, "-o", tmp_path / "a.png", "--overwrite").output()


# --- options


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_read(name: str) -> None:
    """A parameter that the code of its command does not name would be ignored."""
    module = import_module(f"fieldgrid.cli.commands.{name.replace('-', '_')}")
    source = ast.parse(inspect.getsource(module))
    (function,) = (
        node for node in source.body if isinstance(node, ast.FunctionDef) and node.name == "command"
    )
    arguments = [one.arg for one in (*function.args.args, *function.args.kwonlyargs)]
    read = {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
    assert [one for one in arguments if one not in read] == []


ALWAYS = {"as_json", "quiet", "verbose", "help", "help_all"}
MODES: dict[str, tuple[str, set[str]]] = {
    # what decides that others cannot count, and those that still do
    "poses again": (
        "build --repose MAP",
        {"repose", "name", "config", *SettingsFlags("pose").names()},
    ),
    "trajectory": ("show MAP -o x.png --figure trajectory",
                   {"out", "figure", "at", "session", "overwrite"}),
    "heading": ("show MAP -o x.png --figure heading",
                {"out", "figure", "at", "session", "overwrite"}),
    "no picture": (
        "diff MAP --from 2000-01-01 --to june",
        {"from_", "to", "out", "cell", "bounds"},
    ),
    "no file": ("mount DRIVE", {"write", "gnss", "topic", "mounting", "time_offset", "every",
                                "figure", "jobs"}),
    "removal": ("sessions MAP --remove june", {"remove"}),
    "undone": ("align MAP --undo", {"undo", "session", "wait_s"}),
    "a page": ("view MAP --html x.html", {"html", "route"}),
}  # fmt: skip
VALUES = {
    "cell": ["0.5"],
    "bounds": ["0", "0", "1", "1"],
    "every": ["2"],
    "jobs": ["1"],
    "max_range": ["9"],
    "local_cell": ["0.1"],
    "time_offset": ["1"],
    "antenna": ["1", "2", "3"],
    "shift": ["june", "0,0"],
    "rename": ["june", "july"],
    "port": ["5"],
    "reach": ["3"],
}


@pytest.mark.parametrize("mode", MODES)
def test_an_option_that_cannot_count_is_refused(
    mode: str, fieldgrid: Run, make_drive: MakeDrive, two_lanes_map: Path, tmp_path: Path
) -> None:
    text, counting = MODES[mode]
    map_ = tmp_path / "field.gpkg"
    shutil.copy(two_lanes_map, map_)
    places = {"MAP": map_, "DRIVE": make_drive()}
    words: list[Any] = [places.get(word, word) for word in text.split()]
    before = tree(tmp_path)
    tried = 0
    for one in load(words[0]).params:
        if one.param_type_name != "option" or one.name in counting | ALWAYS:
            continue
        value = [] if one.is_flag else VALUES.get(str(one.name), ["x"])
        flag = max(one.opts, key=len)
        usage = fieldgrid(*words, flag, *value).usage()
        assert flag in usage or "--remove" in usage, (flag, usage)
        tried += 1
    assert tried > 0
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("text", "flag"),
    [
        ("rows MAP --overwrite", "--overwrite"),
        ("rows MAP --speed-limit 5", "--speed-limit"),
        ("rows MAP --agopengps fields --speed-limit 5", "--speed-limit"),
        ("mark MAP --overwrite", "--overwrite"),
        ("mark MAP --name x", "--name"),
        ("farm FOLDER --overwrite", "--overwrite"),
        ("farm FOLDER --cog", "--cog"),
        ("farm FOLDER --jobs 1", "--jobs"),
        ("farm FOLDER --stac catalogue --jobs 1", "--jobs"),
        ("route MAP --from 0,0,0 --to 1,1,0 --tracks", "--tracks"),
        ("route MAP --cover --headland-passes 2", "--headland-passes"),
        ("route MAP --cover --overwrite", "--overwrite"),
        ("route MAP --cover --speed-limit 5", "--speed-limit"),
        ("route MAP --cover --swaths x.taskdata.zip --speed-limit 5", "--speed-limit"),
        ("route MAP --cover -o x.csv --swaths x.csv", "two outputs"),
        ("rows MAP -o x.csv --agopengps x.csv", "two outputs"),
        ("verify MAP --scheduler tcp://127.0.0.1:1", "--scheduler"),
        ("live --replay DRIVE -o x.gpkg --gnss-log x.nmea", "--gnss-log"),
    ],
)
def test_an_option_without_the_one_that_it_is_for_is_refused(
    text: str, flag: str, fieldgrid: Run, make_drive: MakeDrive, two_lanes_map: Path, tmp_path: Path
) -> None:
    map_ = tmp_path / "field.gpkg"
    shutil.copy(two_lanes_map, map_)
    places = {"MAP": map_, "DRIVE": make_drive(), "FOLDER": tmp_path}
    before = tree(tmp_path)
    assert flag in fieldgrid(*[places.get(word, word) for word in text.split()]).usage()
    assert tree(tmp_path) == before


NUMBERS: dict[str, str] = {
    "align": "align MAP --dry-run",
    "diff": "diff MAP --from june --to july",
    "evaluate": "evaluate MAP SURVEY",
    "live": "live --replay DRIVE -o x.gpkg --rate max",
    "query": "query MAP 0 60",
    "rows": "rows MAP -o x.osm",
    "route": "route MAP --cover --tracks --swaths x.osm",
    "show": "show MAP -o x.png",
}
"""A use of each command that takes lengths and shares."""


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_that_none_can_be_is_refused_before_the_work(
    name: str, fieldgrid: Run, make_drive: MakeDrive, two_lanes_map: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    survey = tmp_path / "survey.csv"
    survey.write_text("kind,east_m,north_m\npost,0,60\n")
    places = {"MAP": two_lanes_map, "DRIVE": make_drive(), "SURVEY": survey}
    words = [places.get(word, word) for word in NUMBERS[name].split()]
    tried = 0
    for one in load(name).params:
        kind = str(one.type_descriptor.annotation)
        if one.param_type_name != "option" or one.nargs != 1 or "float" not in kind:
            continue
        flag = max(one.opts, key=len)
        # Clocks may differ by anything.
        for value in ("nan", "inf", *(["-1e9"] if name != "live" else [])):
            result = fieldgrid(*words, f"{flag}={value}")
            assert result.status in (1, 2), (flag, value, result)
            assert result.out == "", (flag, value)
            assert not list(tmp_path.glob("x.*")), (flag, value)
        tried += 1
    assert tried > 0


@pytest.mark.parametrize("name", ["x.txt", "plain"])
@pytest.mark.parametrize(
    "words", ["build DRIVE -o", "live --replay DRIVE --rate max -o", "merge MAP -o"]
)
def test_a_new_map_is_called_as_maps_are(
    words: str, name: str, fieldgrid: Run, make_drive: MakeDrive, two_lanes_map: Path,
    tmp_path: Path,
) -> None:  # fmt: skip
    """A farm lists no other; a map that exists may have any name."""
    places = {"MAP": two_lanes_map, "DRIVE": make_drive()}
    asked = [places.get(word, word) for word in words.split()]
    told = fieldgrid(*asked, tmp_path / name).usage()
    assert f"{name} does not end in .gpkg" in told
    assert not (tmp_path / name).exists()


def test_what_is_said_of_columns_is_for_tables(
    fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path
) -> None:
    drive = make_drive()
    log = next((drive / "gnss").iterdir())
    for path in (log, drive):
        asked = ("track", path, "-o", tmp_path / "t.csv", "--columns", "lat=a")
        assert f"{log} is no table; leave --columns out" in fieldgrid(*asked).sentence()


def test_numbers_below_zero_are_no_options(fieldgrid: Run, two_lanes_map: Path) -> None:
    for place in (["-6.52", "52.32"], ["-6.52", "-52"], ["-.5", "52"], ["41.65,-4.72"]):
        text = fieldgrid("query", two_lanes_map, *place, "--cell", "0.1").output()
        assert text.startswith("cell ")
    same = fieldgrid("query", two_lanes_map, "--", "-6.52", "52.32").output()
    assert same == fieldgrid("query", two_lanes_map, "-6.52", "52.32").output()
    assert "no option --cel" in fieldgrid("query", two_lanes_map, "1", "2", "--cel", "3").usage()
    assert "no option -x" in fieldgrid("query", two_lanes_map, "-x", "2").usage()
