"""Logs of what a receiver sent: NMEA 0183, UBX, or both in one stream."""

from __future__ import annotations

import re
from pathlib import Path

from fieldgrid.core import GnssError, counted
from fieldgrid.geometry import FixColumns
from fieldgrid.poses import NmeaCounts, NmeaStream, UbxCounts, UbxParser
from fieldgrid.recordings.files import open_log_bytes
from fieldgrid.recordings.tables.fix_log import FixLog

_CHUNK = 1 << 20
_UNLIMITED = 1 << 60
_DAY_NS = 86_400 * 10**9
_SENTENCE = re.compile(rb"\$[A-Z][A-Z0-9]{3,9},[ -)+-~]*\*[0-9A-Fa-f]{2}")
_UBX_CLASSES = rb"\x01\x02\x04\x05\x06\x0a\x0b\x0c\x0d\x10\x13\x21\x27\x28"
_UBX = re.compile(rb"\xb5\x62[" + _UBX_CLASSES + rb"][\x00-\xff]{2}[\x00-\x10]")


class NoStreamError(GnssError):
    """A file that holds neither a sentence nor a message."""


class UndatedError(GnssError):
    """Sentences with positions, of which none tells a date."""


def looks_like_stream(head: bytes) -> bool:
    """Whether the start of a file holds a sentence or the start of a UBX message."""
    return _SENTENCE.search(head) is not None or _UBX.search(head) is not None


def read_stream(path: Path, epoch_ns: int | None = None) -> FixLog:
    """The fixes of a log; of those of two protocols the more numerous, which is noted. Sentences
    without a date begin on the day of `epoch_ns`.

    :class:`NoStreamError` where there is neither, :class:`UndatedError` for positions without a
    date.
    """
    # Both parsers read the same bytes; what belongs to the one is noise to the other.
    day = None if epoch_ns is None else epoch_ns // _DAY_NS
    sentences, messages = NmeaStream(max_undated=_UNLIMITED, first_day=day), UbxParser()
    # Records take six times the memory of columns, so that only those of a chunk are held.
    nmea_parts, ubx_parts = [], []
    with open_log_bytes(path) as stream:
        while chunk := stream.read(_CHUNK):
            nmea_parts.append(FixColumns.of_rows(sentences.feed(chunk)))
            ubx_parts.append(FixColumns.of_rows(messages.feed(chunk)))
    nmea_parts.append(FixColumns.of_rows(sentences.finish()))
    ubx_parts.append(FixColumns.of_rows(messages.close()))
    from_nmea, from_ubx = FixColumns.joined(nmea_parts), FixColumns.joined(ubx_parts)
    nmea, ubx = sentences.counts, messages.counts
    if not (nmea.sentences or nmea.bad_checksum or nmea.broken or ubx.messages):
        raise NoStreamError(
            f"{path} is no bag and no GNSS log that is known: no NMEA sentence, no UBX message, no "
            "table; check the file, or let the receiver write GGA and RMC."
        )
    if nmea.undated and not (len(from_nmea) or len(from_ubx)):
        raise UndatedError(
            f"{path}: The log has {nmea.undated} positions but no valid RMC or ZDA sentence, which "
            "alone give their date; say on which day it begins, as by --epoch 2026-05-14, and let "
            "the receiver write RMC besides GGA."
        )
    by_ubx = bool(ubx.messages) and len(from_ubx) >= len(from_nmea)
    notes = _ubx_notes(ubx, len(from_ubx)) if by_ubx else nmea_notes(nmea)
    if len(from_nmea) and len(from_ubx):
        both = f"{counted(len(from_ubx), 'position')} in UBX and {len(from_nmea)} in NMEA"
        notes = [f"{both}; {'UBX' if by_ubx else 'NMEA'} is taken", *notes]
    fixes = from_ubx if by_ubx else from_nmea
    return FixLog(fixes, tuple(f"{path.name}: {note}." for note in notes))


def nmea_notes(log: NmeaCounts) -> list[str]:
    """What was skipped and assumed in a log, a few words each."""
    told = (
        (log.bad_checksum + log.broken, "damaged sentence", " skipped"),
        (log.no_position, "sentence", " without a position"),
        (log.repeated, "repeated position", " of one epoch skipped"),
        (log.no_geoid, "fix", " without geoid separation: height above mean sea level"),
        (log.no_height, "fix", " without a height: taken as 0 m"),
        (log.undated, "position", " without a date skipped"),
    )
    return [counted(count, what) + rest for count, what, rest in told if count]


def _ubx_notes(log: UbxCounts, fixes: int) -> list[str]:
    told = (
        (log.bad_checksum + log.broken, "damaged UBX message", " skipped"),
        (log.no_position, "UBX solution", " without a position or a time"),
        (log.repeated, "repeated position", " of one epoch skipped"),
        (
            log.unfixed_headings,
            "relative position",
            " without a heading: not fixed, or the base does not move along",
        ),
    )
    notes = [counted(count, what) + rest for count, what, rest in told if count]
    if not fixes:
        sent = counted(log.messages, "UBX message")
        notes.append(f"{sent}, but no NAV-PVT with a position; switch it on")
    return notes
