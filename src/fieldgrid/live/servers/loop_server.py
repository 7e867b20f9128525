"""A server with a loop of events in a thread of its own."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

from fieldgrid.core import Closing
from fieldgrid.view import listen

_PATIENCE_S = 10.0


class LoopServer(Closing):
    """Listens at a host and a port until it is closed; nobody waits for its clients.

    `port` 0 is any that is free, which `address` tells. ConfigError where it cannot be had.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        self._listening = listen(host, port)
        self.address: tuple[str, int] = self._listening.getsockname()[:2]
        self._loop = asyncio.new_event_loop()
        self._closing = asyncio.Event()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    async def _serve(self) -> None:
        """Serve until `_closing` is set."""
        raise NotImplementedError

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()
            self._listening.close()

    def _call(self, work: Callable[..., Any], *given: Any) -> None:
        """Let the loop do something, from any thread; nothing once it has ended."""
        if not (self._is_closed or self._loop.is_closed()):
            self._loop.call_soon_threadsafe(work, *given)

    def close(self) -> None:
        """Leave all clients."""
        self._call(self._closing.set)
        self._is_closed = True
        self._thread.join(_PATIENCE_S)
