"""Exports that are killed while they replace an earlier one: old or new, never a mix.

    python -m tests.crash.exports 200 [SEED [FORMAT...]]

kills each format, or those that are named, so often: every second time before one of the
calls that change a file (all of them, the last ones first), else at a random moment. What lies at
the target must be the earlier export bit for bit, or the new one: all files, where they are
several. The next export leaves nothing of a killed one.
"""

from __future__ import annotations

import ctypes
import os
import select
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from fieldgrid.export import export_map, formats
from fieldgrid.maps import open_map
from tests.crash.damages import make
from tests.crash.failures import COUNT, KILL, run_in_child

DATED = {"kmz", "gpkg", "shapefile", "qgz"}
"""Formats that hold the time at which they were written: their sizes tell old from new."""

LONGEST_S = 5.0
"""After which an export that was not killed yet is."""

Files = dict[str, bytes]


def files_at(folder: Path) -> Files:
    """What a user sees there: drafts have names with a dot."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.relative_to(folder).parts[0].startswith(".")
    }


def run_format(
    key: str, count: int, folder: Path, random: np.random.Generator
) -> tuple[int, Counter[str]]:
    """Kill so many exports; returns how many calls one has, and what was found after them."""
    library = ctypes.CDLL(None)
    library.fault_count.restype = ctypes.c_long
    library.fault_arm.argtypes = (ctypes.c_long, ctypes.c_int, ctypes.c_int)
    old, new = folder / "old.gpkg", folder / "new.gpkg"
    out = folder / key
    out.mkdir()
    target = out / f"out{formats()[key].endings[0]}"
    _export(new, target, key)
    made = files_at(out)
    shutil.rmtree(out)
    out.mkdir()
    _export(old, target, key)
    kept = folder / f"{key}.kept"
    shutil.copytree(out, kept)
    before = files_at(out)
    assert made != before
    calls, longest_s = _measured(library, new, target, key)
    found: Counter[str] = Counter()
    for number in range(count):
        shutil.rmtree(out)
        shutil.copytree(kept, out)
        at = calls - (number // 2) % calls if number % 2 == 0 else 0  # names change at the end
        _kill(library, new, target, key, at, float(random.uniform(0.0, longest_s)))
        found[_state(key, files_at(out), before, made)] += 1
    _export(new, target, key)
    left = [path.name for path in out.iterdir() if path.name.startswith(".")]
    assert not left, left
    assert not [path for path in out.rglob("*") if path.is_symlink()]
    assert _state(key, files_at(out), before, made) == "new"
    return calls, found


def _export(map_: Path, target: Path, key: str) -> None:
    with open_map(map_) as universal:
        export_map(universal, target, format=key, overwrite=True)


def _measured(library: ctypes.CDLL, map_: Path, target: Path, key: str) -> tuple[int, float]:
    """The calls of an export that change a file, and the seconds that it takes."""
    start = time.perf_counter()
    library.fault_arm(0, COUNT, 0)
    _export(map_, target, key)
    calls = library.fault_count()
    library.fault_disarm()
    assert calls > 0, "the library is not in the way"
    return calls, time.perf_counter() - start


def _kill(
    library: ctypes.CDLL, map_: Path, target: Path, key: str, at: int, after_s: float
) -> None:
    child = os.fork()
    if child == 0:
        try:
            if at:
                library.fault_arm(at, KILL, 0)
            _export(map_, target, key)
        finally:
            os._exit(0)
    if not at:
        time.sleep(after_s)
        os.kill(child, signal.SIGKILL)
    # A copy of a process by fork() has none of its threads: a library may wait for them for ever.
    handle = os.pidfd_open(child)
    ended = select.poll()
    ended.register(handle, select.POLLIN)
    if not ended.poll(1000.0 * LONGEST_S):
        os.kill(child, signal.SIGKILL)
    os.close(handle)
    os.waitpid(child, 0)


def _state(key: str, found: Files, before: Files, made: Files) -> str:
    if found == before:
        return "old"
    if found == made or (key in DATED and _sizes(found) == _sizes(made)):
        return "new"
    raise AssertionError(f"{key}: neither old nor new: {sorted(found)}")


def _sizes(files: Files) -> dict[str, int]:
    return {name: len(data) for name, data in files.items()}


def _inside(count: int, seed: int, keys: list[str]) -> None:
    random = np.random.default_rng(seed)
    total: Counter[str] = Counter()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder / "old.gpkg")
        make(folder / "new.gpkg")
        with open_map(folder / "new.gpkg", writable=True) as universal:
            universal.set_transform("a", 1.5, -0.75, 20.0)
        for key in keys:
            calls, found = run_format(key, count, folder, random)
            print(
                f"  {key}, {calls} calls: "
                + ", ".join(f"{k} {n}" for k, n in sorted(found.items())),
                flush=True,
            )
            total.update(found)
    seconds = time.perf_counter() - start
    said = ", ".join(f"{what} {number}" for what, number in total.most_common())
    print(f"{total.total()} exports of {len(keys)} formats killed in {seconds:.0f} s: {said}")


def main() -> None:
    """Run as a program."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["--inside"]:
        _inside(int(arguments[1]), int(arguments[2]), arguments[3:] or list(formats()))
        return
    count, seed = (*arguments[:2], *("20", "1")[len(arguments[:2]) :])
    done = run_in_child("tests.crash.exports", count, seed, *arguments[2:])
    print(done.stdout, end="")
    print(done.stderr, end="", file=sys.stderr)
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
