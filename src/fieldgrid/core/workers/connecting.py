"""A client of a Dask scheduler."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fieldgrid.core.errors import ClusterError, ConfigError

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
"""How long a scheduler may take to answer."""


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
        # A thread with a loop of its own, since the caller may be in one, as in a notebook.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, _check_answer(scheduler)).result()
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False, name="fieldgrid")
    except Exception as error:  # what another program says can raise anything in Dask
        raise ClusterError(
            f"No Dask scheduler answers at {scheduler} ({first_line(error)}); start one there "
            "with: dask scheduler, or check address and firewall."
        ) from error
    with client:
        yield client


async def _check_answer(address: str) -> None:
    """Raise an error when no scheduler answers. Dask's client waits for the greeting of a program
    of another kind without end. Only TCP is asked; an encrypted connection needs the certificates
    that the client finds."""
    from distributed.comm import connect, parse_address

    if parse_address(address)[0] != "tcp":
        return

    async def ask() -> object:
        comm = await connect(address, timeout=CONNECT_S)
        try:
            await comm.write({"op": "identity", "reply": True})
            return await comm.read()
        finally:
            comm.abort()

    # Longer than connecting may take, whose error says more.
    try:
        told = await asyncio.wait_for(ask(), 1.1 * CONNECT_S)
    except MemoryError as error:  # Dask took what it says for the size of a message
        raise ValueError("another program does") from error
    if not isinstance(told, dict) or "workers" not in told:
        raise ValueError("another program does")


def first_line(error: BaseException) -> str:
    """What an error says first, or its kind."""
    return (str(error) or type(error).__name__).strip().partition("\n")[0].rstrip(".")
