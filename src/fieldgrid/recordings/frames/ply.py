"""The vertices of a PLY file, from strangers: read within the bytes that are there."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from fieldgrid.core import RecordingError, shortened
from fieldgrid.perception import TIME_FIELDS, RawSweep

_HEADER = re.compile(rb"ply\s.*?\bend_header[ \t]*\r?\n", re.DOTALL)
_MAX_HEADER = 1 << 16
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
    header = found[0] if found else b""
    order, count, properties = _parse(header)
    names = [key for key, _ in properties]
    is_told = order is not None and count >= 0 and all(kind for _, kind in properties)
    if not is_told or not set("xyz") <= set(names) or len(set(names)) != len(names):
        raise RecordingError(
            f"{name} has no header of a PLY that starts with its vertices, each with one x, y and "
            "z; export the cloud again."
        )
    body = memoryview(data)[len(header) :]
    vertex = np.dtype([(key, f"{order}{kind}") for key, kind in properties])
    least = vertex.itemsize if order else 2 * len(properties)  # a digit and a space
    if count * least > len(body) + (not order):
        raise _too_short(name, count, len(body))
    if order:
        vertices = np.frombuffer(body, vertex, count)
        columns = {key: vertices[key] for key in names}
    else:
        columns = dict(zip(names, _ascii(bytes(body), count, len(names), name), strict=True))
    with np.errstate(invalid="ignore"):  # a number that signals is no place either
        points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    return RawSweep(points, next((columns[key] for key in TIME_FIELDS if key in columns), None))


def _parse(header: bytes) -> tuple[str | None, int, list[tuple[str, str]]]:
    """The order of bytes, '' for text, the number of vertices, and name and type of their
    properties; None, -1 or an empty type where the header does not tell."""
    order, count, elements = None, -1, 0
    properties: list[tuple[str, str]] = []
    for line in header.decode("latin-1").splitlines():
        match line.split():
            case ["format", kind, _]:
                order = _ORDERS.get(kind)
            case ["element", what, number]:
                elements += 1
                if elements == 1 and what == "vertex" and number.isdecimal() and len(number) < 16:
                    count = int(number)
            case ["property", kind, *_, key] if elements == 1:
                properties.append((key, _TYPES.get(kind, "")))  # a list is of no such type
    return order, count, properties


def _ascii(body: bytes, count: int, width: int, name: str) -> npt.NDArray[np.float64]:
    """The numbers of the first lines [property, vertex]."""
    lines = body.split(b"\n", count)[:count]
    blocks = [np.zeros(0)]
    try:
        for start in range(0, len(lines), _BLOCK_LINES):  # words take ten times the memory of text
            words = b" ".join(lines[start : start + _BLOCK_LINES]).split()
            blocks.append(np.array(words, dtype=np.float64))
    except ValueError as problem:
        raise RecordingError(
            f"{name} is damaged: {shortened(problem)}; copy it again."
        ) from problem
    values = np.concatenate(blocks)
    if values.size != count * width:
        raise _too_short(name, count, len(body))
    return values.reshape(count, width).T


def _too_short(name: str, count: int, size: int) -> RecordingError:
    return RecordingError(
        f"{name} claims {count} points and has {size} bytes of them; it is truncated or damaged, "
        "copy it again."
    )
