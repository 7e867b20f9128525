"""How fast NMEA is parsed: `python -m benchmarks.parsing`.

The log is what a receiver at 10 Hz writes: GGA, RMC, VTG, GSA and GST of every epoch. The bare
framing in the same run finds the sentences and does nothing with them.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from benchmarks.sentences import checksum
from benchmarks.timing import paired_ms
from fieldgrid.geometry import Fix
from fieldgrid.poses import NmeaStream

_EPOCHS = 10_000
_CHUNK = 1 << 16
_FRAME = re.compile(rb"\$([A-Z]{5}),([^$*\r\n]*)\*([0-9A-F]{2})")


class ParsingSpeed(NamedTuple):
    """Sentences a second on one core, and how many times the bare framing takes as long."""

    sentences_per_s: float
    times_framing: float


def measure_parsing(epochs: int = _EPOCHS, runs: int = 9) -> ParsingSpeed:
    """Parsing and bare framing of the same bytes, taking turns; the medians."""
    data = typical_log(epochs)
    chunks = [data[k : k + _CHUNK] for k in range(0, len(data), _CHUNK)]
    parse_ms, frame_ms = paired_ms(
        lambda: _fixes(chunks), lambda: sum(1 for _ in _FRAME.finditer(data)), runs
    )
    assert len(_fixes(chunks)) == epochs
    return ParsingSpeed(5 * epochs / parse_ms * 1e3, parse_ms / frame_ms)


def _fixes(chunks: list[bytes]) -> list[Fix]:
    stream = NmeaStream(max_undated=1 << 60)
    return [fix for chunk in chunks for fix in stream.feed(chunk)] + stream.finish()


def typical_log(epochs: int) -> bytes:
    """Five sentences for each epoch of a drive at 10 Hz."""
    return b"".join(_epoch(k) for k in range(epochs))


def _epoch(k: int) -> bytes:
    tenths = k % 864_000
    seconds = tenths // 10
    time = f"{seconds // 3600:02}{seconds // 60 % 60:02}{seconds % 60:02}.{tenths % 10}0"
    place = f"4139.{2_273_700 + k % 5_000_000:07},N,00443.{2_141_860 + k % 5_000_000:07},W"
    course, knots = k % 3600 / 10, 3.0 + k % 17 / 100
    return b"".join(
        b"$%b*%02X\r\n" % (body.encode(), checksum(body.encode()))
        for body in (
            f"GNGGA,{time},{place},4,12,0.7,{737 + k % 97 / 100:.3f},M,52.4,M,{k % 9 / 10},0138",
            f"GNRMC,{time},A,{place},{knots:.2f},{course:.1f},150611,,,R",
            f"GNVTG,{course:.1f},T,,M,{knots:.2f},N,{knots * 1.852:.2f},K,R",
            "GNGSA,A,3,01,02,03,04,05,06,07,08,09,10,11,12,1.2,0.7,1.0",
            f"GNGST,{time},0.4,0.3,0.2,7.6,{0.01 + k % 7 / 1000:.3f},{0.012:.3f},0.03",
        )
    )


def main() -> None:
    """Measure and print."""
    speed = measure_parsing()
    print(
        f"NMEA: {speed.sentences_per_s:,.0f} sentences/s, "
        f"{speed.times_framing:.1f} times the bare framing"
    )


if __name__ == "__main__":
    main()
