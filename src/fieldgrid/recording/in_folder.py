"""Paths that a table writes from the root of a disk, taken as paths inside the recording."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

_DRIVE = re.compile(r"[A-Za-z]:/")


class InFolder:
    """Where files of a recording lie in its folder, by the paths that a program wrote.

    A path from the root leads to the folder itself, or to where the folder was when it was
    recorded; then as much of the end of the path is taken as is there in the folder. `elsewhere`
    is the first folder of the latter kind, '' without one. What really lies outside stays as it
    is, so that it can be refused: a recording may come from anybody.
    """

    def __init__(self, folder: Path) -> None:
        self.elsewhere = ""
        self._folder = folder
        self._roots = {PurePosixPath(folder.absolute()), PurePosixPath(folder.resolve())}
        self._known: dict[str, str | None] = {}

    def __call__(self, name: str) -> str:
        """The path in the folder; one that does not begin at a root, or leads out, unchanged."""
        if not (name.startswith("/") or _DRIVE.match(name)):
            return name
        parent, _, file = name.rpartition("/")
        if parent not in self._known:
            self._known[parent] = self._place(parent, file)
        place = self._known[parent]
        return name if place is None else f"{place}{file}"

    def _place(self, parent: str, file: str) -> str | None:
        """The folder, with a stroke at its end, in which what `parent` holds is here."""
        path = PurePosixPath(parent)
        if ".." in path.parts:
            return None
        for root in self._roots:
            if path.is_relative_to(root):
                inner = path.relative_to(root).as_posix()
                return "" if inner == "." else f"{inner}/"
        if Path(parent).is_dir():
            return None
        parts = path.parts[1:]
        for k in range(len(parts) + 1):
            inner = "/".join(parts[k:])
            if (self._folder / inner / file).exists():
                self.elsewhere = self.elsewhere or parent
                return f"{inner}/" if inner else ""
        return None
