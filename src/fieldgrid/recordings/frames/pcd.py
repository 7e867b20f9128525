"""The points of a PCD file: its header is checked here, and its data read by pypcd4."""

from __future__ import annotations

import io
import re
import struct

import numpy as np
import numpy.typing as npt

from fieldgrid.core import ConfigError, RecordingError
from fieldgrid.perception import TIME_FIELDS, RawSweep

_HEADER = re.compile(rb"(?:[^\n]*\n){0,40}?DATA[ \t]+(ascii|binary_compressed|binary)[ \t]*\r?\n")
_MAX_HEADER = 1 << 14
_MAX_POINT_BYTES = 4096
_MAX_RATIO = 100
"""LZF makes 264 bytes out of 3 at best."""


def parse_pcd(data: bytes, name: str) -> RawSweep:
    """x, y, z of the points, with their times; `name` is what errors call the file."""
    if _checked(data, name) == 0:
        return RawSweep(np.zeros((0, 3), dtype=np.float32))
    try:
        from pypcd4.pypcd4 import PointCloud
    except ImportError as error:
        raise ConfigError(
            f"Reading {name} takes pypcd4; install it with: pip install 'fieldgrid[clouds]'."
        ) from error
    try:
        cloud = PointCloud.from_fileobj(io.BytesIO(data))  # type: ignore[arg-type]
        points: npt.NDArray[np.generic] = cloud.numpy(("x", "y", "z"))
        timed = [key for key in TIME_FIELDS if key in cloud.fields]
        times = np.asarray(cloud.pc_data[timed[0]]) if timed else None
    except Exception as problem:  # a library on a file from strangers
        raise RecordingError(f"{name} is a damaged PCD: {problem}; copy it again.") from problem
    return RawSweep(points, times if times is not None and times.ndim == 1 else None)


def _checked(data: bytes, name: str) -> int:
    """How many points the header claims, once it is sure that the file can hold them."""
    found = _HEADER.match(data[:_MAX_HEADER])
    if found is None:
        raise RecordingError(f"{name} has no header of a PCD; export the cloud again.")
    header: dict[str, list[int]] = {}  # of the entries that count bytes
    for line in found[0].decode("latin-1").splitlines():
        key, *values = line.split() or [""]
        if key in ("SIZE", "COUNT", "POINTS", "WIDTH", "HEIGHT"):
            header[key] = [int(v) for v in values if v.isdecimal() and len(v) < 16]
    counts = header.get("COUNT", [1] * len(header.get("SIZE", [])))
    point = sum(size * count for size, count in zip(header.get("SIZE", []), counts, strict=False))
    (points, *_) = header.get("POINTS") or [-1]
    if points < 0 or not 0 < point <= _MAX_POINT_BYTES or len(counts) != len(header["SIZE"]):
        raise RecordingError(
            f"{name} has {points} points of {point} bytes by its header; export the cloud again."
        )
    left, kind = len(data) - found.end(), found[1]
    claimed = points * point
    if kind == b"ascii":
        fits = 2 * points * sum(counts) <= left + 1  # a digit and a space
    elif kind == b"binary":
        fits = claimed <= left
    else:
        packed, unpacked = struct.unpack("<II", data[found.end() :][:8].ljust(8, b"\0"))
        fits = packed + 8 <= left and unpacked == claimed <= _MAX_RATIO * packed
    if points and not fits:
        raise RecordingError(
            f"{name} claims {points} points and has {left} bytes of them; it is truncated or "
            "damaged, copy it again."
        )
    return points
