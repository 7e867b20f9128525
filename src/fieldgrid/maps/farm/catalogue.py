"""The maps of a folder, each with what can be told of it at once, or why it cannot be read."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import ConfigError, FieldgridError, MapError
from fieldgrid.geometry import Bounds
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.history import in_drive_order
from fieldgrid.maps.file.records import SessionInfo
from fieldgrid.maps.file.store import open_map

ENDING = ".gpkg"
_BACKUP = re.compile(r"\.before-repair(-\d+)?$")


class Health(StrEnum):
    """What was checked of a map, and how that ended."""

    OPENS = "opens"
    """Its settings, plane, sessions and marks are as they were written; frames were not read."""

    SOUND = "sound"
    """All of it was verified."""

    DAMAGED = "damaged"
    """It cannot be read, is not as it was written, or `verify` found problems."""

    FOREIGN = "no map"
    """Another GeoPackage, or none."""


class FarmBlock(NamedTuple):
    """A map of a farm. `problem` is why it is left out, empty for one that can be read; `header`
    and what follows it say nothing then.

    `area_m2` is the ground that was seen, `bounds` its extent in metres of the map's own datum,
    None where nothing was. `sessions` are the active ones in the order of their drives, `removed`
    counts the others.
    """

    path: Path
    size_bytes: int
    health: Health
    problem: str = ""
    header: MapHeader | None = None
    area_m2: float = 0.0
    bounds: Bounds | None = None
    sessions: tuple[SessionInfo, ...] = ()
    removed: int = 0
    has_marks: bool = False
    root_sha256: str = ""

    @property
    def name(self) -> str:
        """The name of the file without its ending."""
        return self.path.stem

    @property
    def first(self) -> datetime | None:
        """When its first drive began, UTC; None without drives."""
        starts = [s.first_time_ns for s in self.sessions if s.first_time_ns is not None]
        return _moment(min(starts)) if starts else None

    @property
    def last(self) -> datetime | None:
        """When its last drive ended, UTC; None without drives."""
        ends = [s.last_time_ns for s in self.sessions if s.last_time_ns is not None]
        return _moment(max(ends)) if ends else None


def find_blocks(folder: Path, *, verify: bool = False, jobs: int | None = None) -> list[FarmBlock]:
    """The maps that lie in a folder, by their names. A file that cannot be read is one, too.

    ConfigError when there is no such folder, or no file that ends in .gpkg in it.
    """
    if not folder.is_dir():
        what = "is no folder" if folder.exists() else "does not exist"
        raise ConfigError(f"{folder} {what}; give the folder in which the maps are.")
    files = map_files(folder)
    if not files:
        raise ConfigError(f"{folder} has no file that ends in {ENDING}; build maps into it first.")
    return [_block(file, verify, jobs) for file in files]


def map_files(folder: Path) -> list[Path]:
    """The files of a folder that should be maps, by their names; not what `repair` kept of a map
    beside it, whose drives would count twice."""
    return sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() == ENDING and file.is_file() and not _BACKUP.search(file.stem)
    )


def _block(file: Path, verify: bool, jobs: int | None) -> FarmBlock:
    size = file.stat().st_size
    try:
        with open_map(file) as universal, universal.content() as content:
            universal.check_quickly()
            seen, header = content.seen_cells(), content.header
            sessions = content.evidence.sessions()
            found = FarmBlock(
                universal.path,
                size,
                Health.OPENS,
                header=header,
                area_m2=seen * header.lattice.cell_m**2,
                bounds=universal.bounds if seen else None,
                sessions=tuple(in_drive_order(sessions)),
                removed=sum(not info.active for info in sessions),
                has_marks=bool(content.marks()),
                root_sha256=universal.root_sha256,
            )
            problems = universal.verify(jobs).problems if verify else ()
    except (FieldgridError, OSError) as error:
        foreign = isinstance(error, MapError) and "is not a fieldgrid map" in str(error)
        return FarmBlock(file, size, Health.FOREIGN if foreign else Health.DAMAGED, str(error))
    if problems:
        more = f" and {len(problems) - 1} problems more" if len(problems) > 1 else ""
        return FarmBlock(file, size, Health.DAMAGED, f"{problems[0]}{more}")
    return found._replace(health=Health.SOUND) if verify else found


def _moment(time_ns: int) -> datetime:
    return datetime.fromtimestamp(time_ns / 1e9, UTC)
