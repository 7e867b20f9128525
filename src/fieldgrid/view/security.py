"""Who may ask what: a page served on this machine is open to every web site that its user visits.

* The Host of a request must be a name of this server, so no foreign name can be pointed at it
  (DNS rebinding).
* Writing needs the token of the link that the server printed, in a header that no foreign page can
  set, an Origin that is this server's, and JSON. So no foreign page can post (cross-site request).
* The page may load nothing but itself, and runs no inline script (content security policy).
* With `token_for_reading`, where the local network reaches the server, data need the token too.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
from typing import NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

TOKEN_HEADER = "X-Fieldgrid-Token"
MAX_BODY_BYTES = 256 * 1024

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Access(NamedTuple):
    """Where the server is reached and what it asks for. `names` are the hosts that a browser may
    call it by, besides IP addresses where `any_address` is true."""

    token: str
    port: int
    names: frozenset[str]
    any_address: bool
    token_for_reading: bool

    def is_host(self, host: str) -> bool:
        """Whether a Host header, or what follows `http://` in an Origin, is this server's."""
        name, _, port = host.rpartition(":")
        if not name or not port.isascii() or not port.isdigit():
            name, port = host, "80"
        if int(port) != self.port:
            return False
        name = name.lower()
        return name in self.names or (self.any_address and _is_address(name))

    def is_origin(self, origin: str) -> bool:
        """Whether an Origin header is this server's."""
        return origin.startswith("http://") and self.is_host(origin.removeprefix("http://"))

    def has_token(self, headers: Headers) -> bool:
        """Whether a request carries the token."""
        given = headers.get(TOKEN_HEADER, "")
        return secrets.compare_digest(given.encode(), self.token.encode())


def loopback_access(token: str, port: int) -> Access:
    """Access to a server on 127.0.0.1 alone."""
    return Access(
        token,
        port,
        frozenset({"127.0.0.1", "localhost", "[::1]"}),
        any_address=False,
        token_for_reading=False,
    )


def network_access(token: str, port: int, host: str) -> Access:
    """Access to a server that the local network reaches under `host`, an address or a name.

    Any address will do in a Host header: rebinding needs a name.
    """
    own = socket.gethostname().lower()
    return Access(
        token,
        port,
        frozenset({host.lower(), "localhost", own, f"{own}.local"}),
        any_address=True,
        token_for_reading=True,
    )


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True


class Guard:
    """ASGI middleware: refuses what must not pass, and gives every answer its headers."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a refused request, or pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # nothing here speaks WebSocket
            await send({"type": "websocket.close", "code": 1008})
            return
        headers = Headers(scope=scope)

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        app, refusal = self._app, self._refusal(scope, headers)
        if refusal is not None:
            status, reason = refusal
            app = JSONResponse({"error": reason}, status)
        await app(scope, receive, sending)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        method, path = scope["method"], scope["path"]
        if not self._access.is_host(headers.get("host", "")):
            return 421, "This server is not called that; open the link that it printed."
        if method not in ("GET", "HEAD", "POST"):
            return 405, "Only GET and POST are answered."
        # A link to the page itself may come from anywhere; what it loads may not.
        if path != "/" and headers.get("sec-fetch-site", "same-origin") == "cross-site":
            return 403, "Another web site asked for this."
        data = path.startswith("/api/")
        writes = method == "POST"
        if (writes or (data and self._access.token_for_reading)) and not self._access.has_token(
            headers
        ):
            return 401, "The token is missing or old; open the link that the server printed."
        if not writes:
            return None
        if not self._access.is_origin(headers.get("origin", "")):
            return 403, "Another web site asked for this."
        if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            return 415, "Only JSON is taken."
        size = headers.get("content-length", "")
        if not size.isascii() or not size.isdigit() or int(size) > MAX_BODY_BYTES:
            return 413, f"Send at most {MAX_BODY_BYTES} bytes, and say how many."
        return None
