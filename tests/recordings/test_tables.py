"""Tables in blocks: the same cells as the csv module gives, whichever way they are read."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from fieldgrid.recordings.tables import tables
from fieldgrid.recordings.tables.tables import open_table

EVEN = "".join(f"{k},{k / 8},x{k}\n" for k in range(20))

TABLES = {
    "even": EVEN,
    "no end of line": EVEN[:-1],
    "CR and LF": EVEN.replace("\n", "\r\n"),
    "CR alone": EVEN.replace("\n", "\r"),
    "other cells, as many": EVEN.replace("3,0.375,x3\n4,0.5,x4", "3,0.375\n4,0.5,x4,x3"),
    "a short row": EVEN.replace(",0.375,x3", ""),
    "a long row": EVEN.replace("x3", "x3,y,z"),
    "longer than the header": EVEN.replace("\n", ",\n"),
    "shorter than the header": EVEN.replace(",x", "x"),
    "an empty line": EVEN.replace("\n5,", "\n\n5,"),
    "a quoted comma": EVEN.replace("x5", '"x,5"'),
    "a quoted end of line over the end of a block": EVEN.replace("x3", '"x\n\n\n3"'),
    "a quote inside": EVEN.replace("x3", 'x"3'),
    "power cuts": EVEN.replace("x3", "\0x\0\0" + 3 * "\0"),
    "blanks": EVEN.replace(",", " , "),
    "other line ends": EVEN.replace("x3", "x\x0b3\u2028\x85"),
    "empty": "",
}


@pytest.mark.parametrize("what", TABLES)
@pytest.mark.parametrize("block_rows", [1, 4, 7, 1000])
def test_cells_are_those_of_the_csv_module(
    what: str, block_rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "_BLOCK_ROWS", block_rows)
    path = tmp_path / "table.csv"
    path.write_text("a,b,c\n" + TABLES[what], encoding="utf-8", newline="")
    expected = list(csv.reader(io.StringIO(TABLES[what].replace("\0", ""), newline="")))
    with open_table(path) as table:
        blocks = list(table.blocks())
    rows = [block.row(k) for block in blocks for k in range(block.row_count)]
    for row, other in zip(rows, expected, strict=True):
        assert row[: len(other)] == other
        assert not any(row[len(other) :])
    for column in range(3):
        cells = [cell for block in blocks for cell in block.cells(column)]
        assert cells == [row[column] for row in rows]
    assert [block.line for block in blocks] == [2 + k for k in range(0, len(rows), block_rows)]


def test_even_lines_are_not_read_by_the_csv_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, read = tmp_path / "table.csv", []
    path.write_text("a,b,c\n" + EVEN)
    with open_table(path) as table:
        monkeypatch.setattr(csv, "reader", lambda lines, **_: read.extend(lines) or [])
        assert sum(block.row_count for block in table.blocks()) == 20
    assert not read
