"""The points of LAS and LAZ files: the header is checked here, and the data read by laspy."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import ConfigError, RecordingError, shortened
from fieldgrid.perception import RawSweep
from fieldgrid.poses import unix_ns
from fieldgrid.recordings.files import MAX_FRAME_BYTES, check_regular

_MAX_HEADER = 1 << 22
"""No sweep says as much before its points; the library reads all of that, record by record."""
_WEEK_S, _ADJUSTED_S = 7 * 86_400, 1_000_000_000
_LAYERED, _EXTRA_BYTES = 3, 14
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # of points, colours, with infrared, of wave packets


def read_las(path: Path) -> RawSweep:
    """x, y, z of the points, float64, with their UTC in seconds where they have GPS time (adjusted
    standard)."""
    with _opened(path) as reader:
        count = reader.header.point_count
        read = reader.read_points(count)
        points = np.stack([read.x, read.y, read.z], axis=1)
        gps_s = np.array(read.gps_time) if count and _is_timed(reader.header) else None
    if len(points) != count:
        raise _damaged(path, f"{len(points)} of {count} points are there")
    first_ns = None if gps_s is None else _utc_ns(gps_s[0])
    if gps_s is None or first_ns is None:
        return RawSweep(points)
    return RawSweep(points, first_ns / 1e9 + (gps_s - gps_s[0]))


def las_time_ns(path: Path) -> int:
    """UTC of the first point, nanoseconds; RecordingError where the file does not say it."""
    with _opened(path) as reader:
        if not (reader.header.point_count and _is_timed(reader.header)):
            raise RecordingError(
                f"{path} has no points with GPS time (adjusted standard), and its name is no UTC "
                "time in nanoseconds; add frames.csv with frame_id, timestamp_utc_s, cloud."
            )
        gps_s = reader.read_points(1).gps_time[0]
    time_ns = _utc_ns(gps_s)
    if time_ns is None:
        raise RecordingError(
            f"{path} starts at a GPS time of {gps_s} s (adjusted standard), which no receiver can "
            "have seen; correct its times, or add frames.csv."
        )
    return time_ns


def _is_timed(header: Any) -> bool:
    """Whether the points have GPS time (adjusted standard)."""
    has_time = "gps_time" in header.point_format.dimension_names
    return has_time and int(header.global_encoding.gps_time_type) == 1


def _utc_ns(gps_s: float) -> int | None:
    """UTC of a GPS time (adjusted standard); None for one that cannot be."""
    try:
        week, of_week_s = divmod(float(gps_s) + _ADJUSTED_S, _WEEK_S)
        return unix_ns(int(week), round(of_week_s * 1e9))
    except (ValueError, OverflowError):
        return None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """laspy's reader, once it is sure that the file can hold what it claims; what it raises on a
    damaged file names the file."""
    size = check_regular(path)
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
    backend = laspy.LazBackend.Lazrs
    try:
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
    points_bytes = header.point_count * header.point_format.size
    if points_bytes > MAX_FRAME_BYTES:
        raise RecordingError(
            f"{path} claims {header.point_count} points, more than any sweep has; cut it into "
            "sweeps, or copy it again if it is damaged."
        )
    if header.are_points_compressed:
        _check_packing(path, size, header)
    elif header.offset_to_point_data + points_bytes > size:
        raise _damaged(path, f"it claims {header.point_count} points and has {size} bytes")


def _check_packing(path: Path, size: int, header: Any) -> None:
    """Raise RecordingError when packed points are not made of what makes a point, are in more or
    smaller chunks than can be, or a chunk claims layers that it cannot hold.

    The library makes room for chunks and layers before it reads them, and ends the process when
    there is none. A chunk is its first point, a number of points, the sizes of its layers, and
    these.
    """
    import lazrs

    packing, point_bytes = header.vlrs.get("LasZipVlr")[0].record_data, header.point_format.size
    compressor, parts = struct.unpack_from("<H30xH", packing)
    items = [struct.unpack_from("<HH", packing, 34 + 6 * k) for k in range(parts)]
    if not items or sum(part_bytes for _, part_bytes in items) != point_bytes:
        raise _damaged(path, f"its points are packed in {parts} parts, not of their size")
    with path.open("rb") as file:
        at = file.seek(header.offset_to_point_data)
        (table,) = struct.unpack("<q", file.read(8))
        if table == -1:  # written without going back: the place stands at the end
            file.seek(size - 8)
            (table,) = struct.unpack("<q", file.read(8))
        file.seek(max(table, 0))
        _, claimed = struct.unpack("<II", file.read(8))
        if claimed > min(header.point_count + 1, size // 64):
            raise _damaged(path, f"it claims {header.point_count} points in {claimed} chunks")
        file.seek(at)
        chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(packing))
        if sum(points for points, _ in chunks) < header.point_count:
            raise _damaged(path, f"its {len(chunks)} chunks hold fewer than its points")
        if compressor != _LAYERED:
            return
        layers = sum(n if kind == _EXTRA_BYTES else _LAYERS[kind] for kind, n in items)
        at += 8 + point_bytes + 4
        for _, chunk_bytes in chunks:
            file.seek(at)
            sizes = struct.unpack(f"<{layers}I", file.read(4 * layers))
            if point_bytes + 4 + 4 * layers + sum(sizes) > chunk_bytes:
                raise _damaged(path, f"layers of {sum(sizes)} bytes in {chunk_bytes}")
            at += chunk_bytes


def _damaged(path: Path, why: object) -> RecordingError:
    return RecordingError(
        f"{path} is a truncated or damaged LAS or LAZ: {shortened(why)}; copy it again."
    )
