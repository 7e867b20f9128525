"""NMEA 0183 to fixes, from a live receiver or from a log.

A fix is what all sentences of one epoch say together. Its position is that of GGA, or of
PTNL GGK, KSXT, BESTNAVA or PVTSLNA where there is none. RMC, VTG, GSA, GST, HDT, THS, TRA, HPR,
PTNL AVR, PASHR, UNIHEADINGA and HEADINGA add to it; RMC, ZDA and all that have a full date
give the date. Where a log has RMC alone, its positions serve, at height 0: it has none.
"""

from __future__ import annotations

import re
import zlib

from fieldgrid.geometry import Fix
from fieldgrid.poses.gnss.fields import checksums
from fieldgrid.poses.gnss.nmea_epochs import EpochLog, NmeaCounts
from fieldgrid.poses.gnss.nmea_sentences import SENTENCES

# Intact sentences out of a stream of bytes, whatever lies between them.
#
# A sentence begins with ``$`` (NMEA 0183) or ``#`` (a Unicore or NovAtel log in ASCII) and ends
# before the next of these, or at the end of its line. That alone frames the stream: a broken or
# merged line ends where the next sentence starts, binary messages and garbage match nothing, the
# result does not depend on how the bytes arrive, and no more than one sentence is held. A sentence
# is known by its formatter without the talker (`GGA`), by the name of a maker's own (`PTNL,GGK`),
# or by that of a log with its sign (`#BESTNAVA`).


_BLOCK = 1 << 16  # bytes searched at once
_LONGEST = 1200  # bytes of any sentence, with room to spare

# The standard's 82 bytes are exceeded by many receivers. What may stand in a sentence is printable,
# and none of $ # *.
_SENTENCE = re.compile(
    rb"\$((?:(PTNL,(?:GGK|AVR)|P[A-Z0-9]{3,9}|KSXT)|[A-Z][A-Z0-9]([A-Z0-9]{2,8})),)"
    rb"(?:([ -\"%-)+-~]{0,240})\*([0-9A-Fa-f]{2})([0-9A-Fa-f]{6})?)?"
    rb"|(#[A-Z][A-Z0-9]{3,20}A),(?:([ -\"%-)+-~]{0,1100})\*([0-9A-Fa-f]{8}))?"
)
_WITH_CRC = b"KSXT"  # some firmware ends this one sentence with a CRC-32


def unicore_crc(text: bytes) -> int:
    """CRC-32 as Unicore and NovAtel compute it: the common one without its inversions."""
    return zlib.crc32(text, 0xFFFFFFFF) ^ 0xFFFFFFFF


_PAD = [b""] * 31  # no sentence is read more fields beyond those that it has


class NmeaStream:
    """Fixes out of bytes as they come. What it gives does not depend on how they are cut.

    A fix is given when `late_epochs` later times have been heard of, since any sentence may
    come that late; 1 is right for a receiver that finishes an epoch before it starts another.
    Of the positions that come before the first date the last `max_undated` are kept for it, so
    that memory is bounded. `first_day`, in days since 1970, is the date of the first position where
    no sentence tells one, as in a log of GGA alone. While it is open whether a receiver that
    writes RMC alone will write GGA as well, its first 20 epochs wait. Nothing in the stream makes
    it raise an error. What else was found so far is in `counts`.
    """

    def __init__(
        self, *, late_epochs: int = 4, max_undated: int = 10_000, first_day: int | None = None
    ) -> None:
        if late_epochs < 1 or max_undated < 1:
            raise ValueError(f"late_epochs {late_epochs} and max_undated {max_undated} must be > 0")
        self.counts = NmeaCounts()
        self._rest = b""
        self._epochs = EpochLog(late_epochs, max_undated, first_day, self.counts)

    def feed(self, chunk: bytes) -> list[Fix]:
        """The fixes that are complete after some more bytes, in their order."""
        for start in range(0, len(chunk), _BLOCK):
            data = self._rest + chunk[start : start + _BLOCK]
            end = max(data.rfind(b"\n") + 1, data.rfind(b"$"), data.rfind(b"#"), 0)
            self._rest = data[end : end + _LONGEST]
            self._read(data[:end])
        return self._epochs.fixes()

    def finish(self) -> list[Fix]:
        """The fixes that were still open when the stream ended."""
        rest, self._rest = self._rest, b""
        self._read(rest)
        self._epochs.finish()
        return self._epochs.fixes()

    def _read(self, data: bytes) -> None:
        """Read the intact sentences of whole lines, and count them."""
        counts, found = self.counts, _SENTENCE.findall(data)
        texts = [one[0] + one[3] for one in found]
        for one, text, total in zip(found, texts, checksums(texts), strict=True):
            _, own, formatter, _, xor, crc, log, log_body, log_crc = one
            kind = log or formatter or own
            if xor:
                intact = total == int(xor, 16)
                if own == _WITH_CRC and crc and not intact:
                    intact = unicore_crc(text) == int(xor + crc, 16)
            elif log_crc:
                text = log[1:] + b"," + log_body
                intact = unicore_crc(text) == int(log_crc, 16)
                text = text.replace(b";", b",")  # behind the header
            else:
                counts.broken += 1
                continue
            if not intact:
                counts.bad_checksum += 1
                continue
            counts.sentences += 1
            sentence = SENTENCES.get(kind)
            if sentence is not None:
                try:
                    self._epochs.hear(sentence, text.split(b",") + _PAD)
                except ValueError:
                    counts.broken += 1
