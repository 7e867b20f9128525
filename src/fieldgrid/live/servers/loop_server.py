"""A server with a loop of events in a thread of its own, and what waits for its clients."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

from fieldgrid.core import Closing
from fieldgrid.view import listen

_PATIENCE_S = 10.0

MOST_WAITING = 256
"""Messages that all count which wait for a client."""


class LiveMessage:
    """A message that is encoded once, when the first client takes it."""

    def __init__(self, time_ns: int, encode: Callable[[], bytes]) -> None:
        self.time_ns = time_ns
        self._encode: Callable[[], bytes] | None = encode
        self._lock = threading.Lock()
        self._data = b""

    def data(self) -> bytes:
        """What is sent."""
        with self._lock:
            if self._encode is not None:
                self._data, self._encode = self._encode(), None
            return self._data


Send = Callable[[int, LiveMessage, bytes], Awaitable[None]]
"""Sends a message of a channel, as it is encoded, to a client."""


class LiveClient:
    """What waits for a client: of each channel the newest message, or all in a queue that is
    bounded. What gives way is counted."""

    def __init__(self) -> None:
        self.missed = 0
        self._changed = asyncio.Event()
        self._newest: dict[int, LiveMessage] = {}
        self._waiting: deque[tuple[int, LiveMessage]] = deque(maxlen=MOST_WAITING)

    def offer(self, channel: int, message: LiveMessage, *, keeps_all: bool = False) -> None:
        """Let a message wait."""
        if keeps_all:
            self.missed += len(self._waiting) == self._waiting.maxlen
            self._waiting.append((channel, message))
        else:
            self.missed += channel in self._newest
            self._newest[channel] = message
        self._changed.set()

    def next(self) -> tuple[int, LiveMessage] | None:
        """What is to be sent next; small things before grids."""
        if self._waiting:
            return self._waiting.popleft()
        channel = max(self._newest, default=None)
        return None if channel is None else (channel, self._newest.pop(channel))

    async def serve(self, send: Send) -> None:
        """Send what waits, as fast as it is taken."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            while (found := self.next()) is not None:
                await send(*found, await asyncio.to_thread(found[1].data))


class LoopServer(Closing):
    """Listens at a host and a port until it is closed; nobody waits for its clients.

    `port` 0 is any that is free, which `address` tells. ConfigError where it cannot be had.
    """

    def __init__(
        self, host: str, port: int, name: str, tell: Callable[[str], None] | None = None
    ) -> None:
        self._listening = listen(host, port)
        self.address: tuple[str, int] = self._listening.getsockname()[:2]
        self._tell = tell or (lambda _: None)
        self._clients: list[LiveClient] = []
        self._latest: dict[int, LiveMessage] = {}
        self._runner = asyncio.Runner(loop_factory=asyncio.new_event_loop)
        self._loop = self._runner.get_loop()
        self._closing = asyncio.Event()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    async def _serve(self) -> None:
        """Serve until `_closing` is set."""
        raise NotImplementedError

    def _run(self) -> None:
        try:
            with self._runner:
                self._runner.run(self._serve())
        finally:
            self._listening.close()

    def _is_full(self, name: str, most: int) -> bool:
        """Whether there are clients enough; then it is told of one more."""
        if len(self._clients) >= most:
            self._tell(f"{name} has {most} clients already; one more was refused.")
        return len(self._clients) >= most

    @contextmanager
    def _serving(self, client: LiveClient, send: Send) -> Iterator[None]:
        """Send to a client what is offered."""
        self._clients.append(client)
        sending = asyncio.create_task(client.serve(send))
        try:
            yield
        finally:
            sending.cancel()
            self._clients.remove(client)

    def _offer(self, channel: int, message: LiveMessage, *, keeps_all: bool = False) -> None:
        """Offer a message to all clients; in the loop."""
        self._latest[channel] = message
        for client in self._clients:
            client.offer(channel, message, keeps_all=keeps_all)

    def _call(self, work: Callable[..., Any], *given: Any) -> None:
        """Let the loop do something, from any thread; nothing once it has ended."""
        if not (self._is_closed or self._loop.is_closed()):
            self._loop.call_soon_threadsafe(work, *given)

    def close(self) -> None:
        """Leave all clients."""
        self._call(self._closing.set)
        self._is_closed = True
        self._thread.join(_PATIENCE_S)
