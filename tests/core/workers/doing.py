"""Work for the tests that a worker can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import ClusterError, MapError


class Squaring(NamedTuple):
    """Squares numbers; some it refuses, of one the first `times` processes die, and the first
    number is late."""

    refused: int = -1
    unable: int = -1
    deadly: int = -1
    times: int = 1
    marks: Path = Path()

    def __call__(self, number: int) -> int:
        if number == 0:
            time.sleep(0.05)  # so that others are done before it
        if number == self.refused:
            raise MapError(f"{number} is damaged.")
        if number == self.unable:
            raise ClusterError(f"{number} is not on this worker.")
        if number == self.deadly:
            died = self.marks.stat().st_size if self.marks.exists() else 0
            if died < self.times:
                with self.marks.open("a") as marks:
                    marks.write("x")
                os.kill(os.getpid(), signal.SIGKILL)
        return number * number


arrived: list[None] = []
"""One for each time that work has arrived in this process."""


class Arriving:
    """Returns its items, and counts how often it arrives."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _arrived, ()

    def __call__(self, item: int) -> int:
        return item


def _arrived() -> Arriving:
    arrived.append(None)
    return Arriving()
