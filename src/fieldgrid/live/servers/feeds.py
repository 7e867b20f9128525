"""Where the window around the vehicle is sent, by an address."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import urlsplit

from fieldgrid.core import ConfigError, quoted
from fieldgrid.live.servers.feed import Feed


def parse_feed(text: str) -> tuple[str, int]:
    """Host and port of `tcp://HOST:PORT`; ConfigError for other addresses."""
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port, parts = None, None, urlsplit("")
    if parts.scheme != "tcp" or not host or port is None or parts.path.strip("/") or parts.query:
        raise ConfigError(
            f"{quoted(text)} is no feed; give a TCP address, such as tcp://127.0.0.1:PORT."
        )
    return host, port


def open_feed(text: str, tell: Callable[[str], None] | None = None) -> Feed:
    """The feed of an address; ConfigError where there can be none."""
    return Feed(*parse_feed(text), tell)
