"""Whether a receiver's log may go on in a file, told by how that begins.

What a crash or a power cut left of an earlier log may be a cut sentence, zeros, or binary messages
alone. Such a file is its own; refused is only what is recognised as something else.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from fieldgrid.recording.stream_log import looks_like_stream

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
