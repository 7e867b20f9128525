"""Locks on files, of which the system lets go when a program ends, however it does."""

from __future__ import annotations

import os
import threading

try:
    import fcntl
except ImportError as error:
    raise ImportError("fieldgrid needs the file locks of Linux; on Windows use WSL 2.") from error


def lock(descriptor: int, *, wait: bool) -> None:
    """Lock an open file or folder for this program. OSError where another one has it and this one
    does not `wait`, or where the file system has no locks."""
    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


def lock_within(descriptor: int, wait_s: float) -> bool:
    """Lock an open file or folder for this program, in turn, as soon as no other one has it; False
    where that takes too long. OSError where the file system has no locks.

    The system can wait without end only, or until a signal, which a library has none of. So a
    thread waits. One that is given up waits on, with the open file to itself, and lets go at once.
    """
    try:
        lock(descriptor, wait=False)
    except BlockingIOError:
        waiting = _Waiting(os.dup(descriptor))
        waiting.start()
        waiting.join(wait_s)
        return waiting.has_it()
    return True


class _Waiting(threading.Thread):
    """Waits for a lock by a descriptor of its own, which it closes. The lock stays with other
    descriptors of the same open file, as long as there are any."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(name="fieldgrid-lock", daemon=True)
        self._descriptor = descriptor
        self._problem: OSError | None = None

    def run(self) -> None:
        try:
            lock(self._descriptor, wait=True)
        except OSError as error:
            self._problem = error
        finally:
            os.close(self._descriptor)

    def has_it(self) -> bool:
        """Whether the lock was had in time. OSError where it cannot be."""
        if self._problem is not None:
            raise self._problem
        return not self.is_alive()
