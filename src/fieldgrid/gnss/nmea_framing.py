"""Intact sentences out of a stream of bytes, whatever lies between them.

A sentence begins with ``$`` (NMEA 0183) or ``#`` (a Unicore or NovAtel log in ASCII) and ends
before the next of these, or at the end of its line. That alone frames the stream: a broken or
merged line ends where the next sentence starts, binary messages and garbage match nothing, the
result does not depend on how the bytes arrive, and no more than one sentence is held.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator

from fieldgrid.gnss.fields import checksums

_BLOCK = 1 << 16  # bytes searched at once
_LONGEST = 1200  # bytes of any sentence, with room to spare

# The standard's 82 bytes are exceeded by many receivers. What may stand in a sentence is printable,
# and none of $ # *.
_SENTENCE = re.compile(
    rb"\$((?:(P[A-Z0-9]{3,9}|KSXT)|[A-Z][A-Z0-9]([A-Z0-9]{2,8})),)"
    rb"(?:([ -\"%-)+-~]{0,240})\*([0-9A-Fa-f]{2})([0-9A-Fa-f]{6})?)?"
    rb"|(#[A-Z][A-Z0-9]{3,20}A),(?:([ -\"%-)+-~]{0,1100})\*([0-9A-Fa-f]{8}))?"
)
_WITH_CRC = b"KSXT"  # some firmware ends this one sentence with a CRC-32


class Framer:
    """Cuts a stream into sentences, and counts them.

    `sentences` counts the intact ones of any kind, `bad_checksum` the complete ones whose
    checksum is wrong, `broken` those that are cut, merged or too long.
    """

    def __init__(self) -> None:
        self.sentences = self.bad_checksum = self.broken = 0
        self._rest = b""

    def feed(self, chunk: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Intact sentences that are complete by now: what kind each is, and its text.

        The kind is the formatter without the talker (``GGA``), the name of a maker's own
        sentence (``PTNL``), or that of a log with its sign (``#BESTNAVA``). The text is all
        that the checksum covers.
        """
        for start in range(0, len(chunk), _BLOCK):
            data = self._rest + chunk[start : start + _BLOCK]
            end = max(data.rfind(b"\n") + 1, data.rfind(b"$"), data.rfind(b"#"), 0)
            self._rest = data[end : end + _LONGEST]
            yield from self._intact(data[:end])

    def finish(self) -> Iterator[tuple[bytes, bytes]]:
        """The sentence at the very end, which nothing has ended yet."""
        rest, self._rest = self._rest, b""
        return self._intact(rest)

    def _intact(self, data: bytes) -> Iterator[tuple[bytes, bytes]]:
        found = _SENTENCE.findall(data)
        texts = [address + body for address, _, _, body, *_ in found]
        for one, text, total in zip(found, texts, checksums(texts), strict=True):
            _, own, formatter, _, xor, crc, log, log_body, log_crc = one
            if xor:
                kind = formatter or own
                intact = total == int(xor, 16)
                if own == _WITH_CRC and crc and not intact:
                    intact = unicore_crc(text) == int(xor + crc, 16)
            elif log_crc:
                kind, text = log, log[1:] + b"," + log_body
                intact = unicore_crc(text) == int(log_crc, 16)
            else:
                self.broken += 1
                continue
            if intact:
                self.sentences += 1
                yield kind, text
            else:
                self.bad_checksum += 1


def unicore_crc(text: bytes) -> int:
    """CRC-32 as Unicore and NovAtel compute it: the common one without its inversions."""
    return zlib.crc32(text, 0xFFFFFFFF) ^ 0xFFFFFFFF
