"""The peak memory of a process. `ru_maxrss` will not do: that of a new process begins with the peak
of the one that started it.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

_START = """
import json, os, signal, sys
limit_s, *command = sys.argv[1:]
nowhere = os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0
process = os.posix_spawn(command[0], command, os.environ, file_actions=[nowhere])
signal.signal(signal.SIGALRM, lambda *_: os.kill(process, signal.SIGKILL))
signal.alarm(int(limit_s))
_, status, used = os.wait4(process, 0)
ended = os.waitstatus_to_exitcode(status)
print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, ended]))
"""
"""A small program that starts another one, and ends it after a while, if that is not 0."""

_LOOK_S = 0.05


class Used(NamedTuple):
    """What a program took: seconds of processor time, peak memory in MB; and what it said last
    where it failed."""

    cpu_s: float
    peak_mb: float
    said: str = ""


def peak_mb(process: int | str = "self") -> float:
    """The peak memory of a process, of this one without a number, MB."""
    status = Path(f"/proc/{process}/status").read_text()
    (peak,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return int(peak) / 1024.0


@contextmanager
def peaks_of_children() -> Iterator[dict[int, float]]:
    """The peak memory in MB of each process that this one starts in the block, by its number; of
    one that ended, that of a moment before."""
    peaks: dict[int, float] = {}
    done = threading.Event()

    def look() -> None:
        while not done.wait(_LOOK_S):
            for task in Path("/proc/self/task").glob("*/children"):
                with suppress(OSError, ValueError):  # it has just ended
                    peaks.update({int(one): peak_mb(one) for one in task.read_text().split()})

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield peaks
    finally:
        done.set()
        thread.join()


def used_by(arguments: Sequence[str], *, folder: Path | None = None, limit_s: int = 0) -> Used:
    """What a Python with these arguments takes, in a folder; it is ended after the limit, if that
    is not 0. What it prints is lost."""
    command = [sys.executable, "-c", _START, str(limit_s), sys.executable, *arguments]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=folder)
    cpu_s, memory_mb, ended = json.loads(done.stdout)
    said = done.stderr.strip()[-200:] if ended else ""
    if ended == -signal.SIGKILL:
        said = f"ended after {limit_s} s"
    return Used(cpu_s, memory_mb, said or (f"ended with {ended}" if ended else ""))
