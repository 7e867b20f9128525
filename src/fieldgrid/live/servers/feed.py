"""The window around the vehicle, sent to controllers over TCP in a layout of fixed places.

`docs/live.md` has the layout as a table, and a reader of it. A client that does not read loses
older windows, and is dropped when it takes nothing of one for long; nobody waits for it.
"""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import Callable
from urllib.parse import urlsplit

import numpy as np

from fieldgrid.core import ConfigError, Float32, quoted
from fieldgrid.live.results import LiveWindow
from fieldgrid.live.servers.loop_server import LoopServer

MAGIC, VERSION = b"FGWN", 1
HEADER = struct.Struct("<4sHHIIq3d3d2I6d2I")
"""Magic, version, bytes of the header, bytes of the cells, number; time; datum; cell size, west,
south; width, height; east, north, heading, their sigmas, speed; doubt, frames."""

MOST = 65534
AGE_UNIT_S, SIGMA_UNIT_M = 0.01, 0.001

MOST_CLIENTS = 16
STUCK_S = 5.0
"""Time after which a client is dropped that takes nothing of a window."""


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


def encode_window(window: LiveWindow, number: int) -> bytes:
    """A window as it is sent; `number` counts the windows of a session."""
    costs, pose, datum = window.costmap.costs, window.pose, window.costmap.datum
    west_m, south_m = window.costmap.bounds[:2]
    height, width = costs.shape
    where = (math.nan,) * 6
    if pose is not None:
        sigmas = pose.position_sigma_m, pose.heading_sigma_deg
        where = (pose.east_m, pose.north_m, pose.heading_deg, *sigmas, pose.speed_mps)
    head = HEADER.pack(
        *(MAGIC, VERSION, HEADER.size, 5 * width * height, number & 0xFFFFFFFF, window.time_ns),
        *(datum.lat_deg, datum.lon_deg, datum.height_m),
        *(window.costmap.lattice.cell_m, west_m, south_m, width, height),
        *(*where, int(window.doubt_code), window.frames),
    )
    cells = costs.tobytes()
    ages = whole_units(window.age_s, AGE_UNIT_S, MOST).astype("<u2")
    sigmas_m = whole_units(window.sigma_m, SIGMA_UNIT_M, MOST).astype("<u2")
    return b"".join((head, cells, ages.tobytes(), sigmas_m.tobytes()))


def whole_units(values: Float32, unit: float, most: int) -> Float32:
    """Whole units, up to `most`, rounded up: no cell is younger or surer than it is said to be.
    `most` + 1 where a value is not known."""
    scaled = values * np.float32(1.0 / unit)
    np.ceil(scaled, out=scaled)
    np.clip(scaled, 0.0, most, out=scaled)
    scaled[np.isnan(values)] = most + 1
    return scaled


class _FeedClient(asyncio.Protocol):
    """A client: a window is on its way to it, and the newest one waits behind that."""

    transport: asyncio.Transport

    def __init__(self, feed: Feed) -> None:
        self._feed, self._waiting = feed, b""
        self._watching: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        transport.set_write_buffer_limits(0)
        self._feed.joined(self)

    def connection_lost(self, error: Exception | None) -> None:
        self.resume_writing()
        self._feed.left(self)

    def offer(self, data: bytes) -> None:
        """Send a window next, in the place of one that still waits."""
        if self._watching is None:
            self.transport.write(data)
        else:
            self._waiting = data

    def pause_writing(self) -> None:
        """Not all of a window is taken yet."""
        left = self.transport.get_write_buffer_size()
        loop = asyncio.get_running_loop()
        self._watching = loop.call_later(STUCK_S, self._watch, left)

    def resume_writing(self) -> None:
        """All is taken."""
        if self._watching is not None:
            self._watching.cancel()
        self._watching, waiting, self._waiting = None, self._waiting, b""
        if waiting and not self.transport.is_closing():
            self.transport.write(waiting)

    def _watch(self, left: int) -> None:
        """Leave it where it took nothing since so many bytes were left."""
        if self.transport.get_write_buffer_size() < left:
            self.pause_writing()
        else:
            self._feed.tell("A client of the feed does not read; it was dropped.")
            self.transport.abort()


class Feed(LoopServer):
    """Serves windows to any number of clients, up to 16, in a thread of its own.

    Whoever reaches the port gets them: `host` is that of this machine unless the network is to see
    them. `port` 0 takes any free one, which `address` tells. ConfigError where it cannot be had.
    """

    def __init__(self, host: str, port: int, tell: Callable[[str], None] | None = None) -> None:
        super().__init__(host, port, "fieldgrid-feed")
        self.tell = tell or (lambda _: None)
        self._newest: LiveWindow | None = None
        self._number = 0
        self._encoded = b""
        self._clients = set[_FeedClient]()
        self._thread.start()

    def put(self, window: LiveWindow) -> None:
        """Send a window to all who listen; it never blocks."""
        self._call(self._take, window)

    async def _serve(self) -> None:
        served = await self._loop.create_server(lambda: _FeedClient(self), sock=self._listening)
        await self._closing.wait()
        served.close()
        for client in self._clients:
            client.transport.abort()
        await asyncio.sleep(0)  # in which they are closed

    def _take(self, window: LiveWindow) -> None:
        self._newest = window
        self._number += 1
        self._loop.call_soon(self._send)  # behind newer ones that are there already

    def _send(self) -> None:
        """Send the newest window, unless that is done; one that nobody takes is not encoded."""
        if self._clients and self._newest is not None:
            self._encoded, self._newest = encode_window(self._newest, self._number), None
            for client in self._clients:
                client.offer(self._encoded)

    def joined(self, client: _FeedClient) -> None:
        """A client is there."""
        if len(self._clients) >= MOST_CLIENTS:
            self.tell(f"The feed has {MOST_CLIENTS} clients already; one more was refused.")
            client.transport.abort()
            return
        self._clients.add(client)
        if self._newest is None and self._encoded:
            client.offer(self._encoded)
        self._send()

    def left(self, client: _FeedClient) -> None:
        """A client has gone."""
        self._clients.discard(client)
