"""The points of a PCD file: its header is checked here, and its data read by pypcd4."""

from __future__ import annotations

import io
import re
import struct

import numpy as np
import numpy.typing as npt

from fieldgrid.core import ConfigError, RecordingError, shortened
from fieldgrid.perception import TIME_FIELDS, RawSweep

_HEADER = re.compile(rb"(?:[^\n]*\n){0,40}?DATA[ \t]+(ascii|binary_compressed|binary)[ \t]*\r?\n")
_MAX_HEADER = 1 << 14
_MAX_POINT_BYTES = 4096
_MAX_RATIO = 100
"""LZF makes 264 bytes out of 3 at best."""


def parse_pcd(data: bytes, name: str) -> RawSweep:
    """x, y, z of the points, with their times; `name` is what errors call the file."""
    found = _HEADER.match(data[:_MAX_HEADER])
    if found is None:
        raise RecordingError(f"{name} has no header of a PCD; export the cloud again.")
    try:
        from pypcd4.pypcd4 import MetaData, PointCloud
    except ImportError as error:
        raise ConfigError(
            f"Reading {name} takes pypcd4; install it with: pip install 'fieldgrid[clouds]'."
        ) from error
    try:
        header = MetaData.parse_header(found[0].decode("latin-1").splitlines())
        point = sum(size * count for size, count in zip(header.size, header.count, strict=True))
        if not 0 < point <= _MAX_POINT_BYTES:
            raise ValueError(f"a point has {point} bytes by its header")
        body = data[found.end() :]
        least, most = point, len(body)
        if header.data.value == "ascii":
            least = 2 * sum(header.count)  # a digit and a space
        elif header.data.value == "binary_compressed" and header.points:
            packed, unpacked = struct.unpack("<II", body[:8].ljust(8, b"\0"))
            most = unpacked if packed + 8 <= most and packed * _MAX_RATIO >= unpacked else -1
        if header.points * least > most + 1:
            raise ValueError(f"it claims {header.points} points and has {len(body)} bytes")
        # By the header that was checked: of a long one the library reads the first lines only.
        checked = io.BytesIO(header.compose_header().encode() + body)
        cloud = PointCloud.from_fileobj(checked)  # type: ignore[arg-type]
        points: npt.NDArray[np.generic] = cloud.numpy(("x", "y", "z"))
        timed = [key for key in TIME_FIELDS if key in cloud.fields]
        times = np.asarray(cloud.pc_data[timed[0]]) if timed else None
    except Exception as problem:  # a library on a file from strangers
        raise RecordingError(
            f"{name} is a truncated or damaged PCD: {shortened(problem)}; copy it again."
        ) from problem
    return RawSweep(points, times if times is not None and times.ndim == 1 else None)
