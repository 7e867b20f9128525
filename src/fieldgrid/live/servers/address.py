"""The addresses of live servers."""

from __future__ import annotations

from urllib.parse import urlsplit

from fieldgrid.core import ConfigError, quoted
from fieldgrid.view import LOOPBACK


def parse_server_address(text: str, option: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, or of `PORT` on this machine alone; ConfigError, which names
    the option, for others."""
    found = _place(f"{LOOPBACK}:{text}" if text.isdecimal() else text)
    if found is None:
        raise ConfigError(
            f"{quoted(text)} is no address; give {option} PORT or {option} HOST:PORT."
        )
    return found


def parse_feed(text: str) -> tuple[str, int]:
    """Host and port of `tcp://HOST:PORT`; ConfigError for other addresses."""
    found = _place(text.removeprefix("tcp://")) if text.startswith("tcp://") else None
    if found is None:
        raise ConfigError(
            f"{quoted(text)} is no feed; give a TCP address, such as tcp://127.0.0.1:PORT."
        )
    return found


def _place(text: str) -> tuple[str, int] | None:
    """Host and port of `HOST:PORT`; None for others."""
    try:
        parts = urlsplit(f"//{text}")
        host, port = parts.hostname, parts.port
    except ValueError:
        return None
    if not host or port is None or "@" in text:
        return None
    return None if parts.path.strip("/") or parts.query or parts.fragment else (host, port)
