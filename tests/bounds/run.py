"""Each case in a process of its own, under 1 GB of address space and 20 s of processor time.

`python -m tests.bounds.run FOLDER [CASE ...]` prints a line of JSON a case.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sys
import traceback
from pathlib import Path

from fieldgrid.core import FieldgridError
from tests.bounds.inputs import CASES

ADDRESSES_BYTES = 1 << 30
PROCESSOR_S = 20


def _attempt(name: str, folder: Path, answer: int) -> None:
    """In the child: what becomes of the input."""
    read = CASES[name](folder)
    used = resource.getrusage(resource.RUSAGE_SELF)
    spent = int(used.ru_utime + used.ru_stime) + 1
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES_BYTES, ADDRESSES_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (spent + PROCESSOR_S, spent + PROCESSOR_S + 1))
    try:
        read()
        said = "read"
    except FieldgridError as error:
        said = f"refused: {error}"
    except Exception as error:  # noqa: BLE001 - what escapes is what is looked for
        traceback.print_exc()
        said = f"{type(error).__name__}: {error}"[:300]
    after = resource.getrusage(resource.RUSAGE_SELF)
    seconds = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    os.write(answer, json.dumps([name, said, round(seconds, 2), after.ru_maxrss >> 10]).encode())


def run(name: str, folder: Path) -> list[object]:
    """Name, what became of the input, seconds of processor time and MB at most."""
    maker = os.fork()  # what making takes does not count
    if not maker:
        CASES[name](folder)
        os._exit(0)
    os.waitpid(maker, 0)
    ours, theirs = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.close(ours)
            _attempt(name, folder, theirs)
        finally:
            os._exit(0)
    os.close(theirs)
    with os.fdopen(ours, "rb") as answer:
        said = answer.read()
    _, status = os.waitpid(child, 0)
    return list(json.loads(said)) if said else [name, f"ended by {status}", 0, 0]


def main(folder: Path, names: list[str]) -> None:
    """All cases, or those that are named."""
    for name in names or CASES:
        place = folder / name
        place.mkdir()
        print(json.dumps(run(name, place)), flush=True)
        shutil.rmtree(place)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
