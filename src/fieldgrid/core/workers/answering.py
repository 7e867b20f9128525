"""Who answers at the address of a scheduler, asked before Dask's client is made: that one waits
for the greeting of a program of another kind without end."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from fieldgrid.core.errors import ClusterError

ANSWER_S = 3.0
"""How long a program that is no Dask scheduler may take to say what it is."""

_SHOWN_BYTES = 60

# What a web server answers, and most others, too, with a complaint.
_QUESTION = b"GET / HTTP/1.0\r\n\r\n"


def check_scheduler(address: str, timeout_s: float) -> None:
    """Raise ClusterError when something else than a Dask scheduler answers at an address.

    Where nothing answers: whatever Dask raises. Only TCP is asked; an encrypted connection needs
    the certificates that Dask's client finds.
    """
    from distributed.comm import parse_address

    if parse_address(address)[0] != "tcp":
        return
    try:
        # A thread with a loop of its own, since the caller may be in one, as in a notebook.
        with ThreadPoolExecutor(1) as thread:
            told = thread.submit(asyncio.run, _identity(address, timeout_s)).result()
    except Exception as error:
        what = _what_answers(address, timeout_s)
        if what is None:
            raise
        raise _is_another(address, what) from error
    if "workers" not in told:
        raise _is_another(address, f"a Dask {str(told.get('type', 'program')).lower()}")


async def _identity(address: str, timeout_s: float) -> Mapping[str, Any]:
    """What a program that speaks Dask's language says of itself."""
    from distributed.comm import connect

    async def ask() -> Any:
        comm = await connect(address, timeout=timeout_s)
        try:
            await comm.write({"op": "identity", "reply": True})
            return await comm.read()
        finally:
            comm.abort()

    # Longer than connecting may take, whose error says more.
    told = await asyncio.wait_for(ask(), 1.1 * timeout_s)
    return told if isinstance(told, Mapping) else {}


def _what_answers(address: str, timeout_s: float) -> str | None:
    """In words; None when nobody takes the connection."""
    from distributed.comm import get_address_host_port

    try:
        with socket.create_connection(get_address_host_port(address), timeout_s) as asked:
            said = _answer(asked)
    except (OSError, ValueError, OverflowError):
        return None
    if said.startswith(b"HTTP/"):
        return "a web server (the dashboard?)"
    line = said[:_SHOWN_BYTES].partition(b"\n")[0].strip()
    if line and line.isascii() and line.decode("ascii").isprintable():
        return f"a program that says {line.decode('ascii')!r}"
    return "a program of another protocol" if said else "a program that says nothing"


def _answer(asked: socket.socket) -> bytes:
    """The beginning of what is answered to a question, or said before one; empty for silence."""
    asked.settimeout(ANSWER_S)
    try:
        asked.sendall(_QUESTION)
        return asked.recv(_SHOWN_BYTES)
    except OSError:  # it was silent for all the time, or hung up: both are an answer
        return b""


def _is_another(address: str, what: str) -> ClusterError:
    return ClusterError(
        f"At {address} answers {what}, no Dask scheduler; give the address that the scheduler "
        "printed when it began, tcp://HOST:8786 if it was told no other."
    )
