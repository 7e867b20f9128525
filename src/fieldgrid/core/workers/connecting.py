"""A client of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fieldgrid.core.errors import ClusterError, ConfigError
from fieldgrid.core.workers.answering import check_scheduler

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
"""How long a scheduler may take to answer."""

_NO_SCHEDULER = (OSError, ValueError, TypeError, OverflowError, AssertionError, MemoryError)
"""What connecting raises: on a loaded machine Dask asserts that its own thread has begun in time,
and what a server of another kind says it takes for the size of a message."""


@contextmanager
def connected(scheduler: str | Client) -> Iterator[Client]:
    """A client of the scheduler at an address, closed at the end of the block, or the client that
    is given. ClusterError when none or another program answers, ConfigError without Dask."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "Work on a cluster needs Dask, which is not installed; "
            "run: pip install 'fieldgrid[dask]'"
        ) from error
    if isinstance(scheduler, Client):
        if scheduler.asynchronous:
            raise ConfigError("The Dask client is asynchronous; give the scheduler's address.")
        yield scheduler
        return
    try:
        check_scheduler(scheduler, CONNECT_S)
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False, name="fieldgrid")
    except _NO_SCHEDULER as error:
        raise ClusterError(
            f"No Dask scheduler answers at {scheduler} ({first_line(error)}); start one there "
            "with: dask scheduler, or check address and firewall."
        ) from error
    with client:
        yield client


def first_line(error: BaseException) -> str:
    """What an error says first, or its kind."""
    return (str(error) or type(error).__name__).strip().partition("\n")[0].rstrip(".")
