"""Locks on files are waited for in turn, and not without end."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fieldgrid.core import file_locks, let_go, lock, lock_within


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


def test_a_copy_of_a_descriptor_that_was_forked_keeps_no_lock(tmp_path: Path) -> None:
    ours = os.open(tmp_path, os.O_RDONLY)
    copy = os.dup(ours)  # as fork() makes it in the other process
    try:
        lock(ours, wait=False)
        let_go(ours)
        with opened(tmp_path) as other:
            lock(other, wait=False)
    finally:
        os.close(copy)


def test_a_lock_that_comes_too_late_is_let_go_of_whoever_has_a_copy(tmp_path: Path) -> None:
    with opened(tmp_path) as copied:
        with opened(tmp_path) as theirs:
            lock(theirs, wait=False)
            assert not lock_within(copied, 0.01)
            waiting = [one for one in threading.enumerate() if one.name == "fieldgrid-lock"]
        for thread in waiting:
            thread.join(60.0)
        with opened(tmp_path) as other:
            lock(other, wait=False)


def test_a_thread_that_cannot_start_leaves_nothing_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(_self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with opened(tmp_path) as theirs, opened(tmp_path) as ours:
        lock(theirs, wait=False)
        before = os.listdir("/proc/self/fd")
        with monkeypatch.context() as patched:
            patched.setattr(threading.Thread, "start", start)
            with pytest.raises(RuntimeError):
                lock_within(ours, 60.0)
        assert len(os.listdir("/proc/self/fd")) == len(before)
