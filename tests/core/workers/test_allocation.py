"""Memory that a worker of Dask has freed is used again."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

pytest.importorskip("distributed")

_FAULTS = """
import resource, sys
import numpy as np
from fieldgrid.core.workers.cluster import keep_freed_memory
if sys.argv[1] == "keep":
    keep_freed_memory()
np.ones(1 << 20)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(100):
    np.ones(1 << 20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the allocator of glibc")
def test_pages_are_not_asked_for_again_and_again() -> None:
    from dask import config
    from distributed.nanny import Nanny  # noqa: F401 - its defaults are read with it

    dask = config.get("distributed.nanny.pre-spawn-environ")
    env = {**os.environ, **{name: str(value) for name, value in dask.items()}}
    assert "MALLOC_TRIM_THRESHOLD_" in env
    faults = {
        how: int(
            subprocess.run(
                [sys.executable, "-c", _FAULTS, how], env=env, check=True, capture_output=True
            ).stdout
        )
        for how in ("leave", "keep")
    }
    assert faults["keep"] < faults["leave"] / 10
