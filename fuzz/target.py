"""What is fuzzed: a parser, inputs to start from, and how a mutant is made plausible."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_SEED_BYTES = 4096


class Target(NamedTuple):
    """One parser under test.

    `check` takes any bytes and raises for what must not happen, be it a crash or a result that
    cannot be; the errors that the parser raises on purpose are none. `seeds` gives good input.
    `mend` makes checksums right again, so that mutants get past them.
    """

    name: str
    check: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    mend: Callable[[bytes], bytes] = bytes


def check_sentence(text: str) -> None:
    """What a reader says of input that it refuses ends as a sentence does."""
    assert text.endswith((".", "?")), text


def written(data: bytes, name: str) -> Path:
    """A file with these bytes. The next one of that name takes its place: to make a folder and a
    file anew takes longer than most parsers do."""
    path = _scratch() / name
    path.write_bytes(data)
    return path


@cache
def _scratch() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="fieldgrid-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def real_starts(*patterns: str) -> list[bytes]:
    """The first few kilobytes of real files beside the repository, where they are there."""
    paths = sorted(path for pattern in patterns for path in SHARED_DATA.glob(pattern))
    return [start for path in paths if path.is_file() for start in [_start(path)] if start]


def _start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_SEED_BYTES)
