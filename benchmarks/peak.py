"""The peak memory of a process. `ru_maxrss` will not do: that of a new process begins with the peak
of the one that started it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

_START = """
import json, os, sys
process = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)
_, status, used = os.wait4(process, 0)
print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0]))
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""A small program that starts another one."""


def peak_mb() -> float:
    """The peak memory of this process, MB."""
    status = Path("/proc/self/status").read_text()
    (peak,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return int(peak) / 1024.0


def used_by(arguments: Sequence[str]) -> tuple[float, float]:
    """Seconds of processor time and peak memory in MB of a Python that prints nothing, with these
    arguments."""
    command = [sys.executable, "-c", _START, sys.executable, *arguments]
    used_s, memory_mb = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return used_s, memory_mb
