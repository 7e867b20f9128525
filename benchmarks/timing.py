"""Timing that can be compared: medians, and alternating runs of what is compared."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def paired_ms(
    ours: Callable[[], object], theirs: Callable[[], object], runs: int = 30
) -> tuple[float, float]:
    """Median milliseconds of processor time of two calls that take turns, so that drift hits both
    alike."""
    ours(), theirs()
    pairs = [(_once_ms(ours), _once_ms(theirs)) for _ in range(runs)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def timed_s(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds of wall and of processor time, of all threads, that a call takes.

    Only the latter can be compared on a machine that others use."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall_s, time.process_time() - cpu_s


def _once_ms(work: Callable[[], object]) -> float:
    return 1e3 * timed_s(work)[1]
