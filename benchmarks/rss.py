"""Build one map and print this process's peak memory in MB and the seconds it took."""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

from fieldgrid.build import build_map
from fieldgrid.settings import BuildSettings

if __name__ == "__main__":
    start = time.perf_counter()
    build_map([Path(sys.argv[1])], Path(sys.argv[2]), BuildSettings())
    seconds = time.perf_counter() - start
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, seconds)
