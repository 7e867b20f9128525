"""Numbers in tables."""

import ast
import math
from pathlib import Path

import pytest

from fieldgrid.cli import output


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (math.nan, "-"), (0.0, "0.0 °"), (-12.34, "-12.3 °")]
)
def test_what_is_not_known_is_a_dash(value: float | None, text: str) -> None:
    assert output.number(value, 1, "°") == text


def test_nothing_is_printed_but_what_is_printable() -> None:
    """Names of files are in what commands say; those of a stranger move no cursor."""
    for path in Path(output.__file__).parent.glob("*.py"):
        if path.name == "output.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "typer.echo"):
                said = ast.unparse(node)
                assert "printable(" in said or "version(" in said, f"{path.name}: {said}"
