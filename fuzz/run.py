"""Runs of targets: by number or by time, with our own mutants, or with atheris."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
from pathlib import Path

from fuzz.mutation import mutant
from fuzz.target import Target

CRASHES = Path("build") / "fuzz"


class FuzzError(Exception):
    """A target has failed on an input, which is on disk now."""


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
        target.check(data)
    except Exception as problem:
        path = CRASHES / f"{target.name}-{hashlib.sha256(data).hexdigest()[:16]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        raise FuzzError(
            f"{target.name} fails with {type(problem).__name__}: {problem}. "
            f"Again: python -m fuzz {target.name} --replay {path}"
        ) from problem


def run_atheris(target: Target, seed: int, seconds: int) -> bool:
    """A coverage-guided run in a process of its own, which atheris ends. True when it is clean."""
    corpus = CRASHES / f"corpus-{target.name}"
    corpus.mkdir(parents=True, exist_ok=True)
    for data in target.seeds():
        (corpus / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
    command = [sys.executable, "-m", "fuzz.guided", target.name, str(corpus), f"-seed={seed}"]
    command += [f"-max_total_time={seconds}", f"-artifact_prefix={CRASHES}/{target.name}-"]
    return subprocess.run(command, check=False).returncode == 0
