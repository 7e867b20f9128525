"""The window around the vehicle, sent to controllers over TCP in a layout of fixed places.

`docs/live.md` has the layout as a table, and a reader of it. A client that does not read loses
older windows, and is dropped when it takes nothing of one for long; nobody waits for it.
"""

from __future__ import annotations

import contextlib
import math
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from urllib.parse import urlsplit

import numpy as np

from fieldgrid.core import Closing, ConfigError, Float32, quoted
from fieldgrid.live.results import LiveWindow
from fieldgrid.view import listen

MAGIC, VERSION = b"FGWN", 1
HEADER = struct.Struct("<4sHHIIq3d3d2I6d2I")
"""Magic, version, bytes of the header, bytes of the cells, number; time; datum; cell size, west,
south; width, height; east, north, heading, their sigmas, speed; doubt, frames."""

MOST = 65534
AGE_UNIT_S, SIGMA_UNIT_M = 0.01, 0.001

MOST_CLIENTS = 16
STUCK_S = 5.0
"""Time after which a client is dropped that takes nothing of a window."""

_ASKED_BYTES = 4096


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


class _FeedClient:
    """A client: what is being sent to it, and the window that waits behind that."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.sending = memoryview(b"")
        self.waiting = b""
        self.moved_s = time.monotonic()
        self.is_gone = False

    def offer(self, data: bytes) -> None:
        """Send a window next, in the place of one that still waits."""
        if not self.sending:
            self.sending, self.moved_s = memoryview(data), time.monotonic()
        else:
            self.waiting = data

    def send(self) -> None:
        """Send what the client takes now; OSError where it is gone."""
        with contextlib.suppress(BlockingIOError):
            while self.sending:
                self.sending = self.sending[self.connection.send(self.sending) :]
                self.moved_s = time.monotonic()
                if not self.sending and self.waiting:
                    self.sending, self.waiting = memoryview(self.waiting), b""


class Feed(Closing):
    """Serves windows to any number of clients, up to 16, in a thread of its own.

    Whoever reaches the port gets them: `host` is that of this machine unless the network is to see
    them. `port` 0 takes any free one, which `address` tells. ConfigError where it cannot be had.
    """

    def __init__(self, host: str, port: int, tell: Callable[[str], None] | None = None) -> None:
        self._tell = tell or (lambda _: None)
        self._listening = listen(host, port)
        self.address: tuple[str, int] = self._listening.getsockname()[:2]
        self._waker, self._woken = socket.socketpair()
        self._waker.setblocking(False)
        self._lock = threading.Lock()
        self._newest: LiveWindow | None = None
        self._is_new = self._is_closed = False
        self._number = 0
        self._encoded = b""
        self._clients: list[_FeedClient] = []
        self._thread = threading.Thread(target=self._run, name="fieldgrid-feed", daemon=True)
        self._thread.start()

    def put(self, window: LiveWindow) -> None:
        """Send a window to all who listen; it never blocks."""
        with self._lock:
            self._newest, self._is_new = window, True
            self._number += 1
        self._wake()

    def close(self) -> None:
        """Leave all clients."""
        if not self._is_closed:
            self._is_closed = True
            self._wake()
            self._thread.join()

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # full, and it wakes anyway; or closed
            self._waker.send(b"\0")

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._listening, selectors.EVENT_READ)
            selector.register(self._woken, selectors.EVENT_READ)
            while not self._is_closed:
                for key, events in selector.select(STUCK_S / 2.0):
                    if key.fileobj is self._listening:
                        self._accept(selector)
                    elif key.fileobj is self._woken:
                        self._woken.recv(_ASKED_BYTES)
                        # A window that nobody takes is not encoded.
                        if self._clients and self._encode():
                            for client in self._clients:
                                client.offer(self._encoded)
                    else:
                        self._serve(key.data, events)
                self._settle(selector)
            for client in self._clients:
                client.connection.close()
        for one in (self._listening, self._waker, self._woken):
            one.close()

    def _accept(self, selector: selectors.BaseSelector) -> None:
        try:
            connection, _ = self._listening.accept()
        except OSError:
            return  # it has gone again
        if len(self._clients) >= MOST_CLIENTS:
            self._tell(f"The feed has {MOST_CLIENTS} clients already; one more was refused.")
            connection.close()
            return
        connection.setblocking(False)
        client = _FeedClient(connection)
        selector.register(connection, selectors.EVENT_READ, client)
        self._clients.append(client)
        others = self._clients if self._encode() else [client]
        for one in others if self._encoded else ():
            one.offer(self._encoded)

    def _encode(self) -> bool:
        """Encode the newest window, unless that is done; whether it was not."""
        with self._lock:
            newest, number, is_new = self._newest, self._number, self._is_new
            self._is_new = False
        if is_new and newest is not None:
            self._encoded = encode_window(newest, number)
        return is_new

    def _serve(self, client: _FeedClient, events: int) -> None:
        """Hear that a client has gone; what it sends is not read as anything."""
        if events & selectors.EVENT_READ:
            try:
                client.is_gone = not client.connection.recv(_ASKED_BYTES)
            except BlockingIOError:
                pass
            except OSError:
                client.is_gone = True

    def _settle(self, selector: selectors.BaseSelector) -> None:
        """Send what can be sent, and drop who is gone or takes nothing."""
        for client in tuple(self._clients):
            try:
                client.send()
            except OSError:
                client.is_gone = True
            is_stuck = bool(client.sending) and time.monotonic() - client.moved_s > STUCK_S
            if client.is_gone or is_stuck:
                if is_stuck:
                    self._tell("A client of the feed does not read; it was dropped.")
                selector.unregister(client.connection)
                client.connection.close()
                self._clients.remove(client)
                continue
            wanted = selectors.EVENT_READ
            if client.sending:
                wanted |= selectors.EVENT_WRITE
            selector.modify(client.connection, wanted, client)
