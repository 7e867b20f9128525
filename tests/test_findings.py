"""The page of findings names every code that the sources give, and no other."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from fieldgrid.core import StopCode

ROOT = Path(__file__).parents[1]
GIVERS = {"error", "warning", "info", "refusal", "noted"}
ELSEWHERE = {"calibration", "mounting-height", "mounting-tilt", "mounting-roll", "setting"}
"""Codes that are made of parts, or stand in a table."""


def given() -> Iterator[str]:
    """The codes in calls of the functions that make findings."""
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            called = node.func
            either = [called.body, called.orelse] if isinstance(called, ast.IfExp) else [called]
            if not any(isinstance(one, ast.Name) and one.id in GIVERS for one in either):
                continue
            for value in node.args:
                if isinstance(value, ast.Constant) and re.fullmatch(r"[a-z-]+", str(value.value)):
                    yield str(value.value)


def test_all_codes_are_on_the_page() -> None:
    rows = [
        line.split("|")[1]
        for line in (ROOT / "docs" / "findings.md").read_text("utf-8").splitlines()
        if line.startswith("| `")
    ]
    named = re.findall(r"`([a-z-]+)`", " ".join(rows))
    assert len(named) == len(set(named))
    assert set(named) == {*given(), *StopCode, *ELSEWHERE}


def test_a_figure_has_one_of_the_units_on_the_page() -> None:
    page = (ROOT / "docs" / "findings.md").read_text("utf-8")
    (units,) = re.findall(r"Units are (.*?) for a ratio", page)
    given = {
        str(unit.value)
        for path in (ROOT / "src").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Figure"
        for unit in node.args[1:2]
        if isinstance(unit, ast.Constant)
    }
    assert set(re.findall(r"`(\S+)`", units)) == given
