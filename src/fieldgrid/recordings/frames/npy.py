"""Arrays in NumPy's own format, from strangers: read within the bytes that are there."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from fieldgrid.core import RecordingError

_HEADER = re.compile(
    rb"\{'descr': '([<>=|](?:f[248]|[iu][1248]))', 'fortran_order': (True|False), "
    rb"'shape': \(((?: ?[0-9]{1,18}L?,){0,31}(?: ?[0-9]{1,18}L?)?)\),? ?\} *\n"
)
"""With its keys in the order in which NumPy, and what writes for it, puts them."""


def parse_npy(data: bytes, name: str) -> npt.NDArray[np.generic]:
    """The array of a .npy file; `name` is what errors call it.

    Numbers only; an array that claims more bytes than the file has is refused unread.
    """
    start = 10 if data[6:7] == b"\x01" else 12
    stop = start + int.from_bytes(data[8:start], "little")
    found = _HEADER.fullmatch(data[start : min(stop, 1 << 16)])
    if not data.startswith(b"\x93NUMPY") or found is None:
        raise RecordingError(
            f"{name} is no array of NumPy that holds numbers; save it as float32 or uint16."
        )
    dtype = np.dtype(found[1].decode())
    # Python 2 wrote (3L, 3L).
    shape = tuple(int(size) for size in found[3].replace(b"L", b"").split(b",") if size.strip())
    try:
        numbers = np.frombuffer(data, dtype, offset=stop)
        return numbers.reshape(shape, order="F" if found[2] == b"True" else "C")
    except ValueError as problem:
        raise RecordingError(
            f"{name} has {len(data) - stop} bytes for an array of shape {shape}; it is truncated "
            "or damaged, copy it again."
        ) from problem
