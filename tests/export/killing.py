"""Sets of files whose writer is killed.

The writers are copies of a process that is small: to copy one that has run thousands of tests takes
a tenth of a second, each time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fieldgrid.export.together import write_together

KilledAt = Callable[[int, Path, str, tuple[str, ...]], bool]
"""Writes a set in a process that ends at a change of a file; False where all is done before."""

CHANGES = ("link", "symlink", "replace", "unlink", "mkdir", "rmdir", "fsync")
"""What a program that is killed may have been about to do."""

ROOT = Path(__file__).resolve().parents[2]


def text(words: str) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        file.write_text(words)

    return write


def write_set(folder: Path, words: str, names: tuple[str, ...]) -> None:
    write_together(
        {folder / name: text(f"{words} {name}") for name in (*names, "a.main")},
        overwrite=True,
        ours=lambda _: True,
        what="a test",
        gone=[] if "a.mask" in names else [folder / "a.mask"],
    )


@contextmanager
def small_process() -> Iterator[KilledAt]:
    """A process whose copies are killed, until the end of the block."""
    command = [sys.executable, "-m", "tests.export.killing"]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        asked, answers = process.stdin, process.stdout
        assert asked is not None
        assert answers is not None

        def killed_at(number: int, folder: Path, words: str, names: tuple[str, ...]) -> bool:
            asked.write(json.dumps([number, str(folder), words, names]) + "\n")
            asked.flush()
            ended: bool = {9: True, 0: False}[int(answers.readline())]
            return ended

        yield killed_at
        asked.close()


def _ended_at(number: int, folder: Path, words: str, names: tuple[str, ...]) -> int:
    """The exit status of a copy of this process: 9 where it ended itself at that change."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    left = number

    def counted(change: Callable[..., None]) -> Callable[..., None]:
        def instead(*arguments: Any, **options: Any) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                os._exit(9)
            change(*arguments, **options)

        return instead

    for name in CHANGES:
        setattr(os, name, counted(getattr(os, name)))
    status = 1
    try:
        write_set(folder, words, names)
        status = 0
    finally:
        os._exit(status)


def main() -> None:
    """Answer each line, which says what to write and when to end, with the exit status."""
    for line in sys.stdin:
        number, folder, words, names = json.loads(line)
        print(_ended_at(number, Path(folder), words, tuple(names)), flush=True)


if __name__ == "__main__":
    main()
