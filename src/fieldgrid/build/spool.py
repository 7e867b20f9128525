"""Local grids that wait for their poses: on disk, since a drive has thousands."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import MapError
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.mapfile import decode_grid, encode_grid


class Waiting(NamedTuple):
    """A frame that has its grid and lacks its pose."""

    frame_id: str
    time_ns: int
    images: tuple[str, str]
    images_sha256: tuple[str, str]
    ground_refined: bool
    grid: LocalGrid


class _Entry(NamedTuple):
    frame_id: str
    time_ns: int
    images: tuple[str, str]
    images_sha256: tuple[str, str]
    ground_refined: bool
    sizes: tuple[int, int]


class Spool:
    """Grids in the order they were put, in a temporary file that is gone afterwards."""

    def __init__(self, spec: GridSpec) -> None:
        self._spec = spec
        self._entries: list[_Entry] = []
        self._file = tempfile.TemporaryFile(prefix="fieldgrid-")  # noqa: SIM115 (closed in close)

    def put(
        self,
        frame_id: str,
        time_ns: int,
        images: tuple[str, str],
        images_sha256: tuple[str, str],
        ground_refined: bool,
        grid: LocalGrid,
    ) -> None:
        """Append one frame."""
        density, observed = encode_grid(grid)
        try:
            self._file.write(density)
            self._file.write(observed)
        except OSError as error:
            raise MapError(
                f"The local grids do not fit into {tempfile.gettempdir()} ({error.strerror}); free "
                "some space, or name a larger folder in TMPDIR."
            ) from error
        sizes = (len(density), len(observed))
        self._entries.append(
            _Entry(frame_id, time_ns, images, images_sha256, ground_refined, sizes)
        )

    def frames(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
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
