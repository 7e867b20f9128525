"""The vertices of a PLY file, from strangers: read within the bytes that are there."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from fieldgrid.core import RecordingError
from fieldgrid.perception import TIME_FIELDS, RawSweep

_HEADER = re.compile(rb"ply\s.*?\bend_header[ \t]*\r?\n", re.DOTALL)
_MAX_HEADER = 1 << 16
_MAX_PROPERTIES = 1000
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_BLOCK_LINES = 1 << 13
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def parse_ply(data: bytes, name: str) -> RawSweep:
    """x, y, z of the vertices as stored, with their times; `name` is what errors call the file.

    The vertices must stand first, as they do in every cloud.
    """
    found = _HEADER.match(data[:_MAX_HEADER])
    order, count, properties = _parse(found[0]) if found else (None, -1, [])
    if found is None or order is None or count < 0 or not 3 <= len(properties) <= _MAX_PROPERTIES:
        raise RecordingError(
            f"{name} has no header of a PLY that starts with its vertices; export the cloud again."
        )
    names = [key for key, _ in properties]
    if any(names.count(key) != 1 for key in "xyz") or len(set(names)) != len(names):
        raise RecordingError(f"{name} has no vertices with one x, y and z; export the cloud again.")
    body = memoryview(data)[found.end() :]
    wanted = [names.index(key) for key in ("x", "y", "z", *TIME_FIELDS) if key in names][:4]
    vertex = np.dtype([(f"{k}", f"{order}{kind}") for k, (_, kind) in enumerate(properties)])
    least = vertex.itemsize if order else 2 * len(properties)  # a digit and a space
    if count * least > len(body) + (not order):
        raise _too_short(name, count, len(body))
    if order:
        vertices = np.frombuffer(body, dtype=vertex, count=count)
        columns = [vertices[f"{k}"] for k in wanted]
    else:
        columns = list(_ascii(bytes(body), count, len(properties), name)[:, wanted].T)
    with np.errstate(invalid="ignore"):  # a number that signals is no place either
        points = np.stack([column.astype(np.float64) for column in columns[:3]], axis=1)
    return RawSweep(points, columns[3] if len(columns) > 3 else None)


def _parse(header: bytes) -> tuple[str | None, int, list[tuple[str, str]]]:
    """The order of bytes, the number of vertices, and name and type of their properties; no order,
    or a negative number, where the header makes no sense."""
    order, count, element = None, -1, 0
    properties: list[tuple[str, str]] = []
    for line in header.decode("latin-1").splitlines():
        match line.split():
            case ["format", kind, _]:
                order = _ORDERS.get(kind)
            case ["element", what, number]:
                element += 1
                if element == 1 and what == "vertex" and number.isdecimal() and len(number) < 16:
                    count = int(number)
            case ["property", *parts] if element == 1:
                if len(parts) != 2 or parts[0] not in _TYPES:
                    return None, -1, []
                properties.append((parts[1], _TYPES[parts[0]]))
    return order, count, properties


def _ascii(body: bytes, count: int, width: int, name: str) -> npt.NDArray[np.float64]:
    """The numbers of the first lines [vertex, property]."""
    lines = body.split(b"\n", count)[:count]
    try:
        # Words take ten times the memory of the text.
        blocks = [
            np.array(b" ".join(lines[start : start + _BLOCK_LINES]).split(), dtype=np.float64)
            for start in range(0, max(len(lines), 1), _BLOCK_LINES)
        ]
    except ValueError as problem:
        raise RecordingError(f"{name} is damaged: {problem}; copy it again.") from problem
    values = np.concatenate(blocks)
    if values.size != count * width:
        raise _too_short(name, count, len(body))
    return values.reshape(-1, width)


def _too_short(name: str, count: int, size: int) -> RecordingError:
    return RecordingError(
        f"{name} claims {count} points and has {size} bytes of them; it is truncated or damaged, "
        "copy it again."
    )
