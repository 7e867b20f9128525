"""Doors: the `__init__` of a room names what other rooms may use, and loads it on first use."""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def door(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package whose `__init__.py` is `file`.

    The names are those that `file` imports under `if TYPE_CHECKING:`, so that they are stated
    once, for Python, type checkers and editors. Each is imported when it is first asked for: a
    command pays only for what it runs.
    """
    homes = {
        alias.name: statement.module or ""
        for block in ast.parse(Path(file).read_text(encoding="utf-8")).body
        if isinstance(block, ast.If)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }

    def get(name: str) -> Any:
        home = homes.get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        if home != package and hasattr(found := import_module(home), name):
            return getattr(found, name)
        return import_module(f"{home}.{name}")

    names = sorted(homes)
    return get, lambda: names, names
