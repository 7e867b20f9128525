"""The time base of everything that was recorded: rates, gaps, jitter, and stamps that lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, info, warning
from fieldgrid.recordings import MAX_OFFSET_S, Stream

APART_S = 0.1
"""Delays of two streams, from stamp to being written down, may differ by this: that is what
exposure, transport and a busy disk take."""

DRIFT_PPM, DRIFT_S, DRIFT_OVER_S = 100.0, 0.05, 60.0
"""Quartz is good for 50 ppm. A drift is one when it is faster than `DRIFT_PPM`, comes to `DRIFT_S`
over the drive, and was seen for `DRIFT_OVER_S`."""

JUMP_S = 0.5
"""A delay that changes by more than this, and stays, is a clock that was set."""

JUMP_OVER = 20
"""Messages on either side that must agree on a jump."""

REPEATED_SHARE = 0.02

GAP_S, GAP_PERIODS = 1.0, 10.0
"""A gap of a stream that has a rate is longer than both."""

STEADY_SHARE = 0.5
"""A stream has a rate when the middle half of its steps differ by less than this share."""


class StreamSummary(NamedTuple):
    """One stream in numbers; None for what its stamps do not tell.

    `jitter_s` is half the spread of the middle 68 % of the steps about their median.
    `delay_s` is the median time from stamp to being written down, `drift_ppm` how fast it grows.
    """

    name: str
    kind: str
    role: str
    messages: int
    start_ns: int | None
    stop_ns: int | None
    rate_hz: float | None
    longest_gap_s: float | None
    jitter_s: float | None
    backward: int
    repeated: int
    unstamped: int
    delay_s: float | None
    drift_ppm: float | None


def summarise_stream(stream: Stream) -> StreamSummary:
    """The numbers of a stream, by its stamps in the order of the record."""
    stamps = np.asarray(stream.stamp_ns, dtype=np.int64)
    known = stamps[stamps > 0]
    steps_s = np.diff(known) / 1e9
    ordered_s = np.diff(np.unique(known)) / 1e9
    low, middle, high = np.quantile(ordered_s, [0.16, 0.5, 0.84]) if ordered_s.size else [None] * 3
    delay = _delay(stream)
    return StreamSummary(
        name=stream.name,
        kind=stream.kind,
        role=stream.role,
        messages=stream.count,
        start_ns=int(known.min()) if known.size else None,
        stop_ns=int(known.max()) if known.size else None,
        rate_hz=None if middle is None or middle <= 0.0 else float(1.0 / middle),
        longest_gap_s=float(ordered_s.max()) if ordered_s.size else None,
        jitter_s=None if low is None else float(high - low) / 2.0,
        backward=int(np.count_nonzero(steps_s < 0.0)),
        repeated=int(np.count_nonzero(steps_s == 0.0)),
        unstamped=int(np.count_nonzero(stamps <= 0)),
        delay_s=None if delay is None else float(np.median(delay[1])),
        drift_ppm=None if delay is None else _drift_ppm(*delay),
    )


def stream_findings(streams: Sequence[Stream]) -> Iterator[Finding]:
    """What is wrong with the stamps of the streams that are used."""
    used = [stream for stream in streams if stream.role]
    for stream in used:
        summary = summarise_stream(stream)
        yield from _order_findings(stream, summary)
        yield from _gap_findings(stream, summary)
        delay = _delay(stream)
        if delay is not None:
            yield from _delay_findings(stream, *delay)
    yield from _apart_findings(used)


def _order_findings(stream: Stream, summary: StreamSummary) -> Iterator[Finding]:
    if summary.backward:
        farthest_s = float(-np.diff(stream.stamp_ns[stream.stamp_ns > 0]).min()) / 1e9
        yield warning(
            "backward-stamps",
            f"{summary.backward} stamps of {stream.name} are earlier than the one before, by up "
            f"to {farthest_s:.3f} s.",
            "Messages are sorted by their stamps. If the clock was set during the drive, use only "
            "the part before or after that.",
        )
    if summary.repeated > REPEATED_SHARE * max(summary.messages, 1):
        yield warning(
            "repeated-stamps",
            f"{summary.repeated} of {summary.messages} stamps of {stream.name} repeat the one "
            "before.",
            "Let the driver stamp each message when it is measured.",
        )
    if summary.unstamped:
        yield warning(
            "no-stamps",
            f"{summary.unstamped} of {summary.messages} messages of {stream.name} carry no time.",
            "Let the driver fill header.stamp; until then only their time of receipt is known.",
        )


def _gap_findings(stream: Stream, summary: StreamSummary) -> Iterator[Finding]:
    """Gaps of streams that have a steady rate, which images taken by way have not. Those of fixes
    are told when they have been judged."""
    if stream.role in ("fix", "nmea"):
        return
    times_s = np.unique(stream.stamp_ns[stream.stamp_ns > 0]) / 1e9
    steps_s = np.diff(times_s - times_s[0]) if times_s.size else np.array([])
    if steps_s.size < GAP_PERIODS:
        return
    low_s, period_s, high_s = np.quantile(steps_s, [0.25, 0.5, 0.75])
    if high_s - low_s > STEADY_SHARE * period_s:
        return
    gaps_s = steps_s[steps_s > max(GAP_S, GAP_PERIODS * period_s)]
    if gaps_s.size:
        yield warning(
            "gap",
            f"{stream.name} has {gaps_s.size} gaps, the longest of {gaps_s.max():.1f} s, at a "
            f"period of {period_s:.3f} s.",
            "Check for a disk or bus that was too slow, or a receiver without sky view.",
            Figure(float(gaps_s.max()), "s"),
        )


def _delay(stream: Stream) -> tuple[Float64, Float64] | None:
    """Seconds since the first stamp, and from each stamp to being written down, where the record
    tells them."""
    if stream.receive_ns is None or len(stream.receive_ns) != len(stream.stamp_ns):
        return None
    stamped = stream.stamp_ns > 0
    stamps, received = stream.stamp_ns[stamped], stream.receive_ns[stamped]
    if not len(stamps):
        return None
    return (received - received[0]) / 1e9, (received - stamps) / 1e9


def _lower_envelope(time_s: Float64, delay_s: Float64) -> tuple[Float64, Float64]:
    """The least delay of each twentieth of the drive: waiting only adds to it."""
    groups = [g for g in np.array_split(np.arange(len(time_s)), 20) if g.size]
    least = np.array([g[np.argmin(delay_s[g])] for g in groups], dtype=np.intp)
    return time_s[least], delay_s[least]


def _drift_ppm(time_s: Float64, delay_s: Float64) -> float | None:
    """The median of the slopes between the least delays, parts per million; None when short."""
    if len(time_s) < 2 or time_s[-1] - time_s[0] < DRIFT_OVER_S:
        return None
    time_s, delay_s = _lower_envelope(time_s, delay_s)
    first, second = np.triu_indices(len(time_s), 1)
    apart_s = time_s[second] - time_s[first]
    clear = apart_s > 0.0
    if not clear.any():
        return None
    return 1e6 * float(np.median((delay_s[second] - delay_s[first])[clear] / apart_s[clear]))


def _jumps(time_s: Float64, delay_s: Float64) -> list[tuple[float, float]]:
    """When, in seconds since the first, and by how much the delay changed for good."""
    found: list[tuple[float, float]] = []
    for k in np.flatnonzero(np.abs(np.diff(delay_s)) > JUMP_S).tolist():
        before = delay_s[max(k + 1 - JUMP_OVER, 0) : k + 1]
        after = delay_s[k + 1 : k + 1 + JUMP_OVER]
        # Waiting adds to the least delay of neither side.
        by_s = float(after.min() - before.min())
        lasting = len(before) >= JUMP_OVER // 2 and len(after) >= JUMP_OVER // 2
        if lasting and abs(by_s) > JUMP_S:
            found.append((float(time_s[k + 1]), by_s))
    return found


def _delay_findings(stream: Stream, time_s: Float64, delay_s: Float64) -> Iterator[Finding]:
    jumps = _jumps(time_s, delay_s)
    if jumps:
        when_s, by_s = max(jumps, key=lambda jump: abs(jump[1]))
        yield warning(
            "clock-jump",
            f"The stamps of {stream.name} jump by {-by_s:+.3f} s against the time of receipt, "
            f"{when_s:.1f} s after its start ({len(jumps)} jumps in all).",
            "Do not set the clock during a drive; use only the part before or after the jump.",
            Figure(-by_s, "s"),
        )
        return
    drift_ppm = _drift_ppm(time_s, delay_s) or 0.0
    drift_s = abs(drift_ppm) * 1e-6 * float(time_s[-1] - time_s[0])
    if abs(drift_ppm) > DRIFT_PPM and drift_s > DRIFT_S:
        yield warning(
            "clock-drift",
            f"The stamps of {stream.name} drift by {-drift_ppm:+.0f} ppm against the time of "
            f"receipt, {drift_s:.3f} s over the drive.",
            "Synchronise the clock of that sensor (PTP, NTP, PPS); an offset cannot fix drift.",
            Figure(-drift_ppm, "ppm"),
        )


def _apart_findings(used: Sequence[Stream]) -> Iterator[Finding]:
    """Images and fixes whose stamps are of different clocks, by when both were written down."""
    image, image_s = _first_delay(used, ("left", "depth", "disparity", "cloud", "right"))
    fix, fix_s = _first_delay(used, ("fix", "nmea"))
    if image is None or fix is None:
        return
    apart_s = image_s - fix_s
    # Beyond what an offset can be, stamps count from when a sensor was switched on; the recorder's
    # times stand for them.
    if APART_S < abs(apart_s) <= MAX_OFFSET_S:
        yield info(
            "stamp-delays",
            f"Messages are recorded {image_s:+.3f} s after their stamp in {image.name} and "
            f"{fix_s:+.3f} s in {fix.name}.",
            f"If both have the same latency, their clocks differ, and --time-offset {apart_s:.3f} "
            "corrects it; compare it with the offset estimated from the drive.",
        )


def _first_delay(used: Sequence[Stream], roles: Sequence[str]) -> tuple[Stream | None, float]:
    """The first stream of these roles whose delay is known, and its delay; None where none is."""
    for stream in (stream for role in roles for stream in used if stream.role == role):
        delay = _delay(stream)
        if delay is not None:
            return stream, float(np.median(_lower_envelope(*delay)[1]))
    return None, 0.0
