"""Arrays in NumPy's own format, from strangers: read within the bytes that are there."""

from __future__ import annotations

import io
import math
import warnings
from tokenize import TokenError

import numpy as np
import numpy.typing as npt

from fieldgrid.core import RecordingError


def parse_npy(data: bytes, name: str) -> npt.NDArray[np.generic]:
    """The array of a .npy file; `name` is what errors call it.

    Numbers only; an array that claims more bytes than the file has is refused unread.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        with warnings.catch_warnings():  # of Python 2, whose headers are read all the same
            warnings.simplefilter("ignore", UserWarning)
            shape, by_column, dtype = header(stream)
    except (ValueError, SyntaxError, TypeError, EOFError, TokenError) as problem:
        raise RecordingError(f"{name} is no array of NumPy: {problem}; save it again.") from problem
    if dtype.kind not in "fiu" or dtype.itemsize > 8:
        raise RecordingError(f"{name} holds {dtype}, not numbers; save it as float32 or uint16.")
    left = len(data) - stream.tell()
    if any(size < 0 for size in shape) or math.prod(shape) * dtype.itemsize != left:
        raise RecordingError(
            f"{name} has {left} bytes for an array of shape {shape}; it is truncated or damaged, "
            "copy it again."
        )
    return np.frombuffer(data, dtype=dtype, offset=stream.tell()).reshape(
        shape, order="F" if by_column else "C"
    )
