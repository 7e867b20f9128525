"""How the inner loops are compiled: one decorator for all of them.

Compiling is paid by the first run on a machine, and most of it is not LLVM but the typing of
Python code, so it grows with the code and not with its speed. A kernel is therefore one function
of plain loops over arrays that it is given; whole-array expressions, slices and reductions inside
it cost as much again, each.

Numba takes as long to import as everything else together, so it is imported when the first loop
runs: listing the sessions of a map needs none.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable
from functools import update_wrapper
from typing import Any

_COMPILING = threading.RLock()

_WATCHED: list[Callable[[], None]] = []
"""Functions that are called when a kernel is compiled, and not loaded."""

_LISTENERS: list[Any] = []
"""What hears of compiling, once a kernel was made."""

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


class Kernel:
    """A function of arrays that is compiled with Numba when it is first called, and then runs
    without the interpreter's lock.

    The machine code is kept beside the module, or where Numba keeps it for the user; on a
    vehicle with a read-only disk and no home there is no such place, and it is compiled anew
    in each run. `options` are Numba's.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function = function
        self._options = options
        self._compiled: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """The function's result."""
        return (self._compiled or self.compiled())(*arguments)

    def compiled(self) -> Any:
        """Numba's own function, in which other kernels are Numba's own functions too."""
        with _COMPILING:
            if self._compiled is None:
                import numba

                _prepare()
                names = self._function.__globals__
                for name in self._function.__code__.co_names:
                    used = names.get(name)
                    if isinstance(used, Kernel):
                        names[name] = used.compiled()
                try:
                    self._compiled = numba.njit(**self._options)(self._function)
                except RuntimeError:  # no place for the machine code
                    self._compiled = numba.njit(**(self._options | {"cache": False}))(
                        self._function
                    )
            return self._compiled

    def cache_folder(self) -> str | None:
        """Where the machine code is kept, None where there is no place for it."""
        return getattr(self.compiled().stats, "cache_path", None)


def when_compiling(tell: Callable[[], None]) -> None:
    """Call `tell` once, when the first kernel of this process is compiled for want of kept code."""
    _WATCHED.append(tell)


def _prepare() -> None:
    """Before the first kernel: hear of each function that is compiled."""
    if _LISTENERS:
        return
    from numba.core import event

    class Compiling(event.Listener):
        """Numba lets one thread compile at a time, and functions inside of functions.

        A compiler makes millions of small objects that live until it is done, beside a million
        that stay: without a pause, a fifth of the time goes into looking for cycles among them.
        """

        depth = 0
        collects = False

        def on_start(self, event: Any) -> None:
            while _WATCHED:
                _WATCHED.pop()()
            self.depth += 1
            if self.depth == 1:
                self.collects = gc.isenabled()
                gc.disable()

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0 and self.collects:
                gc.enable()

    _LISTENERS.append(Compiling())
    event.register("numba:compile", _LISTENERS[0])  # type: ignore[no-untyped-call]


def kernel(function: Callable[..., Any]) -> Kernel:
    """Compile a function of arrays when it is first called."""
    return Kernel(function, _OPTIONS | {"cache": True})


def part_of_kernel(function: Callable[..., Any]) -> Kernel:
    """A function that becomes part of each kernel of its module that calls it, at each place; it is
    not compiled itself. It takes no `*arguments` there."""
    return Kernel(function, _OPTIONS | {"inline": "always"})


@kernel
def nothing() -> None:
    """A kernel to ask where kernels are kept."""
