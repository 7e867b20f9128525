"""Work for the tests that a worker can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import NamedTuple

from fieldgrid.errors import ClusterError, MapError


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
