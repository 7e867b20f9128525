"""Receivers on real sockets, pipes and a terminal that stands for a serial port."""

from __future__ import annotations

import builtins
import os
import socket
import struct
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Fix
from fieldgrid.live import Pauses, Receiver, ReceiverStream, parse_address
from fieldgrid.live.sources.links import open_link
from tests.conftest import TWO_LANES
from tests.live.sources import QUICK, TIMEOUT_S, listening, running
from tests.poses.gnss.sentences import parse_nmea, parse_ubx

LOG = (TWO_LANES / "gnss" / "gnss_rtk.nmea").read_bytes()[:20_000]
LOG = LOG[: LOG.rindex(b"$GPGGA")]
FIXES = parse_nmea([LOG]).fixes
HALF = LOG.index(b"$GPGGA", len(LOG) // 2)


def ubx(kind: int, payload: bytes) -> bytes:
    """A message of class NAV."""
    body = bytes((1, kind)) + len(payload).to_bytes(2, "little") + payload
    first = second = 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return b"\xb5\x62" + body + bytes((first, second))


def pvt(second: int) -> bytes:
    """A position of RTK quality at a second of a minute."""
    itow = 1000 * second
    payload = bytearray(92)
    struct.pack_into("<IHBBBBBB", payload, 0, itow, 2025, 6, 15, 10, 30, second, 7)
    payload[20:24] = bytes((3, 0x83, 0, 14))
    struct.pack_into("<iii", payload, 24, -47200000, 416500000, 787_400)
    return ubx(0x07, bytes(payload)) + ubx(0x61, struct.pack("<I", itow))


def test_tcp_gives_the_fixes_of_the_log_over_a_loss_of_the_link() -> None:
    with listening() as (server, place), running(Receiver(f"tcp://{place}")) as notes:
        link, _ = server.accept()
        with link:
            link.sendall(LOG[: HALF + 30])  # cut within a sentence
        notes.wait_told("is not there (the other end has closed it)")
        link, _ = server.accept()
        with link:
            link.sendall(LOG[HALF:])
            notes.wait_told("is there again.")
        notes.wait_told("is not there", 2)
    assert notes.fixes == FIXES
    assert all(text.startswith(f"The receiver at tcp://{place} ") for text in notes.told)


def test_a_receiver_that_is_not_there_yet_is_tried_until_it_is() -> None:
    # Bound, so that no other program is given the port, and not listened at yet.
    with socket.socket() as server:
        server.settimeout(TIMEOUT_S)
        server.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{server.getsockname()[1]}"
        with running(Receiver(f"tcp://{place}")) as notes:
            notes.wait_told("is not there (Connection refused); it is tried again and again.")
            server.listen()
            link, _ = server.accept()
            with link:
                link.sendall(LOG)
                notes.wait_told("is there again")
                # Each loss is told once, however often it is tried; the end of the link, too.
                assert len(notes.told) == 2


@pytest.mark.parametrize("kind", ["tcp", "gpsd"])
def test_a_socket_that_meets_itself_is_no_receiver(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as itself:
        itself.bind(("127.0.0.1", 0))
        itself.connect(itself.getsockname())
        monkeypatch.setattr(socket, "create_connection", lambda *_: itself)
        with pytest.raises(ConnectionRefusedError, match="Connection refused"):
            open_link(parse_address(f"{kind}://127.0.0.1:2"))
        assert itself.fileno() == -1  # the port is free again


def test_a_silent_receiver_is_told_and_a_dead_link_opened_again() -> None:
    pauses = Pauses(0.01, 0.02, silent_s=0.02, dead_s=2.0, no_fix_s=60.0)
    with listening() as (server, place), running(Receiver(f"tcp://{place}"), pauses) as notes:
        first, _ = server.accept()
        with first:
            notes.wait_told("has sent nothing for 0 s; the mapping goes on.")
            first.sendall(LOG[:HALF])
            notes.wait_told("sends again")
            second, _ = server.accept()  # while the first is open
            with second:
                second.sendall(LOG[HALF:])
                notes.wait_told("is there again")
    assert notes.fixes == FIXES


def test_a_log_that_cannot_be_written_is_told_and_ends_nothing(tmp_path: Path) -> None:
    folder, log = tmp_path / "gnss", tmp_path / "gnss" / "log.nmea"
    with pytest.raises(ConfigError, match=r"log\.nmea cannot be written: No such file"):
        Receiver("-", log)
    folder.mkdir()
    with listening() as (server, place), running(Receiver(f"tcp://{place}", log)) as notes:
        link, _ = server.accept()
        with link:
            log.unlink()
            folder.rmdir()
            link.sendall(LOG[:HALF])
            notes.wait_told(f"is not logged: {log} cannot be written (No such file or directory).")
            folder.mkdir()
            link.sendall(LOG[HALF:])
            notes.wait_told(f"is logged in {log} again.")
        notes.wait_told("is not there")
    assert notes.fixes == FIXES
    assert LOG.endswith(log.read_bytes())


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (b"\x81\xfe\x07" * 50, "no message of UBX is whole; check the baud rate"),
        (b"$GPGSA,A,1,,,,,,,,,,,,,,,*1E\r\n" * 3, "let the receiver write GGA and RMC, or NAV-PVT"),
        (
            b"".join(line for line in LOG.splitlines(True) if line.startswith(b"$GPGGA")),
            "the date is missing; let the receiver write RMC or ZDA",
        ),
    ],
)
def test_bytes_without_a_fix_are_told_with_the_reason(sent: bytes, why: str) -> None:
    pauses = QUICK._replace(no_fix_s=0.0)
    with listening() as (server, place), running(Receiver(f"tcp://{place}"), pauses) as notes:
        link, _ = server.accept()
        with link:
            link.sendall(sent)
            notes.wait_told("sends, but no fix for 0 s: ")
    assert why in notes.told[0]
    assert notes.fixes == []


