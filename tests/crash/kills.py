"""A writer that is killed with SIGKILL at random moments, again and again, on one map.

    python -m tests.crash.kills 250 [SEED]

prints how many kills there were, how many of them hit an operation half-way, and which. After
each the map must verify, and hold every step that the writer had acknowledged.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from fieldgrid.maps.file import database
from tests.crash.operations import (
    State,
    check,
    make,
    merge,
    random_step,
    state_of,
)

LONGEST_S = 0.5
"""Writers live up to so long."""

FRESH_EVERY = 20
"""Kills after which a new map is begun, because removed sessions are kept."""


def run_kills(count: int, seed: int, folder: Path) -> Counter[str]:
    """Kill so many writers; returns what they were doing. AssertionError at the first loss."""
    random = np.random.default_rng(seed)
    hit: Counter[str] = Counter()
    path = folder / "map.gpkg"
    for number in range(count):
        if number % FRESH_EVERY == 0:
            make(path)
        before = state_of(path)
        # Half of the writers have so little memory that pages reach the file before the commit.
        doing, allowed = _one(path, before, seed * 100_003 + number, random, number % 2 == 0)
        hit[doing] += 1
        check(path, allowed)
        # A draft that a writer left is removed with the next, so there is never more than one.
        assert sum(draft.stat().st_size > 0 for draft in folder.glob(".*.partial.gpkg")) <= 1
        copy = folder / "copy.gpkg"
        if copy.exists():
            check(copy, [state_of(copy)])
    return hit


def _one(
    path: Path, before: State, seed: int, random: np.random.Generator, small: bool
) -> tuple[str, list[State]]:
    """One writer's life; returns what it was doing, and the states that may be found."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            _write_on(path, before, seed, writer, small)
        finally:
            os._exit(1)
    os.close(writer)
    time.sleep(float(random.uniform(0.0, LONGEST_S)))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "the writer ended by itself: it met an error"
    with os.fdopen(reader) as pipe:
        lines = pipe.read().splitlines()
    # The writer is deterministic, so what it was told to do is known here.
    steps = np.random.default_rng(seed)
    state, done = before, 0
    doing = "waiting"
    for line in lines:
        kind, _, name = line.partition(" ")
        if kind == "begin":
            step = _next(steps, state, seed, done, path)
            assert step.name == name
            doing, following = step.name, step.expected(state)
        else:
            state, done, doing = following, done + 1, "waiting"
    if doing == "waiting":
        return doing, [state]
    return doing.split()[0], [state, following]


def _next(random: np.random.Generator, state: State, seed: int, number: int, path: Path):  # type: ignore[no-untyped-def]
    if random.random() < 0.15:
        return merge(path.with_name("copy.gpkg"))
    return random_step(random, state, seed * 1000 + number)


def _write_on(path: Path, state: State, seed: int, pipe: int, small: bool) -> None:
    if small:
        opened = database.connect

        def connect(*arguments, **options):  # type: ignore[no-untyped-def]
            connection = opened(*arguments, **options)
            connection.execute("PRAGMA cache_size = 8")
            return connection

        import fieldgrid.maps.file.store as store

        store.connect = connect  # type: ignore[attr-defined]
    random, number = np.random.default_rng(seed), 0
    while True:
        step = _next(random, state, seed, number, path)
        os.write(pipe, f"begin {step.name}\n".encode())
        step.run(path)
        os.write(pipe, b"done\n")
        state, number = step.expected(state), number + 1


def main() -> None:
    """Run as a program."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 250
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        hit = run_kills(count, seed, Path(folder))
    half_way = sum(n for what, n in hit.items() if what != "waiting")
    print(f"{count} kills in {time.perf_counter() - start:.0f} s, {half_way} within an operation:")
    print("  " + ", ".join(f"{what} {n}" for what, n in hit.most_common()))
    print("  every map verified, every acknowledged step was there")


if __name__ == "__main__":
    main()
