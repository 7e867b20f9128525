"""A receiver on a link: its bytes to fixes, as they come."""

from __future__ import annotations

import codecs
import re
import time
from contextlib import closing
from pathlib import Path

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Fix
from fieldgrid.live.intake import Intake
from fieldgrid.live.sources.links import Address, check_link, open_link, parse_address
from fieldgrid.poses import NmeaStream, UbxParser
from fieldgrid.recordings import looks_like_stream

# Whether a receiver's log may go on in a file, told by how that begins.
#
# What a crash or a power cut left of an earlier log may be a cut sentence, zeros, or binary
# messages alone. Such a file is its own; only what is recognised as something else is refused.


_HEAD_BYTES = 1 << 16

_STARTS = (
    b"PK\x03\x04", b"PK\x05\x06", b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0", b"7z\xbc\xaf",
    b"\x28\xb5\x2f\xfd", b"SQLite format 3", b"#ROSBAG V", b"\x89MCAP0\r\n", b"\x89HDF\r\n",
    b"\x93NUMPY", b"PAR1", b"\x89PNG", b"\xff\xd8\xff", b"II*\0", b"MM\0*", b"II+\0", b"GIF8",
    b"RIFF", b"%PDF", b"\x7fELF", b"LASF", b"ULog\x01\x12\x35", b"\xa3\x95\x80\x80",
)  # fmt: skip
"""How archives, databases, recordings, images and programs begin."""

_UTF16 = re.compile(rb"\xff\xfe(?:[\t\r\n -~]\0){4}|\xfe\xff(?:\0[\t\r\n -~]){4}")
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")
_OF_A_RECEIVER = re.compile(
    r"[$!][A-Z][A-Z0-9]{2,9},"  # the start of a sentence
    r"|^[$!][A-Z0-9]{0,9}\Z"  # the same, cut
    r"|\*(?:[0-9A-Fa-f]{2}|[0-9A-Fa-f]{8})\r?$"  # the end of one, of NMEA or NovAtel
    r'|\A\s*\{"class":'  # gpsd, before it passes the receiver on
    r"|\A[A-Z0-9,.*+-]{0,90}\r?\Z",  # the midst of one
    re.MULTILINE,
)


def may_go_on(log: Path) -> bool:
    """Whether a file may be the log of a receiver. A pipe or a device may."""
    if not log.is_file():
        return True
    with log.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith(_STARTS) or _UTF16.match(head):
        return False
    text = _text(head.replace(b"\0", b""))
    if text is None or not text.strip() or looks_like_stream(head):
        return True
    return _OF_A_RECEIVER.search(text) is not None


def _text(head: bytes) -> str | None:
    """The head as text; None where it is binary."""
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(head)  # its end may be cut
    except UnicodeDecodeError:
        text = head.decode("latin-1")
        if sum(byte < 0x80 for byte in head) < 0.9 * len(head):
            return None
    return None if _CONTROL.search(text) else text


POLL_S = 0.25

DECIDES = 3
"""Fixes of one protocol after which it is known which ones the receiver writes."""

TURNS_AFTER = 20
"""Number of fixes of the other protocol, without one of that which is taken, after which it is
taken."""


