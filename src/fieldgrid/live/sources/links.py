"""Where the bytes of a receiver come from: TCP, UDP, gpsd, a serial port, a pipe.

A link is opened by `open_link` and gives bytes as they come. What it says is the receiver's; when
they came is known to nobody behind it, so no time of arrival can be taken for GNSS time.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from fieldgrid.core import ConfigError, parse_json, quoted
from fieldgrid.live.intake import SourceEndedError

CONNECT_S = 5.0
GPSD_PORT = 2947
CHUNK_BYTES = 1 << 16
_GPSD_GREETING_BYTES = 4096
_WATCH = b'?WATCH={"enable":true,"json":false,"nmea":true,"raw":2};\n'
"""What the receiver writes as it is, and gpsd's own NMEA of what is binary."""
_FORMS = (
    "tcp://HOST:PORT, udp://[HOST]:PORT, gpsd://HOST[:PORT], serial:/dev/ttyUSB0?baud=115200, the "
    "path of a FIFO, or - for standard input"
)


class Address(NamedTuple):
    """Where a receiver is: what it was written as, the kind of link, and the parts of it."""

    text: str
    kind: str
    host: str = ""
    port: int = 0
    path: str = ""
    baud: int = 0

    @property
    def is_reopened(self) -> bool:
        """Whether a link that is silent may be dead, and is opened again then."""
        return self.kind in ("tcp", "gpsd", "serial")


def parse_address(text: str) -> Address:
    """The address of a receiver; ConfigError for what is none."""
    wrong = ConfigError(f"{quoted(text)} is no source of a receiver; give {_FORMS}.")
    if text == "-":
        return Address(text, "stdin")
    if text.startswith("serial:"):
        device, _, options = text.removeprefix("serial:").partition("?")
        given = parse_qs(options, keep_blank_values=True)
        baud = given.pop("baud", ["9600"])[0]
        if not device or given or not (baud.isdecimal() and 50 <= int(baud) <= 4_000_000):
            raise ConfigError(
                f"{quoted(text)} is no serial port; give serial:/dev/ttyUSB0?baud=115200."
            )
        return Address(text, "serial", path=device, baud=int(baud))
    if "://" not in text:
        return _fifo(text)
    try:
        parts = urlsplit(text)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        raise wrong from None
    kind = parts.scheme
    if kind == "gpsd":
        host, port = host or "127.0.0.1", port or GPSD_PORT
    is_whole = port and (host or kind == "udp") and not (parts.path.strip("/") or parts.query)
    if kind not in ("tcp", "udp", "gpsd") or not is_whole or parts.username is not None:
        raise wrong
    return Address(text, kind, host, port or 0)


def _fifo(text: str) -> Address:
    try:
        mode = Path(text).stat().st_mode
    except (OSError, ValueError):
        raise ConfigError(f"{text} does not exist; give {_FORMS}.") from None
    if stat.S_ISCHR(mode):
        raise ConfigError(f"{text} is a device; give serial:{text}?baud=115200.")
    if not stat.S_ISFIFO(mode):
        raise ConfigError(
            f"{text} is a file and no FIFO; replay a recording with --replay, or give {_FORMS}."
        )
    return Address(text, "fifo", path=text)


def check_link(address: Address) -> None:
    """Raise ConfigError for a link that this machine can never open."""
    if address.kind == "serial":
        _serial()


def open_link(address: Address) -> Link:
    """Open a link; OSError where there is none now."""
    openers: dict[str, Callable[[Address], Link]] = {
        "tcp": _open_tcp,
        "udp": _open_udp,
        "gpsd": _open_gpsd,
        "serial": _open_serial,
        "fifo": _open_fifo,
        "stdin": lambda _: Link(sys.stdin.fileno(), lambda: None, _ENDED),
    }
    return openers[address.kind](address)


_ENDED = SourceEndedError("has come to its end.")
_CLOSED = ConnectionError("the other end has closed it")


class Link:
    """A stream, datagrams, a port or a pipe that is open, by its number; `close` closes it. Where
    nothing more is to come, `end` is raised; datagrams have no end."""

    def __init__(
        self,
        number: int,
        close: Callable[[], None],
        end: Exception | None,
        first: bytes = b"",
    ) -> None:
        self._number, self._end, self._first = number, end, first
        self.close = close

    def read(self, timeout_s: float) -> bytes:
        """What has come, nothing where nothing came in time. OSError where the link is lost,
        SourceEndedError at its end."""
        first, self._first = self._first, b""
        if first or not select.select([self._number], [], [], timeout_s)[0]:
            return first
        data = os.read(self._number, CHUNK_BYTES)
        if not data and self._end is not None:
            raise self._end
        return data


def _connected(address: Address) -> socket.socket:
    """A stream to an address; ConnectionRefusedError where nobody listens.

    A port of this machine that nobody listens at is now and then the one that a new socket is given
    for its own end. Such a socket is connected with itself, and would keep the port from the
    program that is waited for.
    """
    connected = socket.create_connection((address.host, address.port), CONNECT_S)
    if connected.getsockname() == connected.getpeername():
        connected.close()
        raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
    return connected


def _open_tcp(address: Address) -> Link:
    connected = _connected(address)
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    return Link(connected.fileno(), connected.close, _CLOSED)


def _open_udp(address: Address) -> Link:
    hosts = socket.getaddrinfo(
        address.host or None, address.port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
    )
    family, kind, protocol, _, place = hosts[0]
    listening = socket.socket(family, kind, protocol)
    try:
        listening.bind(place)
    except OSError:
        listening.close()
        raise
    return Link(listening.fileno(), listening.close, None)


def _open_gpsd(address: Address) -> Link:
    """gpsd greets with a line of JSON, and sends what it is asked to watch."""
    connected = _connected(address)
    try:
        greeting = b""
        while b"\n" not in greeting:
            data = connected.recv(CHUNK_BYTES)
            if not data or len(greeting) > _GPSD_GREETING_BYTES:
                break
            greeting += data
        line, _, rest = greeting.partition(b"\n")
        said: object = None
        with suppress(ValueError):
            said = parse_json(line)
        if not isinstance(said, dict) or said.get("class") != "VERSION":
            raise ConnectionError(
                "no gpsd answers there, which would give its version; it says "
                f"{quoted(line.decode('latin-1').strip())}"
            )
        connected.sendall(_WATCH)
    except BaseException:
        connected.close()
        raise
    return Link(connected.fileno(), connected.close, _CLOSED, rest)


def _open_fifo(address: Address) -> Link:
    # Opened for writing too, it has no end when a writer goes, and another may come.
    number = os.open(address.path, os.O_RDWR | os.O_NONBLOCK)
    return Link(number, lambda: os.close(number), _ENDED)


def _serial() -> Any:
    try:
        import serial
    except ImportError as error:
        raise ConfigError(
            "A serial port needs pyserial, which is not installed; "
            "run: pip install 'fieldgrid[serial]'"
        ) from error
    return serial


def _open_serial(address: Address) -> Link:
    # Its own errors are OSErrors.
    port = _serial().Serial(address.path, address.baud, exclusive=True)
    return Link(port.fileno(), port.close, _CLOSED)
