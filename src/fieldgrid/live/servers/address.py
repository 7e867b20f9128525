"""The address of a live server."""

from __future__ import annotations

from urllib.parse import urlsplit

from fieldgrid.core import ConfigError, quoted
from fieldgrid.view import LOOPBACK


def parse_server_address(text: str, option: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, or of `PORT` on this machine alone; ConfigError, which names
    the option, for others."""
    try:
        parts = urlsplit(f"//{LOOPBACK}:{text}" if text.isdecimal() else f"//{text}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
        parts = urlsplit("")
    if not host or port is None or "@" in text or parts.path or parts.query or parts.fragment:
        raise ConfigError(
            f"{quoted(text)} is no address; give {option} PORT or {option} HOST:PORT."
        )
    return host, port