class ReceiverStream:
    """Fixes out of the bytes of a receiver that writes NMEA 0183, UBX or both.

    One protocol is taken, since both tell the same positions, each rounded in its own way: of both
    it is UBX, as in a log. The first fixes wait until that is known.
    """

    def __init__(self) -> None:
        self._nmea, self._ubx = NmeaStream(late_epochs=1), UbxParser()
        self._held: dict[str, list[Fix]] = {"UBX": [], "NMEA": []}
        self.protocol = ""
        """The protocol that is taken, empty while that is open."""

    def feed(self, data: bytes) -> list[Fix]:
        """The fixes that are complete after some more bytes."""
        return self._take(self._ubx.feed(data), self._nmea.feed(data), DECIDES)

    def finish(self) -> list[Fix]:
        """The fixes that were still open at the end."""
        return self._take(self._ubx.close(), self._nmea.finish(), 1)

    def _take(self, ubx: list[Fix], nmea: list[Fix], decides: int) -> list[Fix]:
        held = self._held
        held["UBX"] += ubx
        held["NMEA"] += nmea
        if not (self.protocol and held[self.protocol]):
            fewest = TURNS_AFTER if self.protocol else decides
            if max(map(len, held.values())) < fewest:
                return []
            self.protocol = next(name for name, fixes in held.items() if fixes)
        self._held = {"UBX": [], "NMEA": []}
        return held[self.protocol]

    def why_no_fix(self) -> str:
        """Why bytes come and no fix, and what to do."""
        nmea, ubx = self._nmea.counts, self._ubx.counts
        if nmea.undated:
            return "the date is missing; let the receiver write RMC or ZDA besides GGA"
        if nmea.no_position or ubx.no_position:
            return "the receiver has no position yet"
        if nmea.sentences or ubx.messages:
            return "no message has a position; let the receiver write GGA and RMC, or NAV-PVT"
        return "no sentence of NMEA and no message of UBX is whole; check the baud rate"


class Receiver:
    """A receiver as a source of fixes; `address` is written as `--gnss` has it.

    The stream goes on over losses of the link, so that a date that was told once holds. What comes
    is appended to the file `log` as well, where one is given. Raises ConfigError for what is no
    address, for a serial port without pyserial, and for a log that cannot be written or is
    recognised as something else.
    """

    def __init__(self, address: str | Address, log: Path | None = None) -> None:
        self._address = parse_address(address) if isinstance(address, str) else address
        check_link(self._address)
        self._stream = ReceiverStream()
        self._log, self._log_problem = log, ""
        if why := self._keep(b""):
            raise ConfigError(f"The log {log} cannot be written: {why}; give another place.")
        if log is not None and not may_go_on(log):
            raise ConfigError(f"{log} is no log of a receiver to append to; give another name.")

    @property
    def name(self) -> str:
        """The receiver and its address."""
        return f"The receiver at {self._address.text}"

    def run(self, intake: Intake) -> None:
        """Give fixes as they come; see `Source`."""
        pauses, is_silent, told_no_fix = intake.pauses, False, False
        with closing(open_link(self._address)) as link:
            heard_s = fix_s = time.monotonic()
            while not intake.stop.is_set():
                data = link.read(min(POLL_S, pauses.silent_s))
                now_s = time.monotonic()
                still_s = now_s - heard_s
                if not data:
                    if still_s > pauses.silent_s and not is_silent:
                        is_silent = True
                        intake.tell(f"has sent nothing for {still_s:.0f} s; the mapping goes on.")
                    if still_s > pauses.dead_s and self._address.is_reopened:
                        raise ConnectionError(f"nothing came for {pauses.dead_s:.0f} s")
                    continue
                intake.arrived()
                self._keep_or_tell(data, intake)
                if is_silent:
                    is_silent = False
                    intake.tell(f"sends again, after {still_s:.0f} s.")
                heard_s = now_s
                if fixes := self._stream.feed(data):
                    fix_s, told_no_fix = now_s, False
                    for fix in fixes:
                        intake.push_fix(fix)
                elif now_s - fix_s > pauses.no_fix_s and not told_no_fix:
                    told_no_fix = True
                    why = self._stream.why_no_fix()
                    intake.tell(f"sends, but no fix for {now_s - fix_s:.0f} s: {why}.")

    def _keep(self, data: bytes) -> str:
        """Append to the log; why that is not possible, or nothing."""
        if self._log is not None:
            try:
                with self._log.open("ab") as file:
                    file.write(data)
            except OSError as error:
                return error.strerror or str(error)
        return ""

    def _keep_or_tell(self, data: bytes, intake: Intake) -> None:
        before, self._log_problem = self._log_problem, self._keep(data)
        if self._log_problem and not before:
            intake.tell(f"is not logged: {self._log} cannot be written ({self._log_problem}).")
        elif before and not self._log_problem:
            intake.tell(f"is logged in {self._log} again.")

    def finish(self, intake: Intake) -> None:
        """Give the fixes that were still open."""
        for fix in self._stream.finish():
            intake.push_fix(fix)
