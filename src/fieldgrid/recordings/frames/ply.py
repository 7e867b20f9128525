"""The vertices of a PLY file, from strangers: read within the bytes that are there."""

from __future__ import annotations

import re
from typing import NamedTuple

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
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

_BLOCK_LINES = 1 << 13


class _PlyHeader(NamedTuple):
    """Format, number of vertices, and name and type of their properties."""

    kind: str
    vertices: int
    properties: list[tuple[str, str]]


def parse_ply(data: bytes, name: str) -> RawSweep:
    """x, y, z of the vertices as stored, with their times; `name` is what errors call the file.

    The vertices must stand first, as they do in every cloud.
    """
    found = _HEADER.match(data[:_MAX_HEADER])
    header = None if found is None else _parse(found[0])
    if found is None or header is None:
        raise RecordingError(
            f"{name} has no header of a PLY that starts with its vertices; export the cloud again."
        )
    places = {key: k for k, (key, _) in enumerate(header.properties)}
    if not {"x", "y", "z"} <= places.keys() or len(places) != len(header.properties):
        raise RecordingError(f"{name} has no vertices with one x, y and z; export the cloud again.")
    body = memoryview(data)[found.end() :]
    wanted = ["x", "y", "z", *(key for key in TIME_FIELDS if key in places)][:4]
    if header.kind == "ascii":
        values = _ascii(bytes(body), header, [places[key] for key in wanted], name)
        return RawSweep(values[:, :3], values[:, 3] if len(wanted) > 3 else None)
    order = _ORDERS[header.kind]
    vertex = np.dtype([(f"{k}", f"{order}{kind}") for k, (_, kind) in enumerate(header.properties)])
    if header.vertices * vertex.itemsize > len(body):
        raise _too_short(name, header.vertices, len(body))
    vertices = np.frombuffer(body, dtype=vertex, count=header.vertices)
    columns = [vertices[f"{places[key]}"] for key in wanted]
    with np.errstate(invalid="ignore"):  # a number that signals is no place either
        points = np.stack([column.astype(np.float64) for column in columns[:3]], axis=1)
    return RawSweep(points, columns[3] if len(columns) > 3 else None)


def _parse(header: bytes) -> _PlyHeader | None:
    """What a header says, None where it makes no sense."""
    kind, count, element = "", -1, 0
    properties: list[tuple[str, str]] = []
    for line in header.decode("latin-1").splitlines():
        match line.split():
            case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as known, _]:
                kind = known
            case ["element", what, number]:
                element += 1
                if element == 1 and what == "vertex" and number.isdecimal() and len(number) < 16:
                    count = int(number)
            case ["property", typename, what] if element == 1 and typename in _TYPES:
                properties.append((what, _TYPES[typename]))
            case ["property", *_] if element == 1:
                return None
    if not kind or count < 0 or not 3 <= len(properties) <= _MAX_PROPERTIES:
        return None
    return _PlyHeader(kind, count, properties)


def _ascii(body: bytes, header: _PlyHeader, xyz: list[int], name: str) -> npt.NDArray[np.generic]:
    width = len(header.properties)
    if 2 * header.vertices * width > len(body) + 1:  # a digit and a space
        raise _too_short(name, header.vertices, len(body))
    lines = body.split(b"\n", header.vertices)[: header.vertices]
    try:
        # Words take ten times the memory of the text.
        values = np.concatenate(
            [
                np.array(b" ".join(lines[start : start + _BLOCK_LINES]).split(), dtype=np.float64)
                for start in range(0, max(len(lines), 1), _BLOCK_LINES)
            ]
        )
    except ValueError as problem:
        raise RecordingError(f"{name} is damaged: {problem}; copy it again.") from problem
    if values.size != header.vertices * width:
        raise _too_short(name, header.vertices, len(body))
    return values.reshape(-1, width)[:, xyz]


def _too_short(name: str, count: int, size: int) -> RecordingError:
    return RecordingError(
        f"{name} claims {count} points and has {size} bytes of them; it is truncated or damaged, "
        "copy it again."
    )
