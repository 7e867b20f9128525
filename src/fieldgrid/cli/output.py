"""How results look: one table, or one JSON object, on stdout.

What a command was asked for is printed always. What it tells of its work (`report_*`) is not with
`--quiet`. Texts of others, such as the name of a session, cannot move the cursor.
"""

from __future__ import annotations

import json
import logging
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from inspect import Parameter
from typing import Any

import typer

from fieldgrid.cli.groups import option
from fieldgrid.core import Finding, printable

_TIMES = ("time_ns", "start_ns", "stop_ns")
"""How the keys of times end in JSON; `..._offset_ns` is none."""

_COLOURS = {"error": "31", "warning": "33"}

_quiet = False

log = logging.getLogger("fieldgrid")


class _Verbosity:
    """`--quiet` and `--verbose`, which every command has."""

    def parameters(self) -> Iterable[Parameter]:
        quiet = typer.Option("--quiet", "-q", help="Print no progress and no report.")
        verbose = typer.Option("--verbose", "-v", help="Report each step and its time on stderr.")
        return option("quiet", bool, False, quiet), option("verbose", bool, False, verbose)

    def value(self, given: Mapping[str, Any]) -> None:
        global _quiet
        _quiet = given["quiet"]
        log.handlers.clear()
        log.setLevel(logging.INFO if given["verbose"] else logging.WARNING)
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(relativeCreated)7.0f ms  %(message)s"))
        log.addHandler(handler)
        log.info("fieldgrid %s", " ".join(sys.argv[1:]))


VERBOSITY = _Verbosity()


def log_cost() -> None:
    """With `--verbose`, what the command has taken."""
    if log.isEnabledFor(logging.INFO):
        import resource

        used = resource.getrusage(resource.RUSAGE_SELF)
        memory_mb = used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
        seconds = used.ru_utime + used.ru_stime
        log.info("%.1f s of processor time, %.0f MB of memory at most", seconds, memory_mb)


def shows_progress() -> bool:
    """Whether somebody watches a progress line."""
    return sys.stderr.isatty() and not _quiet


def message(text: str) -> None:
    """A line on stderr about what goes on."""
    if not _quiet:
        typer.echo(f"fieldgrid: {printable(text)}", err=True)


def print_json(value: Mapping[str, Any]) -> None:
    """One JSON object to stdout, with a text beside each time."""
    print(json.dumps(with_texts(value), indent=2, allow_nan=False))


def print_json_line(value: Mapping[str, Any]) -> None:
    """One JSON object to stdout, on a line of its own, and at once."""
    print(json.dumps(with_texts(value), allow_nan=False), flush=True)


def with_texts(value: Any) -> Any:
    """A value with the ISO text of each time in nanoseconds beside it (`time` of `time_ns`,
    `start_time` of `start_ns`): JavaScript and jq round whole numbers of that size."""
    if isinstance(value, list | tuple):
        return [with_texts(one) for one in value]
    if not isinstance(value, Mapping):
        return value
    found: dict[str, Any] = {}
    for key, one in value.items():
        found[key] = with_texts(one)
        if str(key).endswith(_TIMES):
            name = key.removesuffix("_ns")
            found.setdefault(name if name.endswith("time") else f"{name}_time", _time_text(one))
    return found


def _time_text(value: Any) -> Any:
    from fieldgrid.core import utc_text

    if isinstance(value, list | tuple):
        return [_time_text(one) for one in value]
    return None if value is None else utc_text(value, "ns")


def print_line(text: str) -> None:
    """A line that was asked for."""
    print(printable(text))


def report_line(text: str) -> None:
    """A line about the work."""
    if not _quiet:
        print_line(text)


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "") -> None:
    """A plain table to stdout; all but the first column are aligned to the right."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(printable(title)) if title else None,
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
        table.add_row(*(Text(printable(cell)) for cell in row))
    # Off a terminal nothing limits the width, and a folded name could not be read back.
    width = None if sys.stdout.isatty() else 1000
    Console(file=sys.stdout, highlight=False, width=width).print(table)


def report_table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "") -> None:
    """A table about the work."""
    if not _quiet:
        print_table(columns, rows, title=title)


def finding_line(finding: Finding) -> str:
    """A finding on a line: its severity, its code, the sentence and what to do."""
    return f"{severity(finding.severity.value)} {finding.code}: {printable(finding.whole())}"


def severity(word: str) -> str:
    """The word in the colour of its severity, where a terminal shows colours."""
    wanted = sys.stdout.isatty() and not os.environ.get("NO_COLOR")
    if word not in _COLOURS or not wanted or os.environ.get("TERM") == "dumb":
        return word
    return f"\x1b[{_COLOURS[word]}m{word}\x1b[0m"


def known(value: float) -> float | None:
    """A number for JSON, which has none for what is not known."""
    return value if math.isfinite(value) else None


def number(value: float | None, digits: int, unit: str = "") -> str:
    """A rounded number with its unit, or a dash where there is none (None, NaN)."""
    if value is None or math.isnan(value):
        return "-"
    return f"{value:.{digits}f}{' ' + unit if unit else ''}"


def percent(value: float | None, digits: int = 1) -> str:
    """A share as per cent, or a dash."""
    return "-" if value is None else f"{100.0 * value:.{digits}f} %"
