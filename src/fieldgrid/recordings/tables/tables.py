"""Delimited text from anywhere, as blocks of columns: big logs in little memory.

Comma, semicolon, tab or bar; a decimal comma; a byte order mark; a ``#`` before the header.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, RecordingError, bounded_lines, check_rows, quoted
from fieldgrid.recordings.files import delimiter_of, open_log_bytes

COMMENTS = ("#", "%")
Parse = Callable[[str], float | None]
"""Reads a cell that is no plain number; None for what it cannot read either."""

NOTHING = frozenset({"", "nan", "na", "n/a", "none", "null", "nil", "-", "--", "#n/a"})
"""What loggers write, in lower case, when they have no value."""

_BLOCK_ROWS = 1 << 13
_BLOCK_CELLS = 1 << 19
_MAX_COLUMNS = 4096
_MAX_CELL = 300
"""No name, number or time is as long; what is longer is none."""
_DATA = re.compile(r"[\s\"]*[+-]?\.?\d")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+(?:[eE][+-]?\d+)?\s*")


class TableRows(NamedTuple):
    """Some rows of a table as they stand in the file, `line` being that of the first: the texts of
    their cells row after row, `width` of each, '' where a row is too short."""

    line: int
    width: int
    texts: list[str]

    @property
    def row_count(self) -> int:
        """How many rows they are."""
        return len(self.texts) // self.width

    def cells(self, column: int) -> list[str]:
        """One column."""
        return self.texts[column :: self.width]

    def row(self, k: int) -> list[str]:
        """The cells of the k-th of these rows."""
        return self.texts[k * self.width : (k + 1) * self.width]


class OpenTable:
    """An open table: its header, and its rows block by block."""

    def __init__(self, path: Path, lines: Iterator[str]) -> None:
        self.path, self._lines = path, lines
        self._line = 0
        first, taken = split_header(self._counted())
        if not first:
            raise RecordingError(f"{self.path} is empty; give a table with a header.")
        self._delimiter = delimiter_of(first)
        (names,) = csv.reader([first.lstrip("#% ")], delimiter=self._delimiter)
        if len(names) > _MAX_COLUMNS:
            raise RecordingError(f"{self.path} has {len(names)} columns; check the file.")
        self.header = tuple(name.strip()[:_MAX_CELL] for name in names)
        self._line -= len(taken)
        self._lines = chain(taken, self._lines)
        self._quoted: Iterator[list[str]] | None = None
        # A block of a wide table is as large as one of a narrow one.
        self._block_rows = max(
            1, min(_BLOCK_ROWS, _BLOCK_CELLS // (1 + first.count(self._delimiter)))
        )
        self.sample = self._block(self._line + 1)
        """The first block, which decides how the columns are understood."""
        self.decimal_comma = self._delimiter != "," and any(
            map(_DECIMAL_COMMA.fullmatch, self.sample.texts[: 100 * self.sample.width])
        )

    def _counted(self) -> Iterator[str]:
        for line in self._lines:
            self._line += 1
            yield line

    def blocks(self) -> Iterator[TableRows]:
        """All rows from the first; empty lines are rows without cells."""
        block, first = self.sample, self.sample.line
        while block.row_count:
            line = block.line + block.row_count
            check_rows(line - first, self.path)
            yield block
            block = self._block(line)

    def _block(self, line: int) -> TableRows:
        if self._quoted is None:
            lines = list(islice(self._lines, self._block_rows))
            text = "".join(lines)
            if '"' not in text:
                even = _even_rows(line, len(lines), text, self._delimiter)
                if even is not None and even.width >= len(self.header):
                    return even
                return self._filled(line, csv.reader(lines, delimiter=self._delimiter))
            # A cell in quotes may go on in the next line, and so in the next block.
            self._quoted = csv.reader(chain(lines, self._lines), delimiter=self._delimiter)
        return self._filled(line, islice(self._quoted, self._block_rows))

    def _filled(self, line: int, uneven: Iterable[list[str]]) -> TableRows:
        """Rows whose numbers of cells differ."""
        rows = list(uneven)
        width = max(len(self.header), *map(len, rows), 0)
        blank = [""] * width
        return TableRows(line, width, [cell for row in rows for cell in (row + blank)[:width]])

    def numbers(self, block: TableRows, column: int, parse: Parse | None = None) -> Float64:
        """One column as numbers, NaN where there is none; an error names line and cell. `parse`
        reads what is no plain number."""
        cells = block.cells(column)
        if self.decimal_comma:
            cells = [cell.replace(",", ".") for cell in cells]
        try:
            values = np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            lines = enumerate(cells, block.line)
            values = np.array([self._number(cell, line, column, parse) for line, cell in lines])
        values[np.isinf(values)] = np.nan
        return values

    def _number(self, cell: str, line: int, column: int, parse: Parse | None) -> float:
        try:
            return float("nan") if cell.strip().lower() in NOTHING else float(cell)
        except ValueError:
            value = parse(cell) if parse is not None and len(cell) <= _MAX_CELL else None
            if value is not None:
                return value
            raise self.error(line, column, cell, "is not a number") from None

    def error(self, line: int, column: int, cell: str, what: str) -> RecordingError:
        """The error that a cell `is not` something."""
        name = self.header[column]
        return RecordingError(
            f"{self.path}, line {line}: {name} {quoted(cell)} {what}; correct it."
        )


def _even_rows(line: int, count: int, text: str, delimiter: str) -> TableRows | None:
    """The rows of lines without quotes, in a third of the time that the csv module takes; None
    where their numbers of cells differ."""
    text = text.replace("\r\n", "\n")
    if "\r" in text or not text:
        return None
    text += "" if text.endswith("\n") else "\n"
    width = text.count(delimiter, 0, text.index("\n")) + 1
    # The ends of the lines as cells of their own, which have to be each one after so many.
    texts = text.replace("\n", f"{delimiter}\n{delimiter}").split(delimiter)[:-1]
    if len(texts) != count * (width + 1) or set(texts[width :: width + 1]) != {"\n"}:
        return None
    del texts[width :: width + 1]
    return TableRows(line, width, texts)


@contextmanager
def open_table(path: Path) -> Iterator[OpenTable]:
    """The table in a file, packed by gzip or not. What breaks while reading names the file."""
    with open_lines(path) as lines:
        yield OpenTable(path, lines)


@contextmanager
def open_lines(path: Path) -> Iterator[Iterator[str]]:
    """The lines of a table with their ends, of any encoding."""
    with open_log_bytes(path) as stream:
        start = stream.peek(4) if isinstance(stream, io.BufferedReader) else b""
        text = io.TextIOWrapper(stream, encoding=_encoding(start), errors="replace", newline="")
        try:
            # What a power cut leaves in a file are blocks of NUL.
            yield bounded_lines(text, path, without="\0")
        except (csv.Error, UnicodeError) as problem:
            raise RecordingError(
                f"{path} is not a CSV file: {problem}; correct or export it again."
            ) from problem
        finally:
            text.detach()


def _encoding(start: bytes) -> str:
    """The encoding of a file by how it starts: UTF-8 where that is possible, else Latin-1, which
    decodes everything: an umlaut in a remark must not cost the drive."""
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def split_header(lines: Iterable[str]) -> tuple[str, list[str]]:
    """The header, '' when there is none, and the lines of data that were taken to find it.

    It is the first line that is neither empty nor a remark; or the last remark, where numbers
    follow it.
    """
    remark = ""
    for line in lines:
        if not line.strip() or line.lower().startswith("sep="):  # Excel's hint to itself
            continue
        if line.startswith(COMMENTS):
            remark = line
        elif remark and _DATA.match(line):
            return remark, [line]
        else:
            return line, []
    return remark, []
