"""Every call that changes a file fails, or is the last one before the process dies.

    python -m tests.crash.failures [POINTS]

counts the calls of each operation and makes each of them (or so many, spread evenly) in turn: the
first of a full disk, the first of a broken one, a single failure, the last before a kill, and a
write that is torn in half. Needs a C compiler, for a small library that comes before the system's.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import MapWriteError
from fieldgrid.maps import open_map
from tests.crash.operations import (
    State,
    Step,
    add,
    align,
    check,
    make,
    mark,
    merge,
    remove,
    rename,
    repair,
    repose,
    restore,
    shift,
    state_of,
)

ROOT = Path(__file__).resolve().parents[2]
COUNT, FOR_GOOD, ONCE, KILL, TEAR = range(5)

REFUSED, DONE, STRANGE = 3, 0, 4
"""Exit codes of the writer: it raised MapWriteError, it finished, it raised something else."""


class Way(NamedTuple):
    """A way to fail."""

    name: str
    mode: int
    error: int


WAYS = (
    Way("full disk", FOR_GOOD, errno.ENOSPC),
    Way("broken disk", FOR_GOOD, errno.EIO),
    Way("one failure", ONCE, errno.EIO),
    Way("kill", KILL, 0),
    Way("torn write", TEAR, 0),
)


def steps(folder: Path) -> list[Step]:
    """Each kind of operation; the map has an active session 0 and a removed one, 1."""
    return [
        add("2", 50.0, 6),
        remove("0"),
        restore("1"),
        repose("0", -140.0),
        shift("0", 0.75),
        repair(),
        rename("0", "zero"),
        align(("0", "1"), 0.25),
        mark(3.0),
        merge(folder / "copy.gpkg"),
    ]


def compiled(folder: Path) -> Path | None:
    """The library, None where there is no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    library = folder / "faults.so"
    source = Path(__file__).with_name("faults.c")
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-ldl"], check=True
    )
    return library


def run_in_child(module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A module as a program whose calls go through the library."""
    with tempfile.TemporaryDirectory() as folder:
        library = compiled(Path(folder))
        assert library is not None, "there is no C compiler"
        # The program of this very tree, also where another one is installed.
        places = os.pathsep.join((str(ROOT), str(ROOT / "src")))
        environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": places}
        return subprocess.run(
            [sys.executable, "-m", module, "--inside", *arguments],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            cwd=ROOT,
        )


def _inside(points: int) -> None:
    library = ctypes.CDLL(None)
    library.fault_count.restype = ctypes.c_long
    library.fault_arm.argtypes = (ctypes.c_long, ctypes.c_int, ctypes.c_int)
    total: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        original = folder / "original.gpkg"
        make(original)
        add("1", -30.0, 3).run(original)
        remove("1").run(original)
        for step in steps(folder):
            calls = _try(library, step, original, folder, Way("", COUNT, 0), 0)[1]
            assert calls > 0, f"{step.name} made no call: the library is not in its way"
            for way in WAYS:
                for number in _spread(calls, points):
                    outcome, _ = _try(library, step, original, folder, way, number)
                    total[f"{way.name}: {outcome}"] += 1
            print(f"{step.name}: {calls} calls", flush=True)
    for what, count in sorted(total.items()):
        print(f"  {what} {count}")
    print(f"{total.total()} failures, every map verified, nothing acknowledged was lost")


def _spread(calls: int, points: int) -> Iterator[int]:
    count = min(calls, points)
    yield from sorted({1 + k * (calls - 1) // max(count - 1, 1) for k in range(count)})


def _try(
    library: ctypes.CDLL, step: Step, original: Path, folder: Path, way: Way, number: int
) -> tuple[str, int]:
    """Run a step that fails at a call; returns how it ended, and how many calls there were."""
    path = folder / "map.gpkg"
    for name in ("map", "copy", "kept"):
        for old in folder.glob(f"{name}.gpkg*"):
            old.unlink()
    shutil.copy(original, path)
    before = state_of(path)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _fail(library, step, path, way, number, writer)
    os.close(writer)
    _, status = os.waitpid(child, 0)
    with os.fdopen(reader) as pipe:
        said = pipe.read()
    place = f"{step.name}, {way.name} at call {number}: {said}"
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL, place
        outcome, allowed = "killed", [before, step.expected(before)]
    else:
        code = os.WEXITSTATUS(status)
        assert code in (REFUSED, DONE), place
        outcome = "refused" if code == REFUSED else "done all the same"
        allowed = _allowed(step, before, code)
    _check(path, folder, allowed, place)
    return outcome, int(said) if way.mode == COUNT else 0


def _allowed(step: Step, before: State, code: int) -> list[State]:
    # A commit whose last sync failed is refused, although it may be on the disk.
    return [step.expected(before)] if code == DONE else [before, step.expected(before)]


def _check(path: Path, folder: Path, allowed: list[State], place: str) -> None:
    try:
        assert not (folder / "kept.gpkg-journal").exists()
        check(path, allowed)
        copy = folder / "copy.gpkg"
        if copy.exists():
            check(copy, [{name: found for name, found in allowed[0].items() if found[0]}])
        with open_map(path, writable=True) as universal:  # and it can be gone on with
            universal.repair()
    except BaseException as error:
        error.add_note(place)
        raise


def _fail(library: ctypes.CDLL, step: Step, path: Path, way: Way, number: int, pipe: int) -> None:
    """The life of the writer; does not return."""
    code, said = STRANGE, ""
    try:
        library.fault_arm(number, way.mode, way.error)
        step.run(path)
        code = DONE
    except MapWriteError as error:
        code, said = REFUSED, str(error)
    except BaseException as error:  # noqa: BLE001 - whatever it is, the parent shall hear of it
        said = f"{type(error).__name__}: {error}"
    finally:
        calls = library.fault_count()
        library.fault_disarm()
        os.write(pipe, (str(calls) if way.mode == COUNT else said).encode())
        os._exit(code)


def main() -> None:
    """Run as a program."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["--inside"]:
        _inside(int(arguments[1]))
        return
    done = run_in_child("tests.crash.failures", arguments[0] if arguments else "40")
    print(done.stdout, end="")
    print(done.stderr, end="", file=sys.stderr)
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
