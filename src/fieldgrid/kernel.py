"""How the inner loops are compiled: one decorator for all of them.

Compiling is paid by the first run on a machine, and most of it is not LLVM but the typing of
Python code, so it grows with the code and not with its speed. A kernel is therefore one function
of plain loops over arrays that it is given; whole-array expressions, slices and reductions inside
it cost as much again, each.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

# The decorator's types do not know all of its options.
_njit: Any = numba.njit
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function of arrays with Numba, without the interpreter's lock.

    The machine code is kept beside the module, or where Numba keeps it for the user; on a
    vehicle with a read-only disk and no home there is no such place, and it is compiled anew
    in each run.
    """
    compiled: Callable[..., Any]
    try:
        compiled = _njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        compiled = _njit(**_OPTIONS)(function)
    return compiled


def part_of_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that only kernels of the same module call, as part of them."""
    compiled: Callable[..., Any] = _njit(no_cpython_wrapper=True, **_OPTIONS)(function)
    return compiled
