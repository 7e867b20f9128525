"""Timing that can be compared: medians, and alternating runs of what is compared."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def paired_ms(
    ours: Callable[[], object], theirs: Callable[[], object], runs: int = 30
) -> tuple[float, float]:
    """Median milliseconds of two calls that take turns, so that drift hits both alike."""
    ours(), theirs()
    pairs = [(_once_ms(ours), _once_ms(theirs)) for _ in range(runs)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def _once_ms(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return (time.perf_counter() - start) * 1e3
