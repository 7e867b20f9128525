"""A target under atheris: `python -m fuzz.guided NAME` and libFuzzer's arguments."""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["fieldgrid"]):
    from fuzz.targets import TARGETS


def main() -> None:
    target = next(target for target in TARGETS if target.name == sys.argv[1])

    def check(data: bytes) -> None:
        target.check(target.mend(data))

    atheris.Setup([sys.argv[0], *sys.argv[2:]], check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
