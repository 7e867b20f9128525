"""The memory of tiles stays with the allocator."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from fieldgrid.mapfile import create_map, map_file, open_map, session
from tests.mapfile.maps import DATUM, grid_of, pose_at

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


def test_a_program_that_only_reads_maps_keeps_its_own_way_with_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    for module in (map_file, session):
        monkeypatch.setattr(module, "keep_freed_memory", lambda: calls.append("called"))
    path = tmp_path / "m.gpkg"
    with create_map(path, DATUM, cell_m=0.1) as universal:
        with universal.add_session("a") as drive:
            drive.add(grid_of(1), pose_at(0, 0, 30))
            assert calls == []
        assert calls
    calls.clear()
    with open_map(path) as universal:
        universal.read()
        assert universal.verify(deep=True).sound
    assert calls == []
    with open_map(path, writable=True) as universal:
        assert calls == []
        universal.remove_session("a")
        assert calls
