"""Build one map and print this process's peak memory in MB and the seconds it took.

The drive is that of `benchmarks.long_drive`, whose images come over and over again along a straight
line: that they do not match the fixes is accepted.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from benchmarks.peak import peak_mb
from fieldgrid.core import resolve
from fieldgrid.pipeline import build_map

if __name__ == "__main__":
    start = time.perf_counter()
    settings = resolve(None, {"checks": {"accept": ["frames-misplaced"]}})
    build_map([Path(sys.argv[1])], Path(sys.argv[2]), settings)
    seconds = time.perf_counter() - start
    print(peak_mb(), seconds)
