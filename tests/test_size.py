"""The yardstick counts what it says, and lets the package grow only by its rules."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.test_architecture import ROOMS
from tools import size

MODULE = '''
"""A docstring."""
import math
from typing import NamedTuple

FAR_M = 3.0
"""A docstring of an attribute."""
NEAR_M, ANGLE, NAMES = 1.0, -math.pi / 2, ("a", "b")


class Pair(NamedTuple):
    """A record."""

    left: int = 1


def far(x_m):
    """A docstring of more than six words in a line."""
    if _is_far(x_m):
        raise ValueError("This place is farther than anything else here.")
    return x_m


def _is_far(x_m):
    return x_m > FAR_M
'''

KEPT: dict[str, Any] = {
    "budget": {"core": 10, "maps": 10},
    "statements": {"core": 8, "maps": 20},
    "runs": {"build": 5},
    "grown": {},
}


def test_statements_are_counted_without_docstrings_and_imports() -> None:
    assert size.measure(MODULE) == Counter(
        files=1,
        lines=MODULE.count("\n"),
        statements=10,
        functions=2,
        once=1,
        classes=1,
        records=1,
        numbers=3,
        sentences=1,
    )


@pytest.mark.parametrize(
    ("statements", "functions", "grown", "found"),
    [
        ({"core": 8, "maps": 20}, 5, {}, []),
        ({"core": 10, "maps": 18}, 4, {}, []),
        ({"core": 9, "maps": 20}, 5, {}, ["The package has 29"]),
        ({"core": 6, "maps": 22}, 5, {}, ["maps has 22"]),
        ({"core": 6, "maps": 22}, 5, {"maps": "sessions that expire"}, []),
        ({"core": 8, "maps": 20}, 6, {}, ["build runs through 6"]),
    ],
)
def test_the_package_grows_by_the_rules_only(
    statements: dict[str, int], functions: int, grown: dict[str, str], found: list[str]
) -> None:
    now = {"statements": statements, "runs": {"build": functions}}
    said = size.problems(now, {**KEPT, "grown": grown})
    assert [sentence.split(" statements")[0].split(" functions")[0] for sentence in said] == found


def test_the_package_keeps_to_its_figures() -> None:
    kept = json.loads(size.KEPT.read_text(encoding="utf-8"))
    assert set(kept["budget"]) == set(ROOMS)
    statements = {name: row["statements"] for name, row in size.rooms(size.PACKAGE).items()}
    assert size.problems({"statements": statements, "runs": {}}, kept) == []


def test_a_command_runs_through_functions() -> None:
    assert size.traced(["info"]) > 0


def test_the_figures_are_those_of_the_yardstick_beside_the_repository(tmp_path: Path) -> None:
    yardstick = ROOT.parent / "shared" / "tools" / "size.py"
    if not yardstick.exists():
        pytest.skip("../shared/tools/size.py is not at hand")
    out = tmp_path / "size.json"
    command = [sys.executable, yardstick, size.PACKAGE, "--json", out]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    names = {"tuples": "records", "constants": "numbers"}
    ours = size.rooms(size.PACKAGE)
    for room, row in json.loads(out.read_text()).items():
        if room != "all":
            theirs = Counter({names.get(column, column): count for column, count in row.items()})
            assert ours[room] == theirs, room
