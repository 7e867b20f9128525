"""Every regular expression of the package takes time in proportion to its input.

They are found by walking the package, so that a new one is covered. Bad cases come of the pattern
itself: repeats of each of its literals and classes, alone and in pairs, whole or with an end that
does not fit, and behind what the pattern begins with.
"""

from __future__ import annotations

import ast
import importlib
import itertools
import math
import re
from collections.abc import Iterator
from pathlib import Path
from re import _constants as constants, _parser as parser  # type: ignore[attr-defined]
from time import thread_time
from types import ModuleType
from typing import Any

import pytest

import fieldgrid

SOURCE = Path(fieldgrid.__file__).parent
METHODS = ("compile", "match", "search", "fullmatch", "sub", "subn", "split", "findall", "finditer")
# Linear work on the longest of these inputs takes less than 2 ms, that by its square 300 ms.
# Linear work on such inputs takes less than 2 ms, that by the square of the last 80 ms.
LENGTHS = (24, 250, 1000, 4000)
MOST_S = 0.03
WORTH_A_LOOK_S = 0.0004

MADE_OF_PARTS = {
    "cli/options.py": "numbers between separators",
    "pipeline/staging/remote.py": "the path of a folder, escaped",
    "recordings/bag/topic_names.py": "the table of sides, which is measured",
    "recordings/tables/qualities.py": "the table of words, which is measured",
}
"""Modules where a pattern is put together, and of what."""


def module_of(path: Path) -> ModuleType:
    parts = ("fieldgrid", *path.relative_to(SOURCE).with_suffix("").parts)
    return importlib.import_module(".".join(parts).removesuffix(".__init__"))


def called(tree: ast.AST) -> Iterator[tuple[ast.expr, str, ast.Call]]:
    """Calls of methods: of what, which, and the call."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            yield node.func.value, node.func.attr, node


def value_of(node: ast.expr, scope: dict[str, Any]) -> Any:
    return eval(compile(ast.fix_missing_locations(ast.Expression(node)), "", "eval"), scope)


def found_patterns() -> Iterator[tuple[str, Any, set[str]]]:
    """Place and pattern of each use of `re`, and of the patterns that modules hold, with the ways
    in which they are used."""
    for path in sorted(SOURCE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not re.search(r"^import re$", text, re.MULTILINE):
            continue
        place = path.relative_to(SOURCE).as_posix()
        scope = vars(module_of(path))
        uses: dict[str, set[str]] = {}
        for owner, method, call in called(ast.parse(text)):
            name = owner.id if isinstance(owner, ast.Name) else ""
            if name != "re":
                uses.setdefault(name, set()).add(method)
            elif method in METHODS and method != "compile":
                flags = [k.value for k in call.keywords if k.arg == "flags"]
                flags += call.args[2:3] if method in ("match", "search", "fullmatch") else []
                try:
                    pattern, *flag = [value_of(node, scope) for node in (call.args[0], *flags)]
                except NameError:
                    assert place in MADE_OF_PARTS, f"{place}:{call.lineno}: give it a name"
                    continue
                yield f"{place}:{call.lineno}", re.compile(pattern, *flag), {method}
        anyhow = set().union(*uses.values()) & {"match", "search", "fullmatch"} or {"search"}
        for name, pattern in held(scope):
            yield f"{place} {name}", pattern, uses.get(name, set()) & set(METHODS) or anyhow


def held(values: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        flat = [value]
        for item in flat:
            if isinstance(item, re.Pattern):
                yield name, item
            elif isinstance(item, tuple | list) and len(item) < 100:
                flat += item
            elif isinstance(item, dict) and len(item) < 100:
                flat += item.values()


def atoms(tree: Any) -> list[str]:
    """A character of each literal and class, and each run of literals."""
    found: list[str] = []
    run = ""
    for kind, value in tree:
        if kind is constants.LITERAL:
            run += chr(value)
            found.append(chr(value))
            continue
        found, run = found + [run] * bool(run), ""
        if kind is constants.IN:
            found += fitting(value)
        elif kind in (constants.ANY, constants.NOT_LITERAL):
            found += ["a", " "]
        elif kind in (constants.MAX_REPEAT, constants.MIN_REPEAT, constants.POSSESSIVE_REPEAT):
            found += atoms(value[2])
        elif kind is constants.SUBPATTERN:
            found += atoms(value[3])
        elif kind is constants.BRANCH:
            found += [atom for branch in value[1] for atom in atoms(branch)]
        elif kind in (constants.ASSERT, constants.ASSERT_NOT):
            found += atoms(value[1])
        elif kind is constants.ATOMIC_GROUP:
            found += atoms(value)
    return found + [run] * bool(run)


def fitting(values: Any) -> list[str]:
    """Some characters of a class."""
    found = []
    categories = {
        constants.CATEGORY_DIGIT: "1",
        constants.CATEGORY_SPACE: " \t",
        constants.CATEGORY_WORD: "a1_",
    }
    for kind, value in values:
        if kind is constants.LITERAL:
            found.append(chr(value))
        elif kind is constants.RANGE:
            found.append(chr(value[0]))
        elif kind is constants.NEGATE:
            found += ["a", " "]
        elif kind is constants.CATEGORY:
            found += categories.get(value, "a ")
    return found


def repeats(pattern: re.Pattern[Any]) -> Iterator[tuple[str, str]]:
    """What a text that may be bad for a pattern begins with, and what it repeats then."""
    own = list(dict.fromkeys(atoms(parser.parse(pattern.pattern, pattern.flags & ~re.DEBUG))))
    usual = ["1", "a", " ", "\\", '"', "'", ".", "-", "\n", '\\"""\n']
    parts = [*dict.fromkeys([*usual, *own])][:30]
    longest = sorted(own, key=len, reverse=True)
    mixed = [*dict.fromkeys([*longest[:4], *own[:4], " ", "1"])]
    parts += ["".join(pair) for pair in itertools.permutations(mixed, 2)]
    return itertools.product(dict.fromkeys(["", *longest[:2], *own[:1]]), parts)


