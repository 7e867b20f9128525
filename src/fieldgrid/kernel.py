"""How the inner loops are compiled: one decorator for all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of arrays with Numba, without the interpreter's lock.

    The machine code is kept beside the module, or where Numba keeps it for the user; on a
    vehicle with a read-only disk and no home there is no such place, and it is compiled anew
    in each run.
    """
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:
        return numba.njit(nogil=True)(function)
