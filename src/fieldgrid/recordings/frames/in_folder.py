"""Paths that a table writes from the root of a disk, taken as paths inside the recording."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

_DRIVE = re.compile(r"[A-Za-z]:/")


class InFolder:
    """Where files of a recording lie in its folder, by the paths that a program wrote.

    A path from the root leads to the folder itself, or to where the folder was when it was
    recorded; then as much of the end of the path is taken as is a folder there. `elsewhere` is the
    first folder of the latter kind, '' without one. What really lies outside stays as it is, so
    that it can be refused: a recording may come from anybody.
    """

    def __init__(self, folder: Path) -> None:
        self.elsewhere = ""
        self._folder = folder
        self._known: dict[str, PurePosixPath] = {}

    def __call__(self, name: str) -> str:
        """The path in the folder; one that does not begin at a root, or leads out, unchanged."""
        if not (name.startswith("/") or _DRIVE.match(name)):
            return name
        parent, _, file = name.rpartition("/")
        if parent not in self._known:
            place = self._place(PurePosixPath(parent), file)
            if place is None:  # what is not there says nothing of what comes later
                return name
            self._known[parent] = place
        return str(self._known[parent] / file)

    def _place(self, parent: PurePosixPath, file: str) -> PurePosixPath | None:
        """The folder in the recording in which what `parent` holds is here."""
        for root in (self._folder.absolute(), self._folder.resolve()):
            if parent.is_relative_to(root) and ".." not in parent.parts:
                return parent.relative_to(root)
        if ".." in parent.parts or Path(parent).is_dir():
            return None
        for first in range(1, len(parent.parts) + 1):
            end = PurePosixPath(*parent.parts[first:])
            if (self._folder / end).is_dir() and (end.parts or (self._folder / file).exists()):
                self.elsewhere = self.elsewhere or str(parent)
                return end
        return None
