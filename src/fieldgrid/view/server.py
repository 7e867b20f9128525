"""Running the viewer: a socket, a link with a token, and a browser that opens it."""

from __future__ import annotations

import asyncio
import secrets
import socket
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Datum
from fieldgrid.view.app import Viewer, make_app
from fieldgrid.view.farms import shown_at
from fieldgrid.view.features import route_table
from fieldgrid.view.listening import LOOPBACK, listen
from fieldgrid.view.security import loopback_access, network_access

_PATIENCE_S = 10.0
"""Time after which a connection is closed whose client has not asked for anything yet."""


def view_maps(
    paths: Sequence[Path],
    *,
    datum: Datum | None = None,
    recordings: Sequence[Path] = (),
    routes: Sequence[Path] = (),
    host: str | None = None,
    port: int | None = None,
    writable: bool = True,
    open_browser: bool = False,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Serve maps as a web page until interrupted; a folder is shown as a farm, all its maps as one.

    Farms have the plane of `datum`, or of their first map; their maps are not changed.
    `routes` are files that are drawn over each map, as `figures.read_route` reads them. Without
    `host` only this machine reaches it; `port` None is any that is free. `ready` gets the
    link, with the token that writing needs, once the page can be opened. Raises MapError for a
    path that is no map, DatumError as `Farm`, ConfigError for a port that is taken or a file that
    is no route.
    """
    maps = shown_at(paths, datum)
    for folder in recordings:
        if not folder.exists():
            raise ConfigError(f"{folder} does not exist; give the folder of a recording.")
    for shown in maps:
        with shown.open() as universal:
            for path in routes:  # what is wrong with one is said now, and not on the page
                route_table(path, universal.datum)
    token = secrets.token_urlsafe(24)
    listening = listen(host or LOOPBACK, port or 0)
    with listening:
        port = int(listening.getsockname()[1])
        access = network_access(token, port, host) if host else loopback_access(token, port)
        viewer = Viewer(maps, access, writable, tuple(recordings), tuple(routes))
        link = f"http://{in_link(host)}:{port}/#token={token}"
        if ready is not None:
            ready(link)
        if open_browser:
            webbrowser.open(link)
        make_server(make_app(viewer)).run(sockets=[listening])


def make_server(app: Starlette) -> uvicorn.Server:
    """The web server of an application, to be run with the sockets that it answers on."""
    return uvicorn.Server(
        uvicorn.Config(
            app,
            http=_PatientProtocol,
            log_config=None,
            log_level=None,
            access_log=False,
            server_header=False,
            lifespan="on",
            timeout_graceful_shutdown=2,
        )
    )


class _PatientProtocol(H11Protocol):
    """HTTP with a client that sends whole requests in a bounded time."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.loop.call_later(_PATIENCE_S, self._close_if_idle)

    def _close_if_idle(self) -> None:
        is_answered = bool(self.cycle) and not self.cycle.response_complete
        if not is_answered or self.cycle.more_body:
            self.transport.close()
        elif not self.transport.is_closing():
            self.loop.call_later(_PATIENCE_S, self._close_if_idle)


def in_link(host: str | None) -> str:
    """The host as another machine, or this one, calls it."""
    if host is None:
        return LOOPBACK
    if host in ("0.0.0.0", "::"):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host
