"""Locks on files, of which the system lets go when a program ends, however it does."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

try:
    import fcntl
except ImportError as error:
    raise ImportError("fieldgrid needs the file locks of Linux; on Windows use WSL 2.") from error


def lock(descriptor: int, *, wait: bool) -> None:
    """Lock an open file or folder for this program. OSError where another one has it and this one
    does not `wait`, or where the file system has no locks."""
    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


def let_go(descriptor: int) -> None:
    """Unlock an open file or folder, and close it. Closing alone leaves it locked as long as a
    process has a copy of it that was forked meanwhile."""
    with suppress(OSError):  # a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)


def lock_within(descriptor: int, wait_s: float) -> bool:
    """Lock an open file or folder for this program, in turn, as soon as no other one has it; False
    where that takes too long. OSError where the file system has no locks.

    The system can wait without end only, or until a signal, which a library has none of. So a
    thread waits. One that is given up waits on, with the open file to itself, and lets go at once;
    the caller, too, calls `let_go` then: the thread may have had the lock in that moment.
    """
    with suppress(BlockingIOError):
        lock(descriptor, wait=False)
        return True
    waiting = _LockThread(os.dup(descriptor))
    try:
        waiting.start()
    except RuntimeError:  # no more threads
        os.close(waiting.descriptor)
        raise
    try:
        waiting.join(wait_s)
    finally:
        if waiting.is_alive():
            waiting.is_given_up = True
    if waiting.problem is not None:
        raise waiting.problem
    return not waiting.is_given_up


class _LockThread(threading.Thread):
    """Waits for a lock by a descriptor of its own, which it closes. The lock stays with other
    descriptors of the same open file, as long as there are any."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(name="fieldgrid-lock", daemon=True)
        self.descriptor = descriptor
        self.problem: OSError | None = None
        """Why there can be no lock."""
        self.is_given_up = False
        """Nobody waits for the lock any more."""

    def run(self) -> None:
        try:
            lock(self.descriptor, wait=True)
        except OSError as error:
            self.problem = error
        finally:
            # Where nobody waits for it any more, the file is unlocked.
            (let_go if self.is_given_up else os.close)(self.descriptor)
