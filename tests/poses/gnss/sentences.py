"""Sentences as a receiver writes them, and the times that they speak of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

from fieldgrid.geometry import Fix
from fieldgrid.poses import NmeaStream, UbxParser

SECOND = 1_000_000_000
JUNE_15 = 1_308_096_000 * SECOND  # 2011-06-15T00:00:00Z
NOON = JUNE_15 + 12 * 3600 * SECOND


def sentence(body: str) -> bytes:
    value = 0
    for byte in body.encode():
        value ^= byte
    return f"${body}*{value:02X}\r\n".encode()


def gga(time: str, *, quality: str = "4", lat: str = "4139.0227370", talker: str = "GP") -> bytes:
    return sentence(
        f"{talker}GGA,{time},{lat},N,00443.2141860,W,{quality},12,0.7,737.921,M,52.4,M,1.5,0138"
    )


def rmc(time: str, date: str = "150611", *, speed: str = "3.0", status: str = "A") -> bytes:
    return sentence(f"GPRMC,{time},{status},4139.02,N,00443.21,W,{speed},,{date},,,R")


def parse_nmea(data: Iterable[bytes]) -> SimpleNamespace:
    """The fixes of a stream and the counts of what was found."""
    stream = NmeaStream()
    fixes = [fix for chunk in data for fix in stream.feed(chunk)]
    fixes += stream.finish()
    return SimpleNamespace(fixes=fixes, **asdict(stream.counts))


def parse_ubx(data: Iterable[bytes]) -> SimpleNamespace:
    """The fixes of a stream and the counts of what was found."""
    parser = UbxParser()
    fixes = [fix for chunk in data for fix in parser.feed(chunk)]
    fixes += parser.close()
    return SimpleNamespace(fixes=fixes, **asdict(parser.counts))


def parse(*parts: bytes) -> list[Fix]:
    fixes: list[Fix] = parse_nmea(parts).fixes
    return fixes


def read(path: Path) -> SimpleNamespace:
    return parse_nmea([path.read_bytes()])
