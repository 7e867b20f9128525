"""The points of LAS and LAZ files: the header is checked here, and the data read by laspy."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import ConfigError, Float64, Int64, RecordingError
from fieldgrid.perception import LONGEST_S, RawSweep
from fieldgrid.poses import unix_ns
from fieldgrid.recordings.files import check_regular

MAX_POINTS = 20_000_000
"""More points than any sweep has; a survey is none."""

_CHUNK = 1_000_000
_MAX_HEADER = 1 << 22
"""No sweep says as much before its points; the library reads all of that, record by record."""
_WEEK_S, _ADJUSTED_S = 7 * 86_400, 1_000_000_000
_LAYERED, _EXTRA_BYTES = 3, 14
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # of points, colours, with infrared, of wave packets


def read_las(path: Path, max_bytes: int) -> RawSweep:
    """x, y, z of the points, float64, of a file of at most `max_bytes`; with their UTC in
    nanoseconds where they have GPS time (adjusted standard)."""
    parts, gps_s = [np.zeros((0, 3))], [np.zeros(0)]
    with _opened(path, max_bytes) as reader:
        for chunk in reader.chunk_iterator(_CHUNK):
            parts.append(np.stack([chunk.x, chunk.y, chunk.z], axis=1))
            if _is_timed(reader.header):
                gps_s.append(np.asarray(chunk.gps_time))
    points, count = np.concatenate(parts), reader.header.point_count
    if len(points) != count:
        raise _damaged(path, f"{len(points)} of {count} points are there")
    return RawSweep(points, _utc_ns(np.concatenate(gps_s)))


def las_time_ns(path: Path, max_bytes: int) -> int:
    """UTC of the first point, nanoseconds; RecordingError where the file does not say it."""
    with _opened(path, max_bytes) as reader:
        if not (reader.header.point_count and _is_timed(reader.header)):
            raise RecordingError(
                f"{path} has no points with GPS time (adjusted standard), and its name is no UTC "
                "time in nanoseconds; add frames.csv with frame_id, timestamp_utc_s, cloud."
            )
        gps_s = float(reader.read_points(1).gps_time[0])
    try:
        return _unix_ns(gps_s)
    except (ValueError, OverflowError) as problem:
        raise RecordingError(
            f"{path} starts at a GPS time of {gps_s} s (adjusted standard), which no receiver can "
            "have seen; correct its times, or add frames.csv."
        ) from problem


def _is_timed(header: Any) -> bool:
    """Whether the points have GPS time (adjusted standard)."""
    has_time = "gps_time" in header.point_format.dimension_names
    return has_time and int(header.global_encoding.gps_time_type) == 1


def _utc_ns(gps_s: Float64) -> Int64 | None:
    """UTC of GPS times (adjusted standard) of one sweep; None where they are none."""
    if not len(gps_s) or not np.isfinite(gps_s).all() or np.ptp(gps_s) > LONGEST_S:
        return None
    first_s = float(gps_s[0])
    try:
        return _unix_ns(first_s) + np.rint((gps_s - first_s) * 1e9).astype(np.int64)
    except (ValueError, OverflowError):
        return None


def _unix_ns(gps_s: float) -> int:
    week, of_week_s = divmod(gps_s + _ADJUSTED_S, _WEEK_S)
    return unix_ns(int(week), round(of_week_s * 1e9))


@contextmanager
def _opened(path: Path, max_bytes: int) -> Iterator[Any]:
    """laspy's reader, once it is sure that the file can hold what it claims; what it raises on a
    damaged file names the file."""
    size = check_regular(path)
    if size > max_bytes:
        raise RecordingError(f"{path} has {size} bytes, more than any sweep; cut it into sweeps.")
    with path.open("rb") as file:
        kind, offset, records = struct.unpack("<4s92xII", file.read(104).ljust(104, b"\0"))
    if kind != b"LASF" or offset > min(size, _MAX_HEADER) or 54 * records > offset:
        raise _damaged(path, f"its points begin at byte {offset} of {size}")
    try:
        import laspy
    except ImportError as error:
        raise ConfigError(
            f"Reading {path} takes laspy; install it with: pip install 'fieldgrid[clouds]'."
        ) from error
    try:
        backend = laspy.LazBackend.Lazrs  # the one that takes chunk by chunk
        with laspy.open(path, read_evlrs=False, laz_backend=backend) as reader:
            _check_points(path, size, reader.header)  # before any is read
            yield reader
    except RecordingError:
        raise
    except BaseException as problem:
        # A library on a file from strangers; what panics in it is no Exception.
        if isinstance(problem, Exception) or type(problem).__name__ == "PanicException":
            raise _damaged(path, problem) from problem
        raise


def _check_points(path: Path, size: int, header: Any) -> None:
    """Raise RecordingError where a header claims more points than the file can hold."""
    points, offset = header.point_count, header.offset_to_point_data
    if header.are_points_compressed:
        with path.open("rb") as file:
            fits = _chunks(file, offset, size) <= min(points + 1, size // 64)
    else:
        fits = offset + points * header.point_format.size <= size
    if not fits:
        raise _damaged(path, f"it claims {points} points and has {size} bytes")
    if points > MAX_POINTS:
        raise RecordingError(
            f"{path} claims {points} points, more than {MAX_POINTS}; cut it into sweeps."
        )
    for packing in header.vlrs.get("LasZipVlr"):
        _check_packing(path, header, packing.record_data)


def _chunks(file: Any, offset: int, size: int) -> int:
    """How many chunks packed points claim to be in; the library would make room for them."""
    file.seek(offset)
    (table,) = struct.unpack("<q", file.read(8).ljust(8, b"\xff"))
    if table == -1:  # written without going back: the place stands at the end
        file.seek(size - 8)
        (table,) = struct.unpack("<q", file.read(8))
    if not offset <= table <= size - 8:
        return 1 << 32
    file.seek(table)
    _, chunks = struct.unpack("<II", file.read(8))
    return int(chunks)


def _check_packing(path: Path, header: Any, packing: bytes) -> None:
    """Raise RecordingError when packed points are not made of what makes a point, or a chunk of
    them claims layers that it cannot hold.

    The library makes room for the layers before it reads them, and ends the process when there is
    none. A chunk is its first point, a number of points, the sizes of its layers, and these.
    """
    import lazrs

    compressor, count = struct.unpack("<H30xH", packing[:34])
    items = [struct.unpack("<HHH", packing[34 + 6 * k : 40 + 6 * k]) for k in range(count)]
    if not items or sum(size for _, size, _ in items) != header.point_format.size:
        raise _damaged(path, f"its points are packed in {count} parts, not of their size")
    if compressor != _LAYERED:
        return
    layers = sum(size if kind == _EXTRA_BYTES else _LAYERS[kind] for kind, size, _ in items)
    with path.open("rb") as file:
        file.seek(header.offset_to_point_data)
        chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(packing))
        at = header.offset_to_point_data + 8
        if sum(points for points, _ in chunks) < header.point_count:
            raise _damaged(path, f"its {len(chunks)} chunks hold fewer than its points")
        for _, chunk_bytes in chunks:
            before = header.point_format.size + 4
            file.seek(at + before)
            sizes = struct.unpack(f"<{layers}I", file.read(4 * layers))
            if before + 4 * layers + sum(sizes) > chunk_bytes:
                raise _damaged(path, f"layers of {sum(sizes)} bytes in {chunk_bytes}")
            at += chunk_bytes


def _damaged(path: Path, why: object) -> RecordingError:
    return RecordingError(f"{path} is a truncated or damaged LAS or LAZ: {why}; copy it again.")
