"""How results look: one table, or one JSON object, on stdout."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text


def print_json(value: dict[str, Any]) -> None:
    """One JSON object to stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "") -> None:
    """A plain table to stdout; all but the first column are aligned to the right."""
    table = Table(
        title=Text(title) if title else None,
        title_justify="left",
        title_style="",
        box=None,
        pad_edge=False,
        show_header=any(columns),
        header_style="",
    )
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    # Off a terminal nothing limits the width, and a folded name could not be read back.
    width = None if sys.stdout.isatty() else 1000
    console = Console(file=sys.stdout, highlight=False, width=width)
    console.print(table)


def known(value: float) -> float | None:
    """A number for JSON, which has none for what is not known."""
    return value if math.isfinite(value) else None


def number(value: float | None, digits: int, unit: str = "") -> str:
    """A rounded number with its unit, or a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:.{digits}f}{' ' + unit if unit else ''}"


def percent(value: float | None, digits: int = 1) -> str:
    """A share as per cent, or a dash."""
    return "-" if value is None else f"{100.0 * value:.{digits}f} %"
