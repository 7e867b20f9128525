"""Estimates of the last seconds, made beside what must not wait for them: a thread of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

from fieldgrid.core import FieldgridError
from fieldgrid.live.pose.fixed_lag import EstimateInputs
from fieldgrid.poses import Estimate

MOST_SHARE = 0.35
"""Share of one core that estimates take at most: frames come first."""


class EstimateResult(NamedTuple):
    """What became of an estimate: it, or why there is none, in words; `problem` is an error of this
    program, else empty. `fixes` are those that went into it."""

    asked: EstimateInputs | None
    estimate: Estimate | None
    why: str = ""
    problem: str = ""


def estimate_now(asked: EstimateInputs) -> EstimateResult:
    """Make an estimate here and now."""
    try:
        return EstimateResult(asked, asked.estimate())
    except FieldgridError as error:
        return EstimateResult(asked, None, str(error))
    except Exception as error:  # noqa: BLE001 - an estimate that fails does not end the mapping
        return EstimateResult(asked, None, "poses could not be estimated", repr(error))


class Estimator:
    """Makes one estimate at a time and rests between them; what is made goes to `give`."""

    def __init__(self, give: Callable[[EstimateResult], None]) -> None:
        self._give = give
        self._thread = ThreadPoolExecutor(1, "fieldgrid-estimates")
        self._rested_s = 0.0

    @property
    def is_free(self) -> bool:
        """Whether it takes a question now."""
        return time.monotonic() >= self._rested_s

    def ask(self, asked: EstimateInputs) -> None:
        """Let it make an estimate; only when it is free."""
        self._rested_s = math.inf
        # What is no FieldgridError is a defect, and is logged.
        self._thread.submit(self._make, asked).add_done_callback(Future.result)

    def _make(self, asked: EstimateInputs) -> None:
        start_s = time.thread_time()
        made = estimate_now(asked)
        took_s = time.thread_time() - start_s
        self._rested_s = time.monotonic() + took_s * (1.0 / MOST_SHARE - 1.0)
        self._give(made)

    def close(self) -> None:
        """End it, with the estimate that is being made."""
        self._thread.shutdown()
