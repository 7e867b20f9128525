"""How much an input may unfold to. Every reader asks, while it unfolds what it reads.

Packed data of some kilobytes can be made to unfold to any size, and a short text to any number of
rows. The limits are far beyond what recordings need. Each can be set by an environment variable
(`FIELDGRID_LIMIT_FACTOR=1000`) or for a block of Python (:func:`limited`).
"""

from __future__ import annotations

import errno
import io
import math
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TextIO, TypeVar

from fieldgrid.core.errors import ConfigError, FieldgridError, LimitError, quoted

PREFIX = "FIELDGRID_LIMIT_"

_Row = TypeVar("_Row")

_READ_CHARACTERS = 1 << 16


@dataclass(frozen=True, slots=True)
class Limits:
    """An input may unfold to `factor` times its size on the disk, and to `free_mib` in any case.

    No chunk, message, image or other piece that is in memory at once may exceed `piece_mib`.
    A table or log may have `rows`, and none of its lines more than `line_kib`. A packed log may
    unfold to `log_factor` times its size, and to `free_mib` in any case. A document that is parsed
    as a whole, like GeoJSON, may have `document_mib`.
    """

    factor: int = 200
    free_mib: int = 64
    piece_mib: int = 128
    rows: int = 10_000_000
    line_kib: int = 1024
    log_factor: int = 50
    document_mib: int = 16

    @property
    def piece_bytes(self) -> int:
        """The most that is in memory at once."""
        return self.piece_mib << 20


def _from_environment() -> Limits:
    found = {}
    for field in fields(Limits):
        name = PREFIX + field.name.upper()
        text = os.environ.get(name)
        if text is not None:
            if not (text.isdecimal() and len(text) < 12 and int(text) > 0):
                raise ConfigError(f"{name} is {quoted(text)}; give a whole number above 0.")
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


def file_bytes(path: Path) -> int:
    """The size of a file. OSError for what is missing, a folder, and a pipe or a device: one that
    nobody writes to would be waited for, and another one may never end."""
    found = path.stat()
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, and not a file", str(path))
    return found.st_size


class UnfoldBudget:
    """What one input may still unfold to."""

    def __init__(self, name: object, packed_bytes: int, *, is_log: bool = False) -> None:
        self._name, self._packed_bytes = name, packed_bytes
        now = limits()
        self._variable = "LOG_FACTOR" if is_log else "FACTOR"
        self._factor = now.log_factor if is_log else now.factor
        self._left = self._most = max(self._factor * packed_bytes, now.free_mib << 20)

    def spend(self, count: int) -> None:
        """Count unfolded bytes. Raises LimitError beyond the limit."""
        self._left -= count
        if self._left < 0:
            raise LimitError(
                f"{self._name} has {self._packed_bytes} bytes and unfolds to more than "
                f"{self._most >> 20} MiB, so it is damaged or was made to do harm; if it is right, "
                f"set {PREFIX}{self._variable}={4 * self._factor} and try again."
            )


def check_rows(count: int, name: object) -> None:
    """Raise LimitError for a table or log of more rows than it may have."""
    if count > limits().rows:
        raise LimitError(
            f"{name} has more than {limits().rows} rows; cut it into drives, or set "
            f"{PREFIX}ROWS={4 * limits().rows} and try again."
        )


def counted_rows(rows: Iterable[_Row], name: object) -> Iterator[_Row]:
    """The rows of a table or log, up to as many as it may have."""
    for count, row in enumerate(rows, start=1):
        check_rows(count, name)
        yield row


def bounded_lines(file: TextIO, name: object, *, without: str = "") -> Iterator[str]:
    """The lines of a text with their ends, as iterating over it gives them, `without` one
    character; LimitError for one that no table or log has, before it is in memory."""
    for text in _whole_lines(file, name):
        # A text in memory gives its lines much faster than a file does.
        yield from io.StringIO(text.replace(without, "") if without else text, newline="")


def _whole_lines(file: TextIO, name: object) -> Iterator[str]:
    """A text in pieces that end where a line does."""
    most = limits().line_kib << 10
    while text := file.read(min(most, _READ_CHARACTERS)):
        last = max(text.rfind("\n"), text.rfind("\r")) + 1
        text += file.readline(most + 1)
        if len(text) - last > most:
            raise LimitError(
                f"{name} has a line of more than {most >> 10} KiB, so it is no table or log; "
                f"check the file, or set {PREFIX}LINE_KIB={4 * (most >> 10)} and try again."
            )
        yield text


def check_document(size_bytes: int, name: object, error: type[FieldgridError]) -> None:
    """Raise `error` for a document, like GeoJSON, that is too large to be parsed as a whole."""
    most = limits().document_mib
    if size_bytes > most << 20:
        raise error(
            f"{name} has {size_bytes >> 20} MiB, more than the {most} that are read at once; cut "
            f"it to what is needed, or set {PREFIX}DOCUMENT_MIB={4 * most} and try again."
        )


def check_local_grid(width_m: float, length_m: float, cell_m: float) -> None:
    """Raise ConfigError for a local grid that is too large, or no whole number of cells."""
    if not 0.01 <= cell_m <= 5.0:
        raise ConfigError(f"A local cell of {cell_m} m is outside 0.01..5 m; 0.05 is the paper's.")
    for name, value in (("width", width_m), ("length", length_m)):
        if not (math.isfinite(value) and cell_m <= value <= 200.0):
            raise ConfigError(
                f"A local grid's {name} of {value} m is outside {cell_m}..200 m; "
                "6.65 x 14 and 10 x 15 are usual."
            )
        if abs(value / cell_m - round(value / cell_m)) > 1e-6:
            raise ConfigError(
                f"A local grid's {name} of {value} m is not a whole number of cells of "
                f"{cell_m} m; change one of them."
            )
    across, ahead = round(width_m / cell_m), round(length_m / cell_m)
    if across * ahead > 4_000_000:
        raise ConfigError(
            f"A local grid of {across} x {ahead} cells is over 4 million cells; "
            "take larger cells or a smaller grid."
        )
