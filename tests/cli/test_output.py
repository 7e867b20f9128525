"""Numbers in tables, times in JSON."""

import ast
import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid.cli import output
from tests.cli.conftest import Run


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (math.nan, "-"), (0.0, "0.0 °"), (-12.34, "-12.3 °")]
)
def test_what_is_not_known_is_a_dash(value: float | None, text: str) -> None:
    assert output.number(value, 1, "°") == text


def test_nothing_is_printed_but_what_is_printable() -> None:
    """Names of files are in what commands say; those of a stranger move no cursor. Usage and help
    of a command have none."""
    for path in Path(output.__file__).parent.glob("*.py"):
        if path.name == "output.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "typer.echo"):
                said = ast.unparse(node)
                assert re.search(r"printable\(|version\(|print\(usage|get_help\(", said), (
                    f"{path.name}: {said}"
                )


def test_a_time_in_json_has_its_text_beside_it(capsys: pytest.CaptureFixture[str]) -> None:
    """JavaScript would read 1308133815469000001 as ...000100."""
    at = 1_308_133_815_469_000_001
    said = {"time_ns": at, "streams": [{"start_ns": at, "stop_ns": None, "time_offset_ns": 5}]}
    wander = {"wander": {"time_ns": (0, at)}, "first_time_ns": at}
    for write in (output.print_json, output.print_json_line):
        write({**said, **wander})
        assert json.loads(capsys.readouterr().out) == {
            "time_ns": at,
            "time": "2011-06-15T10:30:15.469000001Z",
            "streams": [
                {
                    "start_ns": at,
                    "start_time": "2011-06-15T10:30:15.469000001Z",
                    "stop_ns": None,
                    "stop_time": None,
                    "time_offset_ns": 5,
                }
            ],
            "wander": {
                "time_ns": [0, at],
                "time": ["1970-01-01T00:00:00.000000000Z", "2011-06-15T10:30:15.469000001Z"],
            },
            "first_time_ns": at,
            "first_time": "2011-06-15T10:30:15.469000001Z",
        }


@pytest.mark.parametrize(
    "asked",
    ["sessions MAP", "query MAP -6.52 52.32", "inspect DRIVE", "convert DRIVE x.mcap",
     "farm FOLDER", "align MAP --dry-run", "mark MAP"],
)  # fmt: skip
def test_no_time_of_a_command_is_a_number_alone(
    asked: str, fieldgrid: Run, two_lanes_map: Path, make_drive: Callable[..., Path],
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    shutil.copy(two_lanes_map, tmp_path / "map.gpkg")
    places = {"MAP": "map.gpkg", "DRIVE": make_drive(), "FOLDER": "."}
    done = fieldgrid(*[places.get(word, word) for word in asked.split()], "--json")
    found = json.loads(done.out)
    bare = []

    def look(value: object) -> None:
        if isinstance(value, list):
            for one in value:
                look(one)
        elif isinstance(value, dict):
            for key, one in value.items():
                look(one)
                if isinstance(one, int) and one > 10**18:
                    text = value.get(key.removesuffix("_ns"), value.get(f"{key[:-3]}_time", ""))
                    bare.extend([] if str(text).endswith("Z") else [key])

    look(found)
    assert bare == []
