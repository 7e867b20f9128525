"""Runs of targets: by number or by time, with our own mutants, or with atheris."""

from __future__ import annotations

import hashlib
import json
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fuzz.mutation import mutant
from fuzz.target import Target

CRASHES = Path("build") / "fuzz"
LONGEST_S = 20.0
"""Processor time that one input may take."""

_EXECUTED = re.compile(r"stat::number_of_executed_units:\s*(\d+)")


class FuzzError(Exception):
    """A target has failed on an input, which is on disk now."""


class TooLongError(Exception):
    """An input took more processor time than any may."""


def run_mutants(target: Target, seed: int, *, most: int | None = None, seconds: float = 0) -> int:
    """Try mutants up to a number, or for a time. Returns how many were tried.

    The same seed gives the same mutants in the same order, on any machine that has the same
    seed files. FuzzError on the first that fails.
    """
    seeds = target.seeds()
    for data in seeds:
        try_input(target, data)
    end = time.monotonic() + seconds
    number = 0
    while number < most if most is not None else time.monotonic() < end:
        try_input(target, mutant(seeds, target.mend, seed, number))
        number += 1
    return number


def try_input(target: Target, data: bytes) -> None:
    """One input; where the target fails on it, it is kept."""
    try:
        with _timed():
            target.check(data)
    except Exception as problem:
        path = CRASHES / f"{target.name.replace(' ', '_')}-{hashlib.sha256(data).hexdigest()[:16]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        raise FuzzError(
            f"{target.name} fails with {type(problem).__name__}: {problem}. "
            f"Again: python -m fuzz {target.name!r} --replay {path}"
        ) from problem


@contextmanager
def _timed() -> Iterator[None]:
    def give_up(*_: object) -> None:
        raise TooLongError(f"over {LONGEST_S:g} s")

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def limit_memory(mib: int) -> None:
    """Let this process take so much more address space than it has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + (mib << 20)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def run_atheris(target: Target, seed: int, seconds: int, mib: int) -> int | None:
    """A coverage-guided run in a process of its own, which atheris ends. Returns how many inputs
    it has tried, None where one failed."""
    corpus = CRASHES / f"corpus-{target.name.replace(' ', '_')}"
    corpus.mkdir(parents=True, exist_ok=True)
    for data in target.seeds():
        (corpus / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
    command = [sys.executable, "-m", "fuzz.guided", target.name, str(corpus), f"-seed={seed}"]
    command += [f"-max_total_time={seconds}", f"-artifact_prefix={CRASHES}/", "-max_len=8192"]
    command += [f"-timeout={LONGEST_S:g}", f"-rss_limit_mb={mib}", "-print_final_stats=1"]
    done = subprocess.run(command, check=False, stderr=subprocess.PIPE)
    said = done.stderr.decode("utf-8", "replace")
    executed = _EXECUTED.search(said)
    if done.returncode or executed is None:
        print(said[-8000:], file=sys.stderr)
        return None
    return int(executed[1])


class Tally:
    """How many inputs each target has had so far, over all runs, kept in a file."""

    def __init__(self, file: Path = CRASHES / "executions.json") -> None:
        self._file = file
        self.counts: dict[str, int] = json.loads(file.read_text()) if file.exists() else {}

    def add(self, target: Target, count: int) -> None:
        """Count inputs that passed."""
        self.counts[target.name] = self.counts.get(target.name, 0) + count
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.write_text(json.dumps(self.counts, indent=1))

    @property
    def total(self) -> int:
        """Of all targets."""
        return sum(self.counts.values())
