"""The window around the vehicle, sent to controllers over TCP in a layout of fixed places.

`docs/live.md` has the layout as a table, and a reader of it. A client that does not read loses
older windows, and is dropped when it takes nothing of one for long; nobody waits for it.
"""

from __future__ import annotations

import asyncio
import math
import struct
from asyncio import StreamReader, StreamWriter
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np

from fieldgrid.core import Float32
from fieldgrid.live.results import LiveWindow
from fieldgrid.live.servers.loop_server import LiveClient, LiveMessage, LoopServer

MAGIC, VERSION = b"FGWN", 1
HEADER = struct.Struct("<4sHHIIq3d3d2I6d2I")
"""Magic, version, bytes of the header, bytes of the cells, number; time; datum; cell size, west,
south; width, height; east, north, heading, their sigmas, speed; doubt, frames."""

MOST = 65534
AGE_UNIT_S, SIGMA_UNIT_M = 0.01, 0.001

MOST_CLIENTS = 16
_READ_BYTES = 1 << 16
STUCK_S = 5.0
"""Time after which a client is dropped that takes nothing of a window."""


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


class Feed(LoopServer):
    """Serves windows to any number of clients, up to 16, in a thread of its own.

    Whoever reaches the port gets them: `host` is that of this machine unless the network is to see
    them. `port` 0 takes any free one, which `address` tells. ConfigError where it cannot be had.
    """

    def __init__(self, host: str, port: int, tell: Callable[[str], None] | None = None) -> None:
        super().__init__(host, port, "fieldgrid-feed", tell)
        self._number = 0
        self._thread.start()

    def put(self, window: LiveWindow) -> None:
        """Send a window to all who listen; it never blocks, and one that nobody takes is not
        encoded."""
        self._number += 1
        message = LiveMessage(window.time_ns, partial(encode_window, window, self._number))
        self._call(self._offer, 0, message)

    async def _serve(self) -> None:
        served = await asyncio.start_server(self._connected, sock=self._listening)
        await self._closing.wait()
        served.close()

    async def _connected(self, reader: StreamReader, writer: StreamWriter) -> None:
        if self._is_full("The feed", MOST_CLIENTS):
            writer.transport.abort()
            return
        client = LiveClient()
        writer.transport.set_write_buffer_limits(0)
        try:
            # A task that is cancelled at the end would be told as an error by asyncio.
            with (
                self._serving(client, partial(self._send, writer)),
                suppress(OSError, asyncio.CancelledError),
            ):
                if self._latest:
                    client.offer(0, self._latest[0])
                while await reader.read(_READ_BYTES):  # what it says counts for nothing
                    pass
        finally:
            writer.transport.abort()

    async def _send(self, writer: StreamWriter, _: int, message: LiveMessage, data: bytes) -> None:
        """Send a window; leave the client where it takes nothing of it for a while."""
        writer.write(data)
        left, before = writer.transport.get_write_buffer_size(), math.inf
        while 0 < left < before:
            with suppress(OSError):
                await asyncio.wait_for(writer.drain(), STUCK_S)
            left, before = writer.transport.get_write_buffer_size(), left
        if left:
            self._tell("A client of the feed does not read; it was dropped.")
            writer.transport.abort()
