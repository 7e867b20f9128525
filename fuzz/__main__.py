"""`make fuzz`: every parser for a while, or some: `python -m fuzz nmea --seconds 60`.

Counts go on from run to run (build/fuzz/executions.json), so that many short runs make a long one.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import secrets
import sys
import tempfile
from pathlib import Path

from fuzz.run import FuzzError, Tally, limit_memory, run_atheris, run_mutants, try_input
from fuzz.target import Target
from fuzz.targets import TARGETS

_MEMORY = Path("/dev/shm")


def main() -> None:
    arguments = _arguments()
    wanted = [t for t in TARGETS if not arguments.targets or t.name in arguments.targets]
    if unknown := set(arguments.targets) - {target.name for target in TARGETS}:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}; there are: {_names()}")
    if _MEMORY.is_dir():
        tempfile.tempdir = str(_MEMORY)
        os.environ.setdefault("TMPDIR", str(_MEMORY))
    if not arguments.atheris and not arguments.replay:
        for target in wanted:  # what they import and compile is not the doing of an input
            target.check(target.seeds()[0])
        limit_memory(arguments.memory)
    tally = Tally()
    failed = [target.name for target in wanted if not _run(target, arguments, tally)]
    if not arguments.replay:
        print(f"{tally.total} inputs so far, of {len(tally.counts)} targets")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def _run(target: Target, arguments: argparse.Namespace, tally: Tally) -> bool:
    try:
        if arguments.replay:
            try_input(target, arguments.replay.read_bytes())
            print(f"{target.name}: {arguments.replay} passes")
            return True
        guided = ", guided" if arguments.atheris else ""
        print(f"{target.name}: seed {arguments.seed}{guided}", end="", flush=True)
        count = _tried(target, arguments)
        if count is None:
            return False
        tally.add(target, count)
        print(f", {count} inputs, no failure; {tally.counts[target.name]} so far", flush=True)
    except FuzzError as problem:
        print(f"\n{problem}")
        return False
    return True


def _tried(target: Target, arguments: argparse.Namespace) -> int | None:
    if arguments.atheris:
        return run_atheris(target, arguments.seed, arguments.seconds, arguments.memory)
    with _quiet():
        return run_mutants(target, arguments.seed, most=arguments.count, seconds=arguments.seconds)


class _quiet:  # noqa: N801 - used like a function
    """Keeps what C libraries say of broken images off the terminal."""

    def __enter__(self) -> None:
        self._kept = os.dup(2)
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 2)
        os.close(nothing)

    def __exit__(self, *_: object) -> None:
        os.dup2(self._kept, 2)
        os.close(self._kept)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {_names()}; all of them")
    parser.add_argument("--seconds", type=int, default=30, help="for each target (30)")
    parser.add_argument("--count", type=int, help="inputs for each target, instead of a time")
    parser.add_argument("--seed", type=int, default=secrets.randbits(31), help="default: another")
    parser.add_argument("--memory", type=int, default=1024, help="MiB beyond the start (1024)")
    parser.add_argument("--replay", type=Path, metavar="FILE", help="try this one input")
    engine = parser.add_mutually_exclusive_group()
    available = importlib.util.find_spec("atheris") is not None
    engine.add_argument("--atheris", action="store_true", default=available, help="if installed")
    engine.add_argument("--mutants", action="store_false", dest="atheris", help="our own mutants")
    return parser.parse_args()


def _names() -> str:
    return ", ".join(target.name for target in TARGETS)


if __name__ == "__main__":
    main()
