"""Write the tables of the documentation that follow from declarations in the code.

A document holds a table between `<!-- table: NAME -->` and `<!-- end of table -->`. Run as a
script, all of them are made again; `tools/check_docs.py` reports those that are out of date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MARKED = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def settings_table() -> str:
    """Every setting of a build."""
    from fieldgrid.core import BuildSettings, declared

    rows, last = [], ""
    for one in declared(BuildSettings):
        table = "" if one.table == last else f"`{one.table}`"
        last = one.table
        flag = ""
        if one.flag is not None:
            flag = f"`{one.flag.name.partition('/')[0]} {one.flag.metavar}".rstrip() + "`"
        says = one.info.description or ""
        rows.append((table, f"`{one.path[-1]}`", one.usual, one.limits, flag, says))
    return markdown(("table", "key", "default", "range", "flag", "meaning"), rows)


def formats_table() -> str:
    """Every format of an export."""
    from fieldgrid.export import Holds, formats

    rows = []
    for one in formats().values():
        endings = " ".join(f"`{ending}`" for ending in one.endings)
        extras = " ".join(f"`{extra}`" for extra in one.extras)
        layers = "" if one.holds is Holds.ANY else one.holds.value
        rows.append((f"`{one.name}`", endings, one.says, one.readers, layers, extras, one.limits))
    columns = ("format", "ending", "what it is", "for whom", "holds", "extra", "limit")
    return markdown(columns, rows)


def export_options_table() -> str:
    """Every option of a format."""
    from fieldgrid.export import formats

    rows: dict[str, list[str]] = {}
    for known in formats().values():
        for one in known.declared():
            assert one.flag is not None
            flag = f"`{one.flag.name.partition('/')[0]} {one.flag.metavar}".rstrip() + "`"
            row = rows.setdefault(
                flag, [flag, f"`{one.path[-1]}`", one.usual, "", one.info.description or ""]
            )
            row[3] += f"{', ' if row[3] else ''}`{known.name}`"
    return markdown(("flag", "in Python", "default", "formats", "meaning"), list(rows.values()))


@cache
def layers_table() -> str:
    """Every built-in layer of a map: those that are registered when it is first asked for."""
    from fieldgrid.maps import LAYERS

    rows = [(f"`{one.name}`", one.unit or "-", one.dtype, one.meaning) for one in LAYERS.values()]
    return markdown(("layer", "unit", "type", "meaning"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "settings": settings_table,
    "formats": formats_table,
    "export-options": export_options_table,
    "layers": layers_table,
}


def markdown(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"

    return line(columns) + "|---" * len(columns) + "|\n" + "".join(map(line, rows))


def renewed(text: str) -> str:
    """A document with its tables as they follow from the code."""
    return MARKED.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}{found[3]}", text)


def documents() -> Iterator[Path]:
    """The documents of the project."""
    yield ROOT / "README.md"
    yield from sorted((ROOT / "docs").glob("*.md"))


def main() -> None:
    """Make the tables of all documents again."""
    for document in documents():
        text = document.read_text(encoding="utf-8")
        new = renewed(text)
        if new != text:
            document.write_text(new, encoding="utf-8")
            print(document.relative_to(ROOT), file=sys.stderr)


if __name__ == "__main__":
    main()
