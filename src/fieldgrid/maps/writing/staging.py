"""A frame's evidence before it has a pose: encoded once, by any process, put together in any order.

A *staged frame* is all that a map keeps of what a frame saw. A *stage file* holds staged frames
one behind the other while they wait for their poses.
"""

from __future__ import annotations

import errno
import os
import pickle
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple, Protocol

from fieldgrid.core import (
    AnyArray,
    Closing,
    ConfigError,
    MapError,
    MapWriteError,
    quoted,
)
from fieldgrid.geometry import GridSpec, LocalGrid
from fieldgrid.maps.file.codec import EncodedChannel, decode_cells, encode_channels
from fieldgrid.maps.layers.frame import FrameCells

_HEAD = Struct("<QI")
"""The head of each frame in a stage file: how long it is, bytes, and its CRC-32."""


@dataclass(frozen=True, slots=True)
class StagedFrame:
    """What a frame saw, encoded as the map stores it; it needs no pose and can be pickled.

    `images` names the files that it was made from, `images_sha256` are their hashes.
    `ground_found` is whether the ground was, without which the cells have no heights.
    """

    frame_id: str
    time_ns: int
    spec: GridSpec
    channels: tuple[EncodedChannel, ...]
    cells_sha256: str
    images: tuple[str, ...] = ()
    images_sha256: tuple[str, ...] = ()
    ground_found: bool = True

    def cells(self) -> FrameCells:
        """The local grid and all further channels, decoded at each call."""
        return decode_cells(self.spec, self.channels, f"grid of frame {quoted(self.frame_id)}")

    def grid(self) -> LocalGrid:
        """The local grid, decoded at each call."""
        of_grid = [one for one in self.channels if one[0] in ("density", "observed")]
        return decode_cells(self.spec, of_grid, f"grid of frame {quoted(self.frame_id)}").grid


def stage(
    grid: LocalGrid,
    frame_id: str,
    time_ns: int,
    *,
    images: Sequence[str] = (),
    images_sha256: Sequence[str] = (),
    ground_found: bool = True,
    channels: Mapping[str, AnyArray] | None = None,
) -> StagedFrame:
    """Encode what a frame saw. `channels` are further values [n_y, n_x] by name.

    Raises ConfigError for a channel that is no array of numbers of the grid's shape.
    """
    encoded, sha256 = encode_channels(grid, channels or {})
    return StagedFrame(
        str(frame_id),
        int(time_ns),
        grid.spec,
        encoded,
        sha256,
        tuple(str(image) for image in images),
        tuple(str(value) for value in images_sha256),
        bool(ground_found),
    )


def frame_record(frame: StagedFrame) -> tuple[list[Any], bytes]:
    """A staged frame as a value that JSON has, and the bytes of its channels."""
    spec = frame.spec
    said = [
        frame.frame_id,
        frame.time_ns,
        [spec.width_m, spec.length_m, spec.cell_m],
        [[name, dtype, len(data)] for name, dtype, data in frame.channels],
        frame.cells_sha256,
        frame.images,
        frame.images_sha256,
        frame.ground_found,
    ]
    return said, b"".join(channel.data for channel in frame.channels)


def frame_of_record(said: Any, data: bytes) -> StagedFrame:
    """The frame of what `frame_record` made; ValueError or TypeError for others."""
    name, time_ns, spec, sizes, sha256, images, hashes, ground = said
    channels, start = [], 0
    for channel, dtype, count in sizes:
        channels.append(EncodedChannel(channel, dtype, data[start : start + count]))
        start += count
    return StagedFrame(
        name,
        time_ns,
        GridSpec(*spec),
        tuple(channels),
        sha256,
        tuple(images),
        tuple(hashes),
        ground,
    )


class StageEntry(NamedTuple):
    """A staged frame on disk: what is known without reading its cells, and where its record begins,
    bytes."""

    frame_id: str
    time_ns: int
    ground_found: bool
    start: int


class StagedFrames(Protocol):
    """Staged frames by their number, wherever they lie; reading is safe from any thread."""

    def __getitem__(self, index: int) -> StagedFrame:
        """A frame; MapError when it was damaged since it was written."""


class StageFile(Closing):
    """Staged frames on the disk of the map at `target`, in the order in which they were appended.

    The file has no name and is gone when it is closed: the system's place for temporary files is
    often a small part of the memory. Reading is safe from any thread.
    """

    def __init__(self, target: Path) -> None:
        """MapWriteError where there can be none."""
        self._target, self._end = target, 0
        self.entries: list[StageEntry] = []
        self._file: int | None = None
        try:
            with tempfile.TemporaryFile(dir=target.resolve().parent) as unnamed:
                self._file = os.dup(unnamed.fileno())
        except OSError as error:
            raise unwritable(target, error) from error

    def append(self, frame: StagedFrame) -> int:
        """Write a frame behind the others; returns its index. MapWriteError on a full disk."""
        if self._file is None:
            raise ConfigError(f"The staged frames for {self._target} are closed.")
        body = pickle.dumps(frame)
        record = memoryview(_HEAD.pack(len(body), zlib.crc32(body)) + body)
        end = self._end + len(record)
        try:
            while record:  # a disk that fills up takes a part first
                record = record[os.pwrite(self._file, record, end - len(record)) :]
        except OSError as error:
            raise unwritable(self._target, error) from error
        self.entries.append(
            StageEntry(frame.frame_id, frame.time_ns, frame.ground_found, self._end)
        )
        self._end = end
        return len(self.entries) - 1

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, index: int) -> StagedFrame:
        """A frame; MapError when it was damaged since it was written."""
        entry = self.entries[index]
        assert self._file is not None, "the stage file is closed"
        size, check = _HEAD.unpack(os.pread(self._file, _HEAD.size, entry.start))
        body = os.pread(self._file, size, entry.start + _HEAD.size)
        if zlib.crc32(body) != check:
            raise damaged_frame(entry)
        frame: StagedFrame = pickle.loads(body)
        return frame

    def __iter__(self) -> Iterator[StagedFrame]:
        return (self[k] for k in range(len(self)))

    def close(self) -> None:
        """Close the file, which is gone then."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def unwritable(target: Path, error: OSError) -> MapWriteError:
    """The error of a disk that does not take the staged frames for the map at `target`."""
    advice = "check the folder and its permissions"
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        advice = "free some space there and try again"
    return MapWriteError(
        f"The local grids of the drive cannot be kept beside {target} "
        f"({error.strerror}), so the drive is not in it; {advice}."
    )


def damaged_frame(entry: StageEntry) -> MapError:
    """The error of a frame that cannot be read back."""
    return MapError(f"The staged frame {quoted(entry.frame_id)} is damaged; build the drive again.")
