"""The page that follows the vehicle: a web server in a thread, and a stream of what is new.

The stream is one of server-sent events. Each client gets what is newest when it has taken what it
was sent before, so one that does not read holds a message and what sockets hold, and no more.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
from collections.abc import AsyncIterator
from functools import partial

import anyio.to_thread
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from fieldgrid.core import palette
from fieldgrid.live.results import LiveResult
from fieldgrid.live.servers.live_state import AGE_UNIT_S, SIGMA_UNIT_M, LiveState
from fieldgrid.live.servers.loop_server import LoopServer
from fieldgrid.view import (
    LOOPBACK,
    Guard,
    in_link,
    loopback_access,
    make_server,
    network_access,
    page,
)

MOST_CLIENTS = 8

STILL_HERE_S = 2.0
"""Period at which something is sent when nothing is new: the page tells a server that is gone by
that."""

LEAST_S = 0.1
"""No client is sent more in less: eyes do not see it."""

_THREAD = "fieldgrid-page"


class LivePage(LoopServer):
    """Serves a page that follows the vehicle, in a thread of its own, until it is closed.

    Give it results with `take`, which never blocks. As with the viewer of maps, only this machine
    reaches it unless `host` is another one; then data need the token of the `link`. `port` 0 is any
    that is free. Raises ConfigError where it cannot be had.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 0, *, session: str = "") -> None:
        super().__init__(host, port, _THREAD)
        port = int(self.address[1])
        token = secrets.token_urlsafe(24)
        is_own = host == LOOPBACK
        access = loopback_access(token, port) if is_own else network_access(token, port, host)
        self.link = f"http://{in_link(None if is_own else host)}:{port}/#token={token}"
        """What to open in a browser."""
        self.clients = 0
        self._changed = asyncio.Event()
        self._story = LiveState(session, partial(self._call, self._changed.set))
        routes = (Route("/api/live", self._stream), Route("/api/colours", _colours))
        guard = Middleware(Guard, access=access)
        app = Starlette(routes=[*page.routes("live.html"), *routes], middleware=[guard])
        self._server = make_server(app)
        self._thread.start()

    def take(self, result: LiveResult) -> None:
        """Show a result; it never blocks."""
        self._story.take(result)

    def close(self) -> None:
        """End the page; those that are open say so."""
        self._server.should_exit = True
        for end in (self._closing, self._changed):
            self._call(end.set)
        # A client that does not read is cut off, which the server reports as a failure.
        log = logging.getLogger("uvicorn.error")
        log.addFilter(_is_of_another)
        super().close()
        log.removeFilter(_is_of_another)

    async def _serve(self) -> None:
        await self._server.serve(sockets=[self._listening])

    async def _stream(self, request: Request) -> Response:
        if self.clients >= MOST_CLIENTS:
            text = f"{MOST_CLIENTS} look on already; close one of those pages."
            return JSONResponse({"error": text}, 503)
        return StreamingResponse(
            self._news(), media_type="text/event-stream", headers={"Cache-Control": "no-store"}
        )

    async def _news(self) -> AsyncIterator[bytes]:
        """What is new, again and again, as server-sent events."""
        self.clients += 1
        walked = said = number = 0
        try:
            while not self._closing.is_set():
                if self._story.number == number:
                    # Anybody's wake-up is everybody's: who has seen it all waits on.
                    self._changed.clear()
                    try:
                        await asyncio.wait_for(self._changed.wait(), STILL_HERE_S)
                    except TimeoutError:
                        yield b": still here\n\n"
                    continue
                told = await anyio.to_thread.run_sync(self._story.told, walked, said)
                walked, said, number = told["walked"], told["said"], told["number"]
                yield b"data: " + json.dumps(told, separators=(",", ":")).encode() + b"\n\n"
                await asyncio.sleep(LEAST_S)
            yield b"event: end\ndata: {}\n\n"
        finally:
            self.clients -= 1


def _colours(request: Request) -> Response:
    """The colours of the page, and what the values of its picture mean."""
    return JSONResponse(
        {
            "cost": palette.COST,
            "values": palette.VALUES,
            "unsure": [[0.0, palette.UNSURE[0]], [1.0, palette.UNSURE[1]]],
            "gears": palette.GEARS,
            "rejected": palette.REJECTED,
            "measured": palette.MEASURED,
            "age_unit_s": AGE_UNIT_S,
            "sigma_unit_m": SIGMA_UNIT_M,
        }
    )


def _is_of_another(record: logging.LogRecord) -> bool:
    """Whether a record was logged by another server than a page's."""
    return record.threadName != _THREAD
