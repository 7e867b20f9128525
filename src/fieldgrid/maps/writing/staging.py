"""A frame's evidence before it has a pose: encoded once, by any process, put together in any order.

A *staged frame* is all that a map keeps of what a frame saw. A *stage file* holds staged frames
one behind the other; a frame that was not written to its end is not in it, so after a crash it has
every frame before.
"""

from __future__ import annotations

import errno
import json
import os
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from struct import Struct
from typing import NamedTuple, Protocol

from fieldgrid.core import (
    AnyArray,
    Closing,
    ConfigError,
    FieldgridError,
    MapError,
    MapWriteError,
    parse_json,
    quoted,
)
from fieldgrid.geometry import GridSpec, LocalGrid
from fieldgrid.maps.file.codec import EncodedChannel, decode_cells, encode_channels
from fieldgrid.maps.layers.frame import FrameCells

_MAGIC = b"fieldgrid stage 1\n"
_FRAME = Struct("<4sIQI")
"""Of each frame: a mark, the length of its JSON header and of its data, the CRC-32 of both."""
_MARK = b"FRAM"

MAX_FRAME_BYTES = 64 << 20


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


class StageEntry(NamedTuple):
    """A frame of a stage file: what is known without reading its cells, and where it lies."""

    frame_id: str
    time_ns: int
    ground_found: bool
    offset: int
    size: int


class StagedFrames(Protocol):
    """Staged frames by their number, wherever they lie; reading is safe from any thread."""

    def __getitem__(self, index: int) -> StagedFrame:
        """A frame; MapError when it was damaged since it was written."""


