"""A target under atheris: `python -m fuzz.guided NAME` and libFuzzer's arguments."""

from __future__ import annotations

import sys
from pathlib import Path

import atheris

import fieldgrid

_SOURCES = Path(fieldgrid.__file__).parent


def _with_kernels() -> list[str]:
    """The modules with loops that Numba compiles, which it does not once they are instrumented."""
    return [
        ".".join(("fieldgrid", *path.relative_to(_SOURCES).with_suffix("").parts))
        for path in _SOURCES.rglob("*.py")
        if "fieldgrid.core.kernels import" in path.read_text(encoding="utf-8")
    ]


with atheris.instrument_imports(include=["fieldgrid"], exclude=_with_kernels()):
    from fuzz.targets import TARGETS


def main() -> None:
    target = next(target for target in TARGETS if target.name == sys.argv[1])

    def check(data: bytes) -> None:
        target.check(target.mend(data))

    atheris.Setup([sys.argv[0], *sys.argv[2:]], check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
