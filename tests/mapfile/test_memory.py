"""The memory of tiles stays with the allocator."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

_FREE_AND_TAKE = """
import resource, sys
import numpy as np
from fieldgrid.mapfile.memory import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(30):
        [np.ones((256, 256), np.uint64) for _ in range(20)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

if sys.argv[1] == "keep":
    keep_freed_memory()
print(faults())
"""


def test_arrays_that_are_freed_are_not_taken_from_the_system_again() -> None:
    if platform.libc_ver()[0] != "glibc":
        pytest.skip("this allocator has no thresholds that adapt")
    taken = {
        what: int(subprocess.check_output([sys.executable, "-c", _FREE_AND_TAKE, what]))
        for what in ("keep", "leave")
    }
    assert 4 * taken["keep"] < taken["leave"]
