"""`make fuzz`: every parser for a while, or some: `python -m fuzz nmea --seconds 60`."""

from __future__ import annotations

import argparse
import importlib.util
import secrets
import sys
from pathlib import Path

from fuzz.run import FuzzError, run_atheris, run_mutants, try_input
from fuzz.target import Target
from fuzz.targets import TARGETS


def main() -> None:
    arguments = _arguments()
    wanted = [t for t in TARGETS if not arguments.targets or t.name in arguments.targets]
    if unknown := set(arguments.targets) - {target.name for target in TARGETS}:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}; there are: {_names()}")
    failed = [target.name for target in wanted if not _run(target, arguments)]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def _run(target: Target, arguments: argparse.Namespace) -> bool:
    try:
        if arguments.replay:
            try_input(target, arguments.replay.read_bytes())
            print(f"{target.name}: {arguments.replay} passes")
        elif arguments.atheris:
            print(f"{target.name}: atheris, seed {arguments.seed}", flush=True)
            return run_atheris(target, arguments.seed, arguments.seconds)
        else:
            print(f"{target.name}: seed {arguments.seed}", end="", flush=True)
            tried = run_mutants(target, arguments.seed, seconds=arguments.seconds)
            print(f", {tried} inputs in {arguments.seconds} s, no failure")
    except FuzzError as problem:
        print(f"\n{problem}")
        return False
    return True


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {_names()}; all of them")
    parser.add_argument("--seconds", type=int, default=30, help="for each target (30)")
    parser.add_argument("--seed", type=int, default=secrets.randbits(31), help="default: another")
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
