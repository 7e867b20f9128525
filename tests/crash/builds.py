"""Builds of two drives by two processes, killed at random moments, until one is left to its end.

    python -m tests.crash.builds 20 [SEED]

Each time the build itself or one of its processes is killed. A build that was killed goes on with
--resume. The map must have the bits of an undisturbed build, and nothing may be left beside it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np

from fieldgrid.core import BuildSettings
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map, work_folder
from tests.cli.conftest import in_a_process
from tests.conftest import make_small_drive
from tests.pipeline.drives.making import SMALL_SHARES, content

MOST_KILLS = 3
"""Kills that one build meets at most before it is left alone."""


def run_builds(count: int, seed: int, folder: Path) -> Counter[str]:
    """Build so often; returns what was killed. AssertionError when a map is not as it must be."""
    random = np.random.default_rng(seed)
    drives = [
        make_small_drive(folder / "first", range(3, 13)),
        make_small_drive(folder / "second", range(40, 50)),
    ]
    whole, out = folder / "whole.gpkg", folder / "m.gpkg"
    build_map(drives, whole, BuildSettings(), jobs=1)
    expected = content(whole)
    start = time.perf_counter()
    first = _started(drives, out, resume=False)
    _, said = first.communicate()
    assert first.returncode == 0, said
    longest_s = time.perf_counter() - start
    hit: Counter[str] = Counter()
    for _ in range(count):
        out.unlink()
        kills: list[str] = []
        for kill in range(MOST_KILLS + 1):
            build = _started(drives, out, resume=kill > 0)
            if kill < MOST_KILLS:
                time.sleep(float(random.uniform(0.2, longest_s)))
                kills.append(_kill_one(build, random))
                hit[kills[-1]] += 1
            assert build.stderr is not None
            with build.stderr as errors:
                said = errors.read().decode()
            if build.wait() == 0:
                break
            assert build.returncode == -signal.SIGKILL, said
            if out.exists() and not work_folder(out).exists():
                break  # it was killed when all was done
        assert content(out) == expected
        assert not work_folder(out).exists()
        left = [path.name for path in folder.glob(".m.gpkg.*")]
        assert not left, (left, kills)
        with open_map(out) as universal:
            assert universal.verify(deep=True).sound
    return hit


def _started(drives: list[Path], out: Path, *, resume: bool) -> subprocess.Popen[bytes]:
    flags = ["--resume"] if resume else []
    return subprocess.Popen(
        in_a_process("build", *drives, "-o", out, "--jobs", 2, *flags, before=SMALL_SHARES),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def _children(pid: int) -> list[int]:
    """The processes that a process, any thread of it, has started."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for found in lists for word in found.read_text().split()]


def _kill_one(build: subprocess.Popen[bytes], random: np.random.Generator) -> str:
    """Kill the build or, as often, one of its processes where there are some."""
    if build.poll() is not None:
        return "nothing: it had ended"
    workers = _children(build.pid)
    if workers and random.random() < 0.5:
        with suppress(ProcessLookupError):
            os.kill(int(random.choice(workers)), signal.SIGKILL)
        return "a process of it"
    build.kill()
    return "the build"


def main() -> None:
    """Run as a program."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        hit = run_builds(count, seed, Path(folder))
    print(f"{count} builds in {time.perf_counter() - start:.0f} s, killed on the way:")
    print("  " + ", ".join(f"{what} {n}" for what, n in hit.most_common()))
    print("  every map had the bits of an undisturbed build, and nothing was left beside it")


if __name__ == "__main__":
    main()
