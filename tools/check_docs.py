"""Run the code and the commands shown in the documentation.

Each document is worked through from top to bottom in a temporary directory of its own,
in which `examples` leads to the repository's examples:

- A block marked ``python`` is executed. All of a document's blocks share one namespace.
- In a block marked ``console``, each command that starts with ``$ fieldgrid``, ``$ mkdir`` or
  ``$ cat`` is run, and what it prints must be what is shown. A shown ``...`` stands for anything
  within its line, or, alone on a line, for any number of lines. The command must succeed, unless
  the next command is ``$ echo $?``, under which its exit status is shown. Other commands
  (``$ git clone``, ``$ make``) are for the reader only.
- A block right after ``<!-- not run: reason -->`` is skipped, and counted.

Tables that are made from the code (``tools/tables.py``) must be up to date.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import io
import os
import re
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # as a script, this file's own folder is there only
from tools import tables  # noqa: E402

COLUMNS = 100
TIMEOUT_S = 900

FENCE = re.compile(r"(?P<indent>[ \t]*)(?P<ticks>`{3,}|~{3,})[ \t]*(?P<language>[^\s`]*)[^`]*")
NOT_RUN = re.compile(r"\s*<!--\s*not run:\s*\S.*-->\s*")
STATUS_COMMAND = "echo $?"
RUN = re.compile(r"(fieldgrid|mkdir|cat)\b")


@dataclass(frozen=True)
class Block:
    """A fenced block. `first_line` is the number, in the document, of its first line."""

    language: str
    first_line: int
    lines: tuple[str, ...]
    skipped: bool


@dataclass(frozen=True)
class Command:
    """A command of a console block, with the output shown under it."""

    text: str
    line: int
    shown: tuple[str, ...]
    status: str = "0"


@dataclass(frozen=True)
class Failure:
    """What went wrong at one line of a document."""

    document: Path
    line: int
    message: str

    def __str__(self) -> str:
        return f"{self.document}:{self.line}: {self.message}"


@dataclass
class Report:
    """What became of the blocks."""

    run: int = 0
    skipped: int = 0
    failures: list[Failure] = field(default_factory=list)


def parse_blocks(text: str) -> Iterator[Block]:
    """Find the fenced blocks of a Markdown document."""
    lines = text.splitlines()
    last_text = ""
    number = 0
    while number < len(lines):
        opening = FENCE.fullmatch(lines[number])
        number += 1
        if opening is None:
            last_text = lines[number - 1].strip() or last_text
            continue
        indent, ticks = opening["indent"], opening["ticks"]
        closing = re.compile(rf"\s*{re.escape(ticks[0])}{{{len(ticks)},}}\s*")
        first = number
        while number < len(lines) and not closing.fullmatch(lines[number]):
            number += 1
        yield Block(
            language=opening["language"],
            first_line=first + 1,
            lines=tuple(line.removeprefix(indent) for line in lines[first:number]),
            skipped=NOT_RUN.fullmatch(last_text) is not None,
        )
        last_text = ""
        number += 1


def parse_commands(block: Block) -> list[Command]:
    """Split a console block into the commands that are run, and their outputs."""
    commands: list[Command] = []
    lines = list(enumerate(block.lines, block.first_line))
    while lines:
        number, line = lines.pop(0)
        if not line.startswith("$ "):
            continue  # Text before the first command belongs to none.
        text = line.removeprefix("$ ")
        while text.endswith("\\") and lines:
            text += "\n" + lines.pop(0)[1].removeprefix("> ")
        shown: list[str] = []
        while lines and not lines[0][1].startswith("$ "):
            shown.append(lines.pop(0)[1])
        commands.append(Command(text, number, tuple(shown)))

    ours: list[Command] = []
    for command, following in zip(commands, [*commands[1:], None], strict=True):
        if RUN.match(command.text):
            status = "0"
            if following is not None and following.text == STATUS_COMMAND:
                status = "".join(following.shown).strip()
            ours.append(Command(command.text, command.line, command.shown, status))
    return ours


def _trimmed(lines: Sequence[str]) -> list[str]:
    """Drop what a reader cannot see: trailing blanks and trailing empty lines."""
    kept = [line.rstrip() for line in lines]
    while kept and not kept[-1]:
        kept.pop()
    return kept


def _line_matches(shown: str, actual: str) -> bool:
    pattern = ".*".join(re.escape(part) for part in shown.split("..."))
    return re.fullmatch(pattern, actual) is not None


def output_matches(shown: Sequence[str], actual: Sequence[str]) -> bool:
    """Compare lines, a shown `...` standing for anything."""
    shown, actual = _trimmed(shown), _trimmed(actual)
    s = a = 0
    resume: tuple[int, int] | None = None  # After the last lone `...`: where to go on from.
    while a < len(actual):
        if s < len(shown) and shown[s].strip() == "...":
            s += 1
            resume = (s, a)
        elif s < len(shown) and _line_matches(shown[s], actual[a]):
            s += 1
            a += 1
        elif resume is not None:
            resume = (resume[0], resume[1] + 1)
            s, a = resume
        else:
            return False
    return all(line.strip() == "..." for line in shown[s:])


def output_diff(shown: Sequence[str], actual: Sequence[str]) -> str:
    """Describe how `actual` differs from `shown`, leaving out what `...` allows in a line."""
    shown, actual = _trimmed(shown), _trimmed(actual)
    elided = [line for line in shown if "..." in line and line.strip() != "..."]
    as_shown = [next((e for e in elided if _line_matches(e, line)), line) for line in actual]
    return "\n".join(difflib.unified_diff(shown, as_shown, "shown", "printed", lineterm=""))


def run_python(block: Block, document: Path, namespace: dict[str, Any]) -> Failure | None:
    """Execute a Python block in `namespace`."""
    # The empty lines give tracebacks the line numbers of the document.
    source = "\n" * (block.first_line - 1) + "\n".join(block.lines)
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            exec(compile(source, str(document), "exec", dont_inherit=True), namespace)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, it is reported
        beyond_exec = error.__traceback__.tb_next if error.__traceback__ else None
        frames = traceback.extract_tb(beyond_exec)
        line = next((f.lineno for f in reversed(frames) if f.filename == str(document)), None)
        if isinstance(error, SyntaxError) and error.filename == str(document):
            line = error.lineno
        message = "".join(traceback.format_exception(error.with_traceback(beyond_exec))).rstrip()
        if printed.getvalue():
            message += "\nafter printing:\n" + printed.getvalue().rstrip()
        return Failure(document, line or block.first_line, message)
    return None


def run_command(command: Command, document: Path, programs: Path) -> Failure | None:
    """Run a command, with `programs` first on the path, and compare what it prints."""
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in {"CLICOLOR_FORCE", "FORCE_COLOR", "GITHUB_ACTIONS", "PY_COLORS"}
    }
    environment |= {
        "PATH": f"{programs}{os.pathsep}{environment.get('PATH', os.defpath)}",
        "COLUMNS": str(COLUMNS),
        "TERMINAL_WIDTH": str(COLUMNS),
        "NO_COLOR": "1",
        "TERM": "dumb",
        "PYTHONIOENCODING": "utf-8",
    }
    try:
        result = subprocess.run(
            ["sh", "-c", command.text],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            env=environment,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Failure(document, command.line, f"$ {command.text}\nstill runs after {TIMEOUT_S} s")
    # The first run on a machine says that it compiles.
    actual = [
        line for line in result.stdout.splitlines() if not line.startswith("fieldgrid: compiling")
    ]
    problems = []
    if str(result.returncode) != command.status:
        problems.append(f"exit status {result.returncode}, not {command.status}")
        if output_matches(command.shown, actual):
            problems.append(result.stdout.rstrip())  # No diff will show it.
    if not output_matches(command.shown, actual):
        problems.append(output_diff(command.shown, actual))
    if problems:
        return Failure(document, command.line, "\n".join([f"$ {command.text}", *problems]))
    return None


def check_document(document: Path, examples: Path, programs: Path, report: Report) -> None:
    """Run a document's blocks in a temporary directory and add to the report."""
    text = document.read_text(encoding="utf-8")
    renewed = tables.renewed(text)
    if renewed != text:
        lines = zip(text.splitlines(), renewed.splitlines(), strict=False)
        line = next((k for k, (old, new) in enumerate(lines, 1) if old != new), 1)
        told = "a table is out of date; run: .venv/bin/python tools/tables.py"
        report.failures.append(Failure(document, line, told))
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "examples").symlink_to(examples.resolve(), target_is_directory=True)
        for block in parse_blocks(text):
            if block.language not in {"python", "console"}:
                continue
            commands = parse_commands(block) if block.language == "console" else []
            if block.language == "console" and not commands:
                continue
            if block.skipped:
                report.skipped += 1
                continue
            report.run += 1
            with contextlib.chdir(name):
                failures = (
                    [run_python(block, document, namespace)]
                    if block.language == "python"
                    else [run_command(command, document, programs) for command in commands]
                )
            report.failures += [failure for failure in failures if failure is not None]


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the documents named, or all of them, and return the exit status."""
    parser = argparse.ArgumentParser(
        description="Run the code and the commands shown in the documentation."
    )
    parser.add_argument("documents", nargs="*", type=Path, help="README.md and docs/*.md if none")
    named: list[Path] = parser.parse_args(arguments).documents
    documents = named or [
        path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
        for path in [*ROOT.glob("README.md"), *sorted(ROOT.glob("docs/*.md"))]
    ]
    report = Report()
    tables.layers_table()  # before a document adds a layer of its own
    for document in documents:
        check_document(document, ROOT / "examples", Path(sys.executable).parent, report)
    for failure in report.failures:
        print(failure, end="\n\n")
    print(
        f"{len(documents)} documents: {report.run} blocks run, {report.skipped} skipped, "
        f"{len(report.failures)} failures"
    )
    return 1 if report.failures else 0


if __name__ == "__main__":
    sys.exit(main())