class StageFile(Closing):
    """Staged frames on disk, in the order in which they were appended.

    `StageFile.temporary` is gone when it is closed. Reading is safe from any thread.
    """

    def __init__(
        self,
        path: str | Path | None,
        target: Path | None = None,
        *,
        passes_damage: bool = False,
    ) -> None:
        """Open a stage file to read it and append to it, or make it. MapError for another file.
        Where the disk is full, the error names the `target`, the map that the frames are for.

        A file ends at its first frame that is not whole, which the next one replaces. With
        `passes_damage` one of which no byte lacks keeps its number, as an entry of the name "",
        and those behind it are found.
        """
        self._place = Path(path or target or "")
        self._target, self._passes_damage = target or self._place, passes_damage
        self.entries: list[StageEntry] = []
        self._count, self._holds_entries = 0, True
        self._file: int | None = None
        try:
            if path is None:
                with tempfile.TemporaryFile(dir=self._place.resolve().parent) as unnamed:
                    self._file = os.dup(unnamed.fileno())
            else:
                self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            self._end = self._scan(self._file)
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                raise self._unwritable(error) from error
            raise

    @classmethod
    def temporary(cls, target: Path) -> StageFile:
        """A stage file without a name for the map at `target`, on its disk: the system's place for
        temporary files is often a small part of the memory."""
        return cls(None, target)

    def append(self, frame: StagedFrame) -> int:
        """Write a frame behind the others; returns its index. MapWriteError on a full disk."""
        spec = frame.spec
        header = json.dumps(
            [
                frame.frame_id,
                frame.time_ns,
                [spec.width_m, spec.length_m, spec.cell_m],
                [[name, dtype, len(data)] for name, dtype, data in frame.channels],
                frame.cells_sha256,
                frame.images,
                frame.images_sha256,
                frame.ground_found,
            ],
            ensure_ascii=False,
        ).encode()
        data = b"".join(channel.data for channel in frame.channels)
        check = zlib.crc32(data, zlib.crc32(header))
        record = _FRAME.pack(_MARK, len(header), len(data), check) + header + data
        if self._file is None:
            raise ConfigError(f"The staged frames for {self._target} are closed.")
        try:
            _write_all(self._file, record, self._end)
        except OSError as error:
            raise self._unwritable(error) from error
        entry = StageEntry(
            frame.frame_id, frame.time_ns, frame.ground_found, self._end, len(record)
        )
        self._add(entry)
        self._end += len(record)
        return self._count - 1

    def forget(self) -> None:
        """Hold no entries in memory, those of frames to come neither, until `recall`. Only of a
        file with a name."""
        self._holds_entries, self.entries = False, []

    def recall(self) -> None:
        """Hold the entries of all frames again, read from the file."""
        if self._holds_entries:
            return
        assert self._file is not None, "the stage file is closed"
        self._holds_entries, self._count, self.entries = True, 0, []
        self._end = self._scan(self._file)

    def _add(self, entry: StageEntry) -> None:
        self._count += 1
        if self._holds_entries:
            self.entries.append(entry)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> StagedFrame:
        """A frame; MapError when it was damaged since it was written."""
        entry = self.entries[index]
        assert self._file is not None, "the stage file is closed"
        return _whole(os.pread(self._file, entry.size, entry.offset), entry)

    def __iter__(self) -> Iterator[StagedFrame]:
        return (self[k] for k in range(len(self)))

    def sync(self) -> None:
        """Return when what was appended is on the disk, and not only with the system."""
        if self._file is not None:
            try:
                os.fsync(self._file)
            except OSError as error:
                raise self._unwritable(error) from error

    def close(self) -> None:
        """Close the file; a temporary one is gone."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _scan(self, file: int) -> int:
        """Find the frames; returns where the next one goes."""
        head = os.pread(file, len(_MAGIC), 0)
        if not head:
            _write_all(file, _MAGIC, 0)
            return len(_MAGIC)
        if head != _MAGIC:
            raise MapError(f"{self._place} is no file of staged frames. Check the name.")
        offset = len(_MAGIC)
        while True:
            start = os.pread(file, _FRAME.size, offset)
            if len(start) < _FRAME.size:
                return offset
            mark, header, data, _ = _FRAME.unpack(start)
            size = _FRAME.size + header + data
            if size > MAX_FRAME_BYTES:
                return offset
            record = os.pread(file, size, offset)
            frame = _unpacked(record)
            if frame is not None:
                entry = StageEntry(frame.frame_id, frame.time_ns, frame.ground_found, offset, size)
            elif self._passes_damage and mark == _MARK and len(record) == size:
                entry = StageEntry("", 0, False, offset, size)
            else:
                return offset
            self._add(entry)
            offset += size

    def _unwritable(self, error: OSError) -> MapWriteError:
        advice = "check the folder and its permissions"
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            advice = "free some space there and try again"
        return MapWriteError(
            f"The local grids of the drive cannot be kept beside {self._target} "
            f"({error.strerror}), so the drive is not in it; {advice}."
        )


def read_staged(path: Path, entry: StageEntry) -> StagedFrame:
    """A frame of a stage file that is not open; MapError when it cannot be read any more."""
    try:
        with path.open("rb") as file:
            file.seek(entry.offset)
            return _whole(file.read(entry.size), entry)
    except OSError as error:
        raise MapError(
            f"The staged frame {quoted(entry.frame_id)} in {path} cannot be read "
            f"({error.strerror}); build the drive again."
        ) from error


def _whole(record: bytes, entry: StageEntry) -> StagedFrame:
    frame = _unpacked(record)
    if frame is None:
        raise MapError(
            f"The staged frame {quoted(entry.frame_id)} is damaged; build the drive again."
        )
    return frame


def _write_all(file: int, data: bytes, offset: int) -> None:
    left = memoryview(data)
    while left:  # a disk that fills up takes a part first
        written = os.pwrite(file, left, offset)
        left, offset = left[written:], offset + written


def _unpacked(record: bytes) -> StagedFrame | None:
    """A frame from its record; None for one that is cut off or damaged."""
    if len(record) < _FRAME.size:
        return None
    mark, size, length, check = _FRAME.unpack(record[: _FRAME.size])
    body = record[_FRAME.size :]
    if mark != _MARK or len(body) != size + length or zlib.crc32(body) != check:
        return None
    try:
        name, time_ns, spec, sizes, sha256, images, hashes, ground = parse_json(body[:size])
        channels, start = [], size
        for channel, dtype, count in sizes:
            channels.append(EncodedChannel(channel, dtype, body[start : start + count]))
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
    except (TypeError, ValueError, FieldgridError):
        return None
