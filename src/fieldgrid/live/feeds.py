"""Where the window around the vehicle is sent, by an address."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple
from urllib.parse import urlsplit

from fieldgrid.errors import ConfigError
from fieldgrid.live.datagrams import DatagramFeed
from fieldgrid.live.feed import Feed


class FeedAddress(NamedTuple):
    """Where a feed is (tcp), or what it sends to (udp)."""

    kind: Literal["tcp", "udp"]
    host: str
    port: int


def parse_feed(text: str) -> FeedAddress:
    """The address of `tcp://HOST:PORT` or `udp://HOST:PORT`; ConfigError for others."""
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port, parts = None, None, urlsplit("")
    kind: Literal["tcp", "udp"] = "udp" if parts.scheme == "udp" else "tcp"
    is_wrong = parts.scheme != kind or not host or port is None or (kind == "udp" and port == 0)
    if is_wrong or not host or port is None or parts.path.strip("/") or parts.query:
        raise ConfigError(
            f"{text!r} is no feed; give tcp://127.0.0.1:PORT, or udp://HOST:PORT to send to."
        )
    return FeedAddress(kind, host, port)


def open_feed(text: str, tell: Callable[[str], None] | None = None) -> Feed | DatagramFeed:
    """The feed of an address; ConfigError where there can be none."""
    kind, host, port = parse_feed(text)
    return (Feed if kind == "tcp" else DatagramFeed)(host, port, tell)
