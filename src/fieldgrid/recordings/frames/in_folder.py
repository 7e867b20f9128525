"""Paths that a table writes from the root of a disk, taken as paths inside the recording."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

_DRIVE = re.compile(r"[A-Za-z]:/")


class InFolder:
    """Where files of a recording lie in its folder, by the paths that a program wrote.

    A path from the root leads to the folder itself, or to where the folder was when it was
    recorded; then as much of the end of the path is taken as is there in the folder, of a file
    that is missing as much as is a folder there. `elsewhere` is the first folder of the latter
    kind, '' without one. What really lies outside stays as it is, so that it can be refused: a
    recording may come from anybody.
    """

    def __init__(self, folder: Path) -> None:
        self.elsewhere = ""
        self._folder = folder
        self._roots = {PurePosixPath(folder.absolute()), PurePosixPath(folder.resolve())}
        self._known: dict[str, str] = {}

    def __call__(self, name: str) -> str:
        """The path in the folder; one that does not begin at a root, or leads out, unchanged."""
        if not (name.startswith("/") or _DRIVE.match(name)):
            return name
        parent, _, file = name.rpartition("/")
        place = self._known.get(parent)
        if place is None:
            place = self._place(parent, file)
        return name if place is None else f"{place}{file}"

    def _place(self, parent: str, file: str) -> str | None:
        """The folder, with a stroke at its end, in which what `parent` holds is here. It is kept
        where the file is there; a missing one says nothing of those after it."""
        path = PurePosixPath(parent)
        if ".." in path.parts:
            return None
        for root in self._roots:
            if path.is_relative_to(root):
                return self._kept(parent, path.relative_to(root).as_posix())
        if Path(parent).is_dir():
            return None
        ends = ["/".join(path.parts[k:]) for k in range(1, len(path.parts) + 1)]
        for inner in ends:
            if (self._folder / inner / file).exists():
                self.elsewhere = self.elsewhere or parent
                return self._kept(parent, inner)
        return next((f"{end}/" for end in ends if end and (self._folder / end).is_dir()), None)

    def _kept(self, parent: str, inner: str) -> str:
        place = "" if inner in ("", ".") else f"{inner}/"
        self._known[parent] = place
        return place
