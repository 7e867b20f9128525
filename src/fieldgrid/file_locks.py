"""Locks on files, of which the system lets go when a program ends, however it does."""

from __future__ import annotations

try:
    import fcntl
except ImportError as error:
    raise ImportError("fieldgrid needs the file locks of Linux; on Windows use WSL 2.") from error


def lock(descriptor: int, *, wait: bool) -> None:
    """Lock an open file or folder for this program. OSError where another one has it and this one
    does not `wait`, or where the file system has no locks."""
    fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
