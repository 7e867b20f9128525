"""A socket that waits for clients, and bounds their number."""

from __future__ import annotations

import socket
import weakref
from typing import Any

from fieldgrid.core import ConfigError

LOOPBACK = "127.0.0.1"

_MOST_CONNECTIONS = 64


class _BoundedSocket(socket.socket):
    """Listens, and hangs up at once on whoever comes while too many are connected, so that they
    never take the file descriptors that a drive needs."""

    def __init__(self, listening: socket.socket) -> None:
        family, kind, proto = listening.family, listening.type, listening.proto
        super().__init__(family, kind, proto, listening.detach())
        self.setblocking(False)
        self._connected: weakref.WeakSet[socket.socket] = weakref.WeakSet()

    def accept(self) -> tuple[socket.socket, Any]:
        """As of a socket; ConnectionAbortedError where there are too many."""
        connection, address = super().accept()
        if sum(one.fileno() >= 0 for one in self._connected) >= _MOST_CONNECTIONS:
            connection.close()
            raise ConnectionAbortedError
        self._connected.add(connection)
        return connection, address


def listen(host: str, port: int) -> socket.socket:
    """A socket that waits for requests, of 64 clients at most; `port` 0 is any free one."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return _BoundedSocket(socket.create_server((host, port), family=family, backlog=128))
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"Nothing can be served at {host}:{port} ({error}); give another port or host."
        ) from error
