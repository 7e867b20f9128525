"""How large the package is, room by room, and how many functions its commands run through.

`make size` prints the figures beside the budgets of the rooms and compares them with those of
`tools/size.json`:

* The statements of the package may only fall.
* A room above its budget may only grow for a capability: `"grown"` in `tools/size.json` names it.
* The functions that `build`, `track` and `export` run through may only fall.

`python tools/size.py --write` keeps the figures of now, where these rules allow it.

Statements are counted from the syntax tree, without docstrings, imports and `pass`, so that the
length of lines does not count. `once` are private functions that their module names a single time,
`records` are NamedTuples and dataclasses, `numbers` are numbers with a name at module level, and
`sentences` are strings of six words or more that are not docstrings.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "tools" / "size.json"
PACKAGE = ROOT / "src" / "fieldgrid"
DRIVE = ROOT / "examples" / "two_lanes"

COLUMNS = (
    *("files", "lines", "statements", "functions", "once"),
    *("classes", "records", "numbers", "sentences"),
)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
UNCOUNTED = (ast.Import, ast.ImportFrom, ast.Pass)


def measure(text: str) -> Counter[str]:
    """The figures of one module."""
    tree = ast.parse(text)
    nodes = list(ast.walk(tree))
    docstrings = set(standing_alone(nodes))
    named = Counter(n.id for n in nodes if isinstance(n, ast.Name))
    named.update(n.attr for n in nodes if isinstance(n, ast.Attribute))
    found = Counter(files=1, lines=text.count("\n"))
    for node in nodes:
        if isinstance(node, ast.stmt) and not isinstance(node, UNCOUNTED):
            found["statements"] += node not in docstrings
        if isinstance(node, FUNCTIONS):
            found["functions"] += 1
            private = node.name.startswith("_") and not node.name.startswith("__")
            found["once"] += private and named[node.name] <= 1
        elif isinstance(node, ast.ClassDef):
            found["classes"] += 1
            marks = [ast.unparse(mark) for mark in (*node.bases, *node.decorator_list)]
            found["records"] += any("NamedTuple" in m or "dataclass" in m for m in marks)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            words = len(re.findall(r"\w+", node.value))
            found["sentences"] += words >= 6 and node not in docstrings
    found["numbers"] = sum(named_numbers(statement) for statement in tree.body)
    return found


def standing_alone(nodes: list[ast.AST]) -> Iterator[ast.AST]:
    """Docstrings, those of attributes included: the statements, and their strings."""
    for node in nodes:
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else ():
            value = statement.value if isinstance(statement, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield statement
                yield value


def named_numbers(statement: ast.stmt) -> int:
    """How many numbers a statement at module level gives a name."""
    if isinstance(statement, ast.Assign):
        target, value = statement.targets[0], statement.value
    elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
        target, value = statement.target, statement.value
    else:
        return 0
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        return sum(is_number(element) for element in value.elts)
    return int(is_number(value))


def is_number(node: ast.expr) -> bool:
    """Whether an expression is a number, or is made of numbers alone."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    if isinstance(node, ast.Attribute):
        return node.attr == "pi"
    parts = node.args if isinstance(node, ast.Call) else getattr(node, "elts", [])
    made = isinstance(node, ast.Call | ast.Tuple) and bool(parts)
    return made and all(is_number(part) for part in parts)


def rooms(package: Path) -> dict[str, Counter[str]]:
    """The figures of each folder of a package; of its own modules as `(root)`."""
    table: dict[str, Counter[str]] = {}
    for path in sorted(package.rglob("*.py")):
        first, *inner = path.relative_to(package).parts
        room = table.setdefault(first if inner else "(root)", Counter())
        room.update(measure(path.read_text(encoding="utf-8")))
    return table


def trace(words: list[str]) -> int:
    """Run a command in this process; the number of distinct functions that it runs through.

    Those of `cli` do not count.
    """
    called: set[tuple[str, str]] = set()
    source = f"{PACKAGE}/"

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        is_function = code.co_flags & 1 and not code.co_name.startswith("<")
        if event == "call" and is_function and code.co_filename.startswith(source):
            called.add((code.co_filename.removeprefix(source), code.co_qualname))

    from fieldgrid.cli import app

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        app(words, standalone_mode=False)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return sum(not file.startswith("cli/") for file, _ in called)


def runs() -> dict[str, int]:
    """The functions that three commands on the example run through, each in its own process.

    A build is run twice: the first run on a machine compiles.
    """
    with tempfile.TemporaryDirectory() as folder:
        build = ["build", str(DRIVE), "-o", f"{folder}/m.gpkg", "--gnss", "gnss_rtk.nmea"]
        log = f"{DRIVE}/gnss/gnss_rtk.nmea"
        traced(build)
        return {
            "build": traced([*build, "--overwrite"]),
            "track": traced(["track", log, "-o", f"{folder}/track.csv"]),
            "export": traced(["export", f"{folder}/m.gpkg", f"{folder}/m.tif"]),
        }


def traced(words: list[str]) -> int:
    """`trace` in a process of its own."""
    command = [sys.executable, __file__, "--trace", *words]
    ran = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    return int(ran.stdout.split()[-1])


def problems(now: Mapping[str, Any], kept: Mapping[str, Any]) -> list[str]:
    """What grew against the rules, a sentence each."""
    found = []
    total, last = (sum(figures["statements"].values()) for figures in (now, kept))
    if total > last:
        found.append(f"The package has {total} statements, {total - last} more than kept.")
    for room, statements in now["statements"].items():
        budget, last = kept["budget"].get(room, 0), kept["statements"].get(room, 0)
        if statements > max(budget, last) and room not in kept["grown"]:
            found.append(
                f"{room} has {statements} statements, {last} were kept, its budget is {budget}: "
                'take out more than you add, or name the capability in "grown" of tools/size.json.'
            )
    for command, functions in now["runs"].items():
        if functions > kept["runs"][command]:
            found.append(
                f"{command} runs through {functions} functions, {kept['runs'][command]} were kept."
            )
    return found


def report(
    table: Mapping[str, Counter[str]], now: Mapping[str, Any], kept: Mapping[str, Any]
) -> str:
    """The tables of `make size`."""
    total = sum(table.values(), Counter[str]())
    lines = [f"{'':<12}{'budget':>8}" + "".join(f"{column:>11}" for column in COLUMNS)]
    for room in (*sorted(table, key=lambda name: -table[name]["statements"]), "all"):
        row = total if room == "all" else table[room]
        budget = sum(kept["budget"].values()) if room == "all" else kept["budget"].get(room, 0)
        lines.append(f"{room:<12}{budget:>8}" + "".join(f"{row[c]:>11}" for c in COLUMNS))
    lines.append("")
    for command, functions in now["runs"].items():
        ceiling, goal = kept["runs"][command], kept["goals"][command]
        lines.append(f"{command} runs through {functions} functions ({ceiling} kept, goal {goal})")
    return "\n".join(lines)


def main() -> int:
    """0 where nothing grew against the rules, else 1."""
    if sys.argv[1:2] == ["--trace"]:
        print(trace(sys.argv[2:]))
        return 0
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="keep the figures of now")
    given = parser.parse_args()
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    table = rooms(PACKAGE)
    statements = {room: table[room]["statements"] for room in sorted(table)}
    now = {"statements": statements, "runs": runs()}
    print(report(table, now, kept))
    found = problems(now, kept)
    if given.write and not found:
        KEPT.write_text(json.dumps({**kept, **now}, indent=1) + "\n", encoding="utf-8")
    for problem in found:
        print(f"tools/size.py: {problem}", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
