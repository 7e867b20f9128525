"""What a server shows: maps, opened anew for each request, so that a reload shows what is there.

A map may be appended to, or replaced by another build, while it is shown. Opening one takes about
a millisecond, and what is dear to make is kept until the file has changed.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple, TypeVar

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import Bounds, Datum, TileIndex
from fieldgrid.maps import DrivenMap, MapFile, Mark, open_map
from fieldgrid.view import drives, pyramid
from fieldgrid.view.features import read_features

_Made = TypeVar("_Made")

_KEPT = 64


class Identity(NamedTuple):
    """What a page relies on until it is loaded again: places are metres from a datum, and sessions
    are counted in their order (name and date of creation of each)."""

    datum: Datum
    cell_m: float
    sessions: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, universal: DrivenMap) -> Identity:
        """That of an open map."""
        return cls(
            universal.datum,
            universal.cell_m,
            tuple((info.name, info.created) for info in universal.sessions()),
        )


class ShownSource(ABC):
    """A map or a farm: its place, the version of what is in it, and what was made of it."""

    def __init__(self, path: Path, name: str, folder: Path) -> None:
        self.path = path
        self.name = name
        """What the page calls it."""
        self.folder = folder
        """Where its maps lie, and perhaps the images that they name."""
        self._lock = Lock()
        self._kept: dict[tuple[str, ...], Any] = {}
        self._version = ""
        self._described: Identity | None = None

    @abstractmethod
    def version(self) -> str:
        """Text that differs once a file was written to or replaced."""

    @abstractmethod
    def open(self) -> AbstractContextManager[DrivenMap]:
        """What is read of it."""

    def open_alone(self) -> AbstractContextManager[DrivenMap]:
        """What is read of it for long, during which other requests go on."""
        return self.open()

    @abstractmethod
    def levels(self) -> int:
        """How many zoom levels there are above that of its own cells."""

    @abstractmethod
    def density(self, level: int, tile: TileIndex) -> bytes | None:
        """The PNG of a tile of the density of all sessions; None where nothing was observed."""

    @abstractmethod
    def marks(self) -> tuple[Mark, ...]:
        """The marks that its list has."""

    @abstractmethod
    def features(self) -> list[dict[str, Any]]:
        """The tables of features that it holds."""

    @abstractmethod
    def frames(self, bounds: Bounds) -> list[drives.FrameTable]:
        """The frames of which some may reach into bounds."""

    def describe(self, universal: DrivenMap) -> None:
        """Note which map a page is told of, so that it gets nothing of another."""
        self._described = Identity.of(universal)

    def check_same(self) -> None:
        """Raise MapError where it is not there, or is another than was described."""
        found, told = self.kept(("identity",), Identity.of), self._described
        # Sessions may have been appended.
        if told is not None and told != found._replace(
            sessions=found.sessions[: len(told.sessions)]
        ):
            raise MapError(
                f"{self.path} is another map than the page was loaded with, or its sessions have "
                "other names; load the page again."
            )

    def kept(self, key: tuple[str, ...], make: Callable[..., _Made]) -> _Made:
        """What `make` makes of the open map or farm, made once for each version."""
        version = self.version()
        with self._lock:
            if version != self._version:
                self._kept.clear()
                self._version = version
            if key in self._kept:
                found: _Made = self._kept[key]
                return found
        with self.open() as universal:
            made = make(universal)
        with self._lock:
            # A commit meanwhile: it may be of the state before, and is not kept.
            if version == self._version:
                while len(self._kept) >= _KEPT:
                    self._kept.pop(next(iter(self._kept)))
                self._kept[key] = made
        return made


class ShownMap(ShownSource):
    """One map file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, path.stem, path.parent)

    def version(self) -> str:
        """See `ShownSource`."""
        return version_of(self.path)

    def check_version(self, version: str) -> None:
        """Raise ConfigError unless the file is as it was when it had this version."""
        if version != self.version():
            raise ConfigError(
                f"{self.name} has changed since the page was loaded, and was left as it is; "
                "load the page again and look."
            )

    def open(self, *, writable: bool = False) -> MapFile:
        """The map, to be closed by the caller."""
        return open_map(self.path, writable=writable)

    def levels(self) -> int:
        """See `ShownSource`."""
        with pyramid.stored(self.path) as connection:
            return pyramid.read_levels(connection).above

    def density(self, level: int, tile: TileIndex) -> bytes | None:
        """See `ShownSource`: as it is stored."""
        with pyramid.stored(self.path) as connection:
            return pyramid.read_picture(connection, pyramid.read_levels(connection), level, tile)

    def marks(self) -> tuple[Mark, ...]:
        """See `ShownSource`: those that were removed, too."""
        with self.open() as universal:
            return universal.marks(removed=True)

    def features(self) -> list[dict[str, Any]]:
        """See `ShownSource`."""
        with pyramid.stored(self.path) as connection:
            return read_features(connection)

    def frames(self, bounds: Bounds) -> list[drives.FrameTable]:
        """See `ShownSource`: all of them."""
        return [self.kept(("frames",), drives.frame_table)]


def stamp(file: Path) -> str:
    """Text that differs once a file was written to or replaced.

    The file is not opened: on POSIX, closing it would drop the locks of every SQLite connection
    of this process to it, and another program could write to what is being read.
    """
    status = file.stat()
    return f"{status.st_dev} {status.st_ino} {status.st_size} {status.st_mtime_ns}"


def version_of(path: Path) -> str:
    """Text that differs once a map was written to or replaced; MapError where it is not there."""
    try:
        return hashlib.sha256(stamp(path).encode()).hexdigest()[:16]
    except FileNotFoundError as error:
        raise MapError(
            f"{path} is no longer there; put it back or build it again, then load the page again."
        ) from error
    except OSError as error:
        raise MapError(f"{path} cannot be read: {error.strerror}; check it.") from error


def shown_maps(paths: Sequence[Path]) -> tuple[ShownMap, ...]:
    """The maps at these paths, once it is sure that each is one; MapError otherwise."""
    maps = tuple(ShownMap(path) for path in paths)
    for one in maps:
        one.open().close()
    return maps
