"""How much an input may unfold to. Every reader asks, while it unfolds what it reads.

Packed data of some kilobytes can be made to unfold to any size, and a short text to any number of
rows. The limits are far beyond what recordings need. Each can be set by an environment variable
(`FIELDGRID_LIMIT_FACTOR=1000`) or for a block of Python (:func:`limited`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace

from fieldgrid.errors import ConfigError, LimitError

PREFIX = "FIELDGRID_LIMIT_"


@dataclass(frozen=True, slots=True)
class Limits:
    """An input may unfold to `factor` times its size on the disk, and to `free_mib` in any case.

    No chunk, message, image or other piece that is in memory at once may exceed `piece_mib`.
    A table or log may have `rows`.
    """

    factor: int = 200
    free_mib: int = 64
    piece_mib: int = 128
    rows: int = 10_000_000

    @property
    def piece_bytes(self) -> int:
        """The most that is in memory at once."""
        return self.piece_mib << 20

    def unfolded_bytes(self, packed_bytes: int) -> int:
        """What an input of this size on the disk may unfold to."""
        return max(self.factor * packed_bytes, self.free_mib << 20)


def _from_environment() -> Limits:
    found = {}
    for field in fields(Limits):
        name = PREFIX + field.name.upper()
        text = os.environ.get(name)
        if text is not None:
            if not (text.isdecimal() and len(text) < 12 and int(text) > 0):
                raise ConfigError(f"{name} is {text[:40]!r}; give a whole number above 0.")
            found[field.name] = int(text)
    return Limits(**found)


_current: list[Limits] = []


def limits() -> Limits:
    """The limits in force."""
    if not _current:
        _current.append(_from_environment())
    return _current[-1]


@contextmanager
def limited(**changes: int) -> Iterator[Limits]:
    """Other limits for a block, in all threads: `limited(factor=1000)`."""
    _current.append(replace(limits(), **changes))
    try:
        yield _current[-1]
    finally:
        _current.pop()


class Budget:
    """What one input may still unfold to."""

    def __init__(self, name: object, packed_bytes: int) -> None:
        self._name, self._packed_bytes = name, packed_bytes
        self._left = limits().unfolded_bytes(packed_bytes)

    def spend(self, count: int) -> None:
        """Count unfolded bytes. Raises LimitError beyond the limit."""
        self._left -= count
        if self._left < 0:
            most = limits().unfolded_bytes(self._packed_bytes)
            raise LimitError(
                f"{self._name} has {self._packed_bytes} bytes and unfolds to more than "
                f"{most >> 20} MiB, so it is damaged or was made to do harm; if it is right, set "
                f"{PREFIX}FACTOR={4 * limits().factor} and try again."
            )


def check_rows(count: int, name: object) -> None:
    """Raise LimitError for a table or log of more rows than it may have."""
    if count > limits().rows:
        raise LimitError(
            f"{name} has more than {limits().rows} rows; cut it into drives, or set "
            f"{PREFIX}ROWS={4 * limits().rows} and try again."
        )
