"""Maps that are opened when they are needed, a bounded number at a time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from weakref import WeakKeyDictionary

from fieldgrid.core import Closing, MapError
from fieldgrid.maps.farm.catalogue import FarmBlock
from fieldgrid.maps.file.map_file import MapFile
from fieldgrid.maps.file.store import open_map
from fieldgrid.maps.views.content import MapContent
from fieldgrid.maps.views.sources import CellSource

MAX_OPEN = 64
"""Maps that stay open when nobody reads them."""

_CACHE_KIB = 4096
"""Pages that each of them may keep, so that all keep 256 MB."""


class OpenMap:
    """A map that is open, and what cells are read from in it for requests that are under way."""

    def __init__(self, universal: MapFile) -> None:
        self.universal = universal
        self.content: MapContent
        self.sources: WeakKeyDictionary[object, CellSource] = WeakKeyDictionary()
        self.lock = threading.Lock()
        self.users, self._state = 0, ExitStack()
        self._version: int | None = None

    def begin(self, root_sha256: str) -> None:
        """One more reads it; all who do so at a time see one state of it."""
        if self.users == 0:
            self.content = self._state.enter_context(self.universal.content())
            connection = self.content.evidence.connection
            if self._version is None:
                connection.execute(f"PRAGMA cache_size = -{_CACHE_KIB}")
            (version,) = connection.execute("PRAGMA data_version").fetchone()
            # Which other programs' commits change: only then is the digest made again.
            if version != self._version and self.universal.root_sha256 != root_sha256:
                self._state.close()
                raise MapError(
                    f"{self.universal.path} has changed since the farm was opened; open it again."
                )
            self._version = version
        self.users += 1

    def end(self) -> None:
        """One fewer reads it."""
        self.users -= 1
        if self.users == 0:
            self._state.close()


class Maps(Closing):
    """The maps of a farm, from any thread."""

    def __init__(self, most: int = MAX_OPEN) -> None:
        self._most = most
        self._open: dict[Path, OpenMap] = {}  # what was used last comes last
        self._lock = threading.Lock()

    @contextmanager
    def reading(self, block: FarmBlock) -> Iterator[OpenMap]:
        """A map, open. MapError when it is not the one that was listed."""
        with self._lock:
            opened = self._open.pop(block.path, None) or OpenMap(open_map(block.path))
            self._open[block.path] = opened
            opened.begin(block.root_sha256)
        try:
            yield opened
        finally:
            with self._lock:
                opened.end()
                self._close_idle(self._most)

    def close(self) -> None:
        """Close the maps that nobody reads."""
        with self._lock:
            self._close_idle(0)

    def _close_idle(self, most: int) -> None:
        for path in [path for path, one in self._open.items() if one.users == 0]:
            if len(self._open) <= most:
                break
            self._open.pop(path).universal.close()
