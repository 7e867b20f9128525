"""The time base of everything that was recorded: rates, gaps, jitter, and stamps that lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, Index, info, warning
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
    time_s, delay_s = _delays(stream)
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
        delay_s=float(np.median(delay_s)) if delay_s.size else None,
        drift_ppm=_drift_ppm(time_s, delay_s),
    )


def stream_findings(streams: Sequence[Stream]) -> Iterator[Finding]:
    """What is wrong with the stamps of the streams that are used."""
    used = [stream for stream in streams if stream.role]
    for stream in used:
        summary = summarise_stream(stream)
        yield from _order_findings(stream, summary)
        yield from _gap_findings(stream)
        yield from _delay_findings(stream, summary.drift_ppm or 0.0)
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


def _gap_findings(stream: Stream) -> Iterator[Finding]:
    """Gaps of streams that have a steady rate, which images taken by way have not. Those of fixes
    are told when they have been judged."""
    steps_s = np.diff(np.unique(stream.stamp_ns[stream.stamp_ns > 0])) / 1e9
    if stream.role in ("fix", "nmea") or steps_s.size < GAP_PERIODS:
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


def _delays(stream: Stream) -> tuple[Float64, Float64]:
    """Seconds since the first message, and from each stamp to being written down; of no message
    where the record does not tell them."""
    received = stream.receive_ns
    if received is None or len(received) != len(stream.stamp_ns):
        return np.zeros(0), np.zeros(0)
    stamped = stream.stamp_ns > 0
    received = received[stamped]
    return (received - received[:1]) / 1e9, (received - stream.stamp_ns[stamped]) / 1e9


def _least(delay_s: Float64) -> Index:
    """Where the delay is the least of each twentieth of the drive: waiting only adds to it."""
    groups = np.array_split(np.arange(len(delay_s)), 20)
    return np.array([g[np.argmin(delay_s[g])] for g in groups if g.size], dtype=np.intp)


def _drift_ppm(time_s: Float64, delay_s: Float64) -> float | None:
    """The median of the slopes between the least delays, parts per million; None when short."""
    if len(time_s) < 2 or time_s[-1] - time_s[0] < DRIFT_OVER_S:
        return None
    least = _least(delay_s)
    first, second = (least[k] for k in np.triu_indices(len(least), 1))
    clear = time_s[second] > time_s[first]
    slopes = (delay_s[second] - delay_s[first])[clear] / (time_s[second] - time_s[first])[clear]
    return 1e6 * float(np.median(slopes)) if slopes.size else None


def _jumps(time_s: Float64, delay_s: Float64) -> list[tuple[float, float]]:
    """When, in seconds since the first, and by how much the delay changed for good."""
    found: list[tuple[float, float]] = []
    for k in np.flatnonzero(np.abs(np.diff(delay_s)) > JUMP_S).tolist():
        before = delay_s[max(k + 1 - JUMP_OVER, 0) : k + 1]
        after = delay_s[k + 1 : k + 1 + JUMP_OVER]
        # Waiting adds to the least delay of neither side.
        by_s = float(after.min() - before.min())
        if min(len(before), len(after)) >= JUMP_OVER // 2 and abs(by_s) > JUMP_S:
            found.append((float(time_s[k + 1]), by_s))
    return found


def _delay_findings(stream: Stream, drift_ppm: float) -> Iterator[Finding]:
    """That a clock was set or drifts, by when its messages were written down."""
    time_s, delay_s = _delays(stream)
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
    drift_s = abs(drift_ppm) * 1e-6 * float(time_s.max(initial=0.0))
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
    images = _usual_delays(used, ("left", "depth", "disparity", "cloud", "right"))
    fixes = _usual_delays(used, ("fix", "nmea"))
    if not images or not fixes:
        return
    (image, image_s), (fix, fix_s) = images[0], fixes[0]
    apart_s = image_s - fix_s
    # Beyond what an offset can be, stamps count from when a sensor was switched on; the recorder's
    # times stand for them.
    if APART_S < abs(apart_s) <= MAX_OFFSET_S:
        yield info(
            "stamp-delays",
            f"Messages are recorded {image_s:+.3f} s after their stamp in {image} and "
            f"{fix_s:+.3f} s in {fix}.",
            f"If both have the same latency, their clocks differ, and --time-offset {apart_s:.3f} "
            "corrects it; compare it with the offset estimated from the drive.",
        )


def _usual_delays(used: Sequence[Stream], roles: Sequence[str]) -> list[tuple[str, float]]:
    """The streams of these roles whose delays are known, by name, in the order of the roles."""
    known = sorted(
        (one for one in used if one.role in roles), key=lambda one: roles.index(one.role)
    )
    delays = [(stream.name, _delays(stream)[1]) for stream in known]
    return [(name, float(np.median(d[_least(d)]))) for name, d in delays if d.size]
