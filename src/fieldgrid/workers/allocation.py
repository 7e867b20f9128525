"""How a worker of Dask asks the system for memory."""

from __future__ import annotations

import ctypes
import platform
from functools import lru_cache

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES, _LARGE_BYTES = 64 << 20, 32 << 20


@lru_cache(maxsize=1)
def keep_freed_memory() -> None:
    """Let this process use again what it has freed, up to 64 MB, as glibc does by itself.

    Dask's nanny starts workers so that each array of 128 kB or more goes back to the system, and
    is asked for again, page by page: verifying a map took more than twice the processor time.
    """
    if platform.libc_ver()[0] != "glibc":
        return
    mallopt = ctypes.CDLL(None).mallopt
    mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
