"""The window around the vehicle, sent to one address in datagrams.

`docs/live.md` has their layout, and a reader. Nobody answers a datagram: what is lost is lost, and
a window of which a part is lost is not whole.
"""

from __future__ import annotations

import secrets
import socket
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator

from fieldgrid.closing import Closing
from fieldgrid.errors import ConfigError
from fieldgrid.live.feed import encode_window
from fieldgrid.live.results import LiveWindow

MAGIC, VERSION = b"FGWU", 1
HEADER = struct.Struct("<4sHHIIII")
"""Magic, version, bytes of the header; session, number of the window, its bytes, offset in it.
A CRC-32 of these and of the part follows."""

CRC = struct.Struct("<I")
MOST_PART = 1200
"""Bytes of a window in a datagram: with its headers it fits any network that speaks IPv6."""

BURST, PAUSE_S = 32, 0.001
"""After so many datagrams it waits for so long: receivers hold some hundred of them."""


def cut(message: bytes, session: int, number: int) -> Iterator[bytes]:
    """The datagrams of an encoded window."""
    head_bytes = HEADER.size + CRC.size
    for offset in range(0, len(message), MOST_PART):
        part = message[offset : offset + MOST_PART]
        head = HEADER.pack(
            *(MAGIC, VERSION, head_bytes, session, number & 0xFFFFFFFF, len(message), offset)
        )
        yield head + CRC.pack(zlib.crc32(part, zlib.crc32(head))) + part


class DatagramFeed(Closing):
    """Sends windows to an address, in a thread of its own; one that comes while another is being
    sent waits, and gives way to a newer one. ConfigError for an address that cannot be."""

    def __init__(self, host: str, port: int, tell: Callable[[str], None] | None = None) -> None:
        self._tell = tell or (lambda _: None)
        try:
            self._socket = _connected(host, port)
        except OSError as error:
            raise ConfigError(
                f"The feed cannot send to udp://{host}:{port} ({error.strerror}); give a host "
                "that this machine reaches."
            ) from error
        self.address: tuple[str, int] = self._socket.getpeername()[:2]
        self._session = secrets.randbits(32)
        self._changed = threading.Condition()
        self._newest: LiveWindow | None = None
        self._number = 0
        self._is_closed = self._has_failed = False
        self._thread = threading.Thread(target=self._run, name="fieldgrid-feed", daemon=True)
        self._thread.start()

    def put(self, window: LiveWindow) -> None:
        """Send a window; it never blocks."""
        with self._changed:
            self._newest = window
            self._number += 1
            self._changed.notify()

    def close(self) -> None:
        """Send no more, not even the rest of a window."""
        with self._changed:
            if self._is_closed:
                return
            self._is_closed = True
            self._changed.notify()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._is_closed)
                window, number, self._newest = self._newest, self._number, None
            if self._is_closed or window is None:
                return
            self._send(encode_window(window, number), number)

    def _send(self, message: bytes, number: int) -> None:
        for k, datagram in enumerate(cut(message, self._session, number), start=1):
            if self._is_closed:
                return
            try:
                self._socket.send(datagram)
                self._has_failed = False
            except ConnectionRefusedError:
                continue  # nobody listens there now
            except OSError as error:
                if not self._has_failed:
                    host, port = self.address
                    self._tell(f"Nothing can be sent to udp://{host}:{port}: {error.strerror}.")
                self._has_failed = True
                return  # the next window is tried again
            if k % BURST == 0:
                time.sleep(PAUSE_S)


def _connected(host: str, port: int) -> socket.socket:
    """A socket that sends to an address; OSError where it cannot."""
    family, kind, proto, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    made = socket.socket(family, kind, proto)
    try:
        made.connect(address)
    except OSError:
        made.close()
        raise
    return made