def is_linear(pattern: re.Pattern[Any], method: str) -> bool:
    for begin, part in repeats(pattern):
        taken_s = 0.0
        for length in LENGTHS:
            taken_s = seconds(pattern, method, begin, part, length)
            if taken_s > MOST_S:
                return False
        if taken_s > WORTH_A_LOOK_S:
            longer_s = seconds(pattern, method, begin, part, 8 * LENGTHS[-1])
            if longer_s > 20 * taken_s:
                return False
    return True


def seconds(pattern: re.Pattern[Any], method: str, begin: str, part: str, length: int) -> float:
    """The time on a text of a length, that ends with what does not fit: the least of three runs
    where it is long, since a pause that is not ours does not come thrice."""
    text = begin + part * (length // len(part)) + "\x01"
    made: Any = text.encode("latin-1", "replace") if isinstance(pattern.pattern, bytes) else text
    empty = made[:0]
    least = math.inf
    for _ in range(3):
        start = thread_time()
        found = getattr(pattern, method)(*((empty, made) if "sub" in method else (made,)))
        if method == "finditer":
            list(found)
        least = min(least, thread_time() - start)
        if least < WORTH_A_LOOK_S:
            break
    return least


def test_no_pattern_takes_the_square_of_its_input() -> None:
    found = list(found_patterns())
    assert len(found) > 80
    slow = [
        f"{place} {method}: {pattern.pattern!r}"
        for place, pattern, methods in found
        for method in sorted(methods)
        if not is_linear(pattern, method)
    ]
    assert slow == []


@pytest.mark.parametrize(
    ("pattern", "method"),
    [
        (r"[\w-]+\.", "search"),
        (r"\s*x?\s*y", "match"),
        (r"link.*:", "search"),
        (r'"{3}(?:\\.|[^\\])*?"{3}', "sub"),
    ],
)
def test_a_slow_pattern_is_found(pattern: str, method: str) -> None:
    assert not is_linear(re.compile(pattern, re.DOTALL), method)
