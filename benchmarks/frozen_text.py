"""The figures in what a benchmark prints: each number with a name that is made of the text.

A benchmark prints tables of aligned columns and sentences. The name of a figure is made of the
lines above it that are indented less, the title of its table, the label of its line, and its
column's header; in a sentence, the clause around the number takes the place of the header. Numbers
in names are written as #, except those of labels. What has a name that was given already gets a
counter. So the same text gives the same names, and a line more or less changes no other name,
unless it has the label of others.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

_NUMBER = re.compile(
    r"(?<![\w.])(?<![\w:]-)(?<!\d:)(?<!was )(?<!>= )(?<!<= )(?<!≥ )(?<!≤ )(?<!(?<!-)> )(?<!< )"
    r"[+-]?(?:\d{1,3}(?:,\d{3})++(?![\d,])|\d++)(?:\.\d+)?+(?:e[+-]?\d+)?+(?![-:]\d)"
)
"""Not what is glued to a word (SF1), a part of a date, or the bound of what was asked (>= 95)."""

_UNIT = re.compile(r" ?[^\s\d,;:()]*")
_GLUED = re.compile(r"\S*")
_CELL = re.compile(r"\S+(?: \S+)*")
_CLAUSE_END = re.compile(r"[,;:](?=\s|$)|[()]|\s{2,}")
_WORD = re.compile(r"[^\W\d_]{3,}")
_NAME = re.compile(r"[^\d+-].*\D")
_GAP = re.compile(r" {4,}")
_BETWEEN = re.compile(r"(?: ?[%°])?(?: {2,8}| ± )")
_TOUCHING = re.compile(r"[^\W\d_]{3,} $")
_COLON = re.compile(r"(?:[^: ]|:(?! )| (?! ))+: ")
"""
_NAME   a cell of a header that is not a number.
_GAP    between the label of a sentence and what is said.
_BETWEEN, _TOUCHING: between two values of a row, and between words and a number of a sentence.
_COLON  a label and its colon.
"""

_SKIPPED = re.compile(r"\s*asked|.*cores, Python")
"""Lines of what was asked, and of the versions of libraries."""

_NO_FIGURES = ("seed",)
"""Columns that name a case."""

_LINES_TO_FIRST_ROW = 3
"""Between a header and the first row of its table may be what was asked."""


class Figure(NamedTuple):
    """A number that is printed: its name, what follows it, its decimals, and the number of drives
    that its line says it is of."""

    name: str
    value: float
    unit: str
    decimals: int
    drives: float | None = None


class _Number(NamedTuple):
    """A number in a line, the columns in which it and its unit may be said to end, and the word
    behind it."""

    start: int
    end: int
    ends: tuple[int, ...]
    word: str

    @property
    def unit(self) -> str:
        """The word without marks."""
        return self.word.strip(" ?*.")


class _Header(NamedTuple):
    """The columns of a table: where each ends, and its name; and what stands above the labels."""

    title: str
    columns: list[tuple[int, str]]

    def column_of(self, number: _Number) -> int | None:
        """The column that ends where the number does."""
        for k, (end, _) in enumerate(self.columns):
            if end in number.ends:
                return k
        return None

    def values(self, line: str) -> list[_Number]:
        """The numbers of a line that stand in columns; none where the line is no row."""
        numbers = [n for n in _numbers(line) if n.start < self.columns[-1][0]]
        first = next((n for n in numbers if self.column_of(n) is not None), None)
        if first is None:
            return []
        start = _start_of_run(line, numbers, first)
        if _TOUCHING.search(line[:start]):
            return []
        inside = [n for n in numbers if n.start >= start]
        aligned = sum(self.column_of(n) is not None for n in inside)
        return inside if 2 * aligned >= len(inside) else []

    def name_of(self, number: _Number) -> str:
        """The header above a number: the first column that does not end before it."""
        column = self.column_of(number)
        if column is None:
            column = next(k for k, (end, _) in enumerate(self.columns) if end > number.start)
        return self.columns[column][1]


def figures_of(text: str) -> list[Figure]:
    """All figures of a text, in its order, with different names."""
    found, seen = [], Counter[str]()
    for figure in _figures(text.splitlines()):
        seen[figure.name] += 1
        count = seen[figure.name]
        name = figure.name if count == 1 else f"{figure.name} ({count})"
        found.append(figure._replace(name=name))
    return found


def _figures(lines: Sequence[str]) -> Iterator[Figure]:
    header: _Header | None = None
    above: list[tuple[int, str]] = []
    for k, line in enumerate(lines):
        if not line.strip():
            header = None
            continue
        if _SKIPPED.match(line):
            continue
        least = 0.5 if header else 0.0
        new = _header_of(line, lines[k + 1 : k + 1 + _LINES_TO_FIRST_ROW], least)
        if new is not None:
            header = new
            continue
        values = header.values(line) if header else []
        indent = len(line) - len(line.lstrip())
        above = [one for one in above if one[0] < indent]
        titles = [label for _, label in above]
        if values:
            assert header is not None
            label = _plain(line[: values[0].start])
            titles += [header.title] if header.title else []
            yield from _of_row([*titles, label], line, values, header)
        else:
            label, start = _label(line)
            of = _of_text if header and line[:start].endswith("   ") else _of_sentence
            yield from of([*titles, label], line, start)
        above.append((indent, label))


def _header_of(line: str, below: Sequence[str], least: float) -> _Header | None:
    """A line is a header if numbers of a line below end where its cells do, the first of them below
    a name; of its cells two, and more than the least share, are names."""
    cells = list(_CELL.finditer(line))
    for row in below:
        if not row.strip():
            return None
        titled = cells[0].start() <= len(row) - len(row.lstrip())
        columns = [(cell.end(), cell[0]) for cell in cells[titled:]]
        named = sum(bool(_NAME.fullmatch(name)) for _, name in columns)
        if named < 2 or named <= least * len(columns):
            return None
        header = _Header(cells[0][0] if titled else "", columns)
        values = header.values(row)
        if values and _NAME.fullmatch(header.name_of(values[0])):
            return header
    return None


def _start_of_run(line: str, numbers: Sequence[_Number], last: _Number) -> int:
    """Where the numbers begin that stand before one with nothing but narrow gaps between."""
    start = last.start
    for number in reversed(numbers):
        if number.end <= start and _BETWEEN.fullmatch(line, number.end, start):
            start = number.start
    return start


def _of_row(
    path: list[str], line: str, values: Sequence[_Number], header: _Header
) -> Iterator[Figure]:
    named = [(header.name_of(number), number) for number in values]
    drives = next((_value(line, n) for name, n in named if name == "drives"), None)
    for name, number in named:
        if name not in _NO_FIGURES:
            yield _figure([*path, name], line, number, drives)
    yield from _of_text(path, line, values[-1].end + len(values[-1].word))


def _of_text(path: list[str], line: str, start: int) -> Iterator[Figure]:
    """The figures of what is said in or behind a row: sentences for users, whose words change."""
    for number in _numbers(line):
        if number.start >= start:
            yield _figure([*path, "text"], line, number)


def _of_sentence(path: list[str], line: str, start: int) -> Iterator[Figure]:
    """The figures of a line from a place on, named by their clauses."""
    for first, last in _clauses(line, start):
        numbers = [n for n in _numbers(line) if first <= n.start < last]
        name = _plain(_without_numbers(line, numbers, first, last))
        for number in numbers:
            yield _figure([*path, name], line, number)


def _clauses(line: str, start: int) -> Iterator[tuple[int, int]]:
    """From where to where clauses reach; what has no word belongs to the clause before."""
    spans: list[tuple[int, int]] = []
    for end in [*(m.end() for m in _CLAUSE_END.finditer(line, start)), len(line)]:
        begin = spans[-1][1] if spans else start
        if spans and not _WORD.search(line, begin, end):
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    yield from spans


def _label(line: str) -> tuple[str, int]:
    """What a sentence is called, and where its figures begin: what stands before a wide gap, else
    before a colon, else before the first number. A narrow gap pads a number."""
    numbers = [number.start for number in _numbers(line)]
    body = len(line) - len(line.lstrip())
    if not numbers:
        return _plain(line), len(line)
    for mark in (_GAP.search(line, body), _COLON.match(line, body)):
        if mark and mark.end() <= numbers[-1] and _WORD.search(line, body, mark.end()):
            return _plain(line[body : mark.end()].rstrip()), mark.end()
    return _plain(line[: numbers[0]]), numbers[0]


def _without_numbers(line: str, numbers: Sequence[_Number], first: int, last: int) -> str:
    out = ""
    for number in numbers:
        out += line[first : number.start] + "#"
        first = number.end
    return out + line[first:last]


def _plain(text: str) -> str:
    """Without signs around it, with single spaces, and without what divides the parts of a name."""
    text = " ".join(text.split()).strip(" ,;:(").removesuffix(" -").replace(" / ", "/")
    return text if "(" in text else text.strip(")")


def _numbers(line: str) -> list[_Number]:
    found = []
    for match in _NUMBER.finditer(line):
        unit = _UNIT.match(line, match.end())
        glued = _GLUED.match(line, match.end())
        assert unit is not None
        assert glued is not None
        ends = (match.end(), glued.end(), unit.end())
        found.append(_Number(match.start(), match.end(), ends, unit[0]))
    return found


def _value(line: str, number: _Number) -> float:
    return float(line[number.start : number.end].replace(",", ""))


def _figure(path: list[str], line: str, number: _Number, drives: float | None = None) -> Figure:
    text = line[number.start : number.end]
    mantissa, _, power = text.partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(power or 0)
    name = " / ".join(part for part in path if part)
    return Figure(name, _value(line, number), number.unit, decimals, drives)
