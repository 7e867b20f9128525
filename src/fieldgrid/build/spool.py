"""Local grids that wait for their poses: on disk, since a drive has thousands.

They lie beside the map, where there must be room for them anyway: the system's place for
temporary files is often a small part of the memory. Their file has no name, so the system
deletes it also when the program is killed.
"""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from fieldgrid.array_types import Bool, Int64
from fieldgrid.errors import MapWriteError
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.mapfile import decode_grid, encode_grid


class Waiting(NamedTuple):
    """A frame that has its grid and lacks its pose."""

    frame_id: str
    time_ns: int
    images: tuple[str, ...]
    images_sha256: tuple[str, ...]
    ground_refined: bool
    grid: LocalGrid


class _Entry(NamedTuple):
    frame_id: str
    time_ns: int
    images: tuple[str, ...]
    images_sha256: tuple[str, ...]
    ground_refined: bool
    sizes: tuple[int, int]


class Spool:
    """Grids in the order they were put, for the map at `target`; gone when it is closed."""

    def __init__(self, spec: GridSpec, target: Path) -> None:
        self._spec = spec
        self._target = target
        self._entries: list[_Entry] = []
        place = target.resolve().parent
        try:
            # Without a buffer, which would be written once more when a full disk is given up.
            self._file = tempfile.TemporaryFile(  # noqa: SIM115 (closed in close)
                prefix=f".{target.name}.", suffix=".grids", dir=place, buffering=0
            )
        except OSError as error:
            raise self._unwritable(error) from error

    def put(
        self,
        frame_id: str,
        time_ns: int,
        images: tuple[str, ...],
        images_sha256: tuple[str, ...],
        ground_refined: bool,
        grid: LocalGrid,
    ) -> None:
        """Append one frame."""
        density, observed = encode_grid(grid)
        try:
            left = memoryview(density + observed)
            while left:  # a disk that fills up takes a part first
                left = left[self._file.write(left) :]
        except OSError as error:
            raise self._unwritable(error) from error
        sizes = (len(density), len(observed))
        self._entries.append(
            _Entry(frame_id, time_ns, images, images_sha256, ground_refined, sizes)
        )

    def frames(self) -> tuple[Int64, Bool]:
        """The times of all frames, and whether the ground was found in each."""
        return (
            np.array([entry.time_ns for entry in self._entries], dtype=np.int64),
            np.array([entry.ground_refined for entry in self._entries], dtype=np.bool_),
        )

    def __len__(self) -> int:
        return len(self._entries)

    def __iter__(self) -> Iterator[Waiting]:
        """The frames, one grid in memory at a time."""
        self._file.seek(0)
        for entry in self._entries:
            density, observed = (self._file.read(size) for size in entry.sizes)
            grid = decode_grid(self._spec, density, observed, f"frame {entry.frame_id}")
            yield Waiting(*entry[:5], grid)

    def _unwritable(self, error: OSError) -> MapWriteError:
        advice = "check the folder and its permissions"
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            advice = "free some space there and try again"
        return MapWriteError(
            f"The local grids of the drive cannot be kept beside {self._target} "
            f"({error.strerror}), so the drive is not in it; {advice}."
        )

    def close(self) -> None:
        """Drop the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
