"""Locks on files are waited for in turn, and not without end."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fieldgrid import file_locks
from fieldgrid.file_locks import lock, lock_within


@contextmanager
def opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def test_a_lock_is_had_as_soon_as_another_program_lets_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = threading.Event()

    def noted(descriptor: int, *, wait: bool) -> None:
        if wait:
            waits.set()
        lock(descriptor, wait=wait)

    monkeypatch.setattr(file_locks, "lock", noted)
    with opened(tmp_path) as ours, opened(tmp_path) as other:
        theirs = os.open(tmp_path, os.O_RDONLY)
        lock(theirs, wait=False)
        release = threading.Thread(target=lambda: (waits.wait(), os.close(theirs)))
        release.start()
        assert lock_within(ours, 60.0)
        release.join()
        with pytest.raises(BlockingIOError):  # the thread that waited has not taken it along
            lock(other, wait=False)


def test_a_lock_that_is_given_up_is_nobodys(tmp_path: Path) -> None:
    with opened(tmp_path) as theirs:
        lock(theirs, wait=False)
        with opened(tmp_path) as ours:
            assert not lock_within(ours, 0.01)
        with opened(tmp_path) as third:
            assert not lock_within(third, 0.01)
    with opened(tmp_path) as last:
        assert lock_within(last, 60.0)


def test_a_file_system_without_locks_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(_: int, *, wait: bool) -> None:
        raise BlockingIOError if not wait else OSError("no locks")

    monkeypatch.setattr(file_locks, "lock", none)
    with opened(tmp_path) as ours, pytest.raises(OSError, match="no locks"):
        lock_within(ours, 60.0)