def is_bound(place: tuple[str, int]) -> bool:
    """Whether somebody hears datagrams there."""
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(place)
        except OSError:
            return True
    return False


def test_udp_takes_datagrams_of_whoever_sends() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        host, port = sender.getsockname()
    with (
        running(Receiver(f"udp://:{port}")) as notes,
        socket.socket(type=socket.SOCK_DGRAM) as sender,
    ):
        while not is_bound((host, port)):
            pass
        for start in range(0, len(LOG), 500):
            sender.sendto(LOG[start : start + 500], (host, port))
        notes.wait(lambda: len(notes.fixes) == len(FIXES) - 1)
    assert notes.fixes == FIXES


def test_gpsd_is_asked_for_what_the_receiver_writes() -> None:
    with listening() as (server, place), running(Receiver(f"gpsd://{place}")) as notes:
        link, _ = server.accept()
        with link:
            link.settimeout(TIMEOUT_S)
            link.sendall(b'{"class":"VERSION","release":"3.25","proto_major":3}\n')
            asked = link.makefile("rb").readline()
            assert asked == b'?WATCH={"enable":true,"json":false,"nmea":true,"raw":2};\n'
            link.sendall(b'{"class":"DEVICES","devices":[]}\r\n{"class":"WATCH"}\r\n' + LOG)
        notes.wait_told("is not there")
        other, _ = server.accept()
        with other:
            other.sendall(b"HTTP/1.0 400 Bad Request\n")
        notes.wait_told("no gpsd answers there, which would give its version; it says 'HTTP")
    assert notes.fixes == FIXES


def test_a_fifo_outlives_its_writers(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "gnss")
    with running(Receiver(str(tmp_path / "gnss"))) as notes:
        with (tmp_path / "gnss").open("wb") as writer:
            writer.write(LOG[:HALF])
        with (tmp_path / "gnss").open("wb") as writer:
            writer.write(LOG[HALF:])
        notes.wait(lambda: len(notes.fixes) == len(FIXES) - 1)
    assert notes.fixes == FIXES
    assert notes.told == []


def test_a_serial_port_that_is_pulled_out(tmp_path: Path) -> None:
    pytest.importorskip("serial")
    ours, theirs = os.openpty()
    port = tmp_path / "ttyUSB0"
    port.symlink_to(os.ttyname(theirs))
    with running(Receiver(f"serial:{port}?baud=115200")) as notes:
        # What was written before the port is open would be thrown away with its settings.
        while not notes.fixes:
            os.write(ours, LOG[:2000])
        os.close(theirs)
        port.unlink()
        os.close(ours)
        notes.wait_told("is not there")
        ours, theirs = os.openpty()
        port.symlink_to(os.ttyname(theirs))
        while not any("is there again" in text for text in notes.told):
            os.write(ours, b"\r\n")
    os.close(ours)
    os.close(theirs)
    assert notes.fixes[0] in FIXES  # the port may have been opened in the middle of a sentence


def test_a_serial_port_without_pyserial(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any) -> Any:
        if name == "serial":
            raise ImportError(name)
        return real(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"pip install 'fieldgrid\[serial\]'"):
        Receiver("serial:/dev/ttyUSB0?baud=115200")


@pytest.mark.parametrize(
    "wrong",
    [
        *("tcp://host", "tcp://:80", "tcp://host:99999", "tcp://host:80/path", "http://host:80"),
        *("udp://", "tcp://user@host:80", "serial:", "serial:/dev/x?baud=fast", "gpsd://[::1"),
        *("serial:/dev/x?parity=even", "nowhere.fifo", "/dev/null", __file__),
    ],
)
def test_what_is_no_address(wrong: str) -> None:
    with pytest.raises(ConfigError, match="give "):
        parse_address(wrong)


def test_addresses() -> None:
    assert parse_address("gpsd://robot")[1:4] == ("gpsd", "robot", 2947)
    assert parse_address("gpsd://")[1:4] == ("gpsd", "127.0.0.1", 2947)
    assert parse_address("udp://:5000")[1:4] == ("udp", "", 5000)
    assert parse_address("tcp://[::1]:5000")[1:4] == ("tcp", "::1", 5000)
    assert parse_address("serial:/dev/ttyS1").baud == 9600


def feed(stream: ReceiverStream, data: bytes) -> list[Fix]:
    fixes = [fix for k in range(0, len(data), 97) for fix in stream.feed(data[k : k + 97])]
    return fixes + stream.finish()


def test_of_a_receiver_that_writes_both_ubx_is_taken() -> None:
    epochs = [b"$GPGGA" + part for part in LOG.split(b"$GPGGA")[1:31]]
    messages = [pvt(second) for second in range(30)]
    both = b"".join(a + b for a, b in zip(epochs, messages, strict=True))
    stream = ReceiverStream()
    assert feed(stream, both) == parse_ubx([b"".join(messages)]).fixes
    assert stream.protocol == "UBX"
    # One that no longer writes it is heard all the same.
    fixes = feed(stream, LOG)
    assert stream.protocol == "NMEA"
    assert fixes[-1] == FIXES[-1]
