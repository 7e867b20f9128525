"""What is made once for all processes of a run of the tests, and only read by them."""

from __future__ import annotations

import os
import pickle
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")

_WAIT_S = 600.0

RUN_FOLDER = "FIELDGRID_TESTS_FOLDER"
"""The variable that names the folder in memory of a run, which is removed at its end."""


def made_once(
    factory: pytest.TempPathFactory, name: str, make: Callable[[Path], T]
) -> tuple[Path, T]:
    """The folder in which `make` left its files, and what it returned, which is pickled.

    The first process that needs it calls `make` with the empty folder, and the others wait for it.
    When that fails, it fails in that process, and the next one tries for itself.
    """
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # each worker has a folder of its own in that of the run
    done = base / f"{name}.pickle"
    # A lock that every system has, and that is given back by a process that dies.
    with closing(
        sqlite3.connect(base / f"{name}.lock", timeout=_WAIT_S, isolation_level=None)
    ) as lock:
        lock.execute("BEGIN EXCLUSIVE")
        if not done.exists():
            folder = factory.mktemp(name)
            draft = folder.parent / f"{name}.draft"
            draft.write_bytes(pickle.dumps((folder, make(folder))))
            draft.replace(done)
    made: tuple[Path, T] = pickle.loads(done.read_bytes())
    return made
