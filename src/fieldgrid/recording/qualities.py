"""The quality of a fix as loggers write it, to GGA's codes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.array_types import Int64

# The first that occurs in the text decides, so that "RTK float" is not "RTK".
_WORDS: tuple[tuple[str, int], ...] = (
    (r"no[ _-]?(gps|gnss)?[ _-]?(fix|solution|position)|invalid|not[ _]available|unavailable", 0),
    (r"float|narrow_float|l1_float", 5),
    (r"dgps|dgnss|differential|diff|psrdiff", 2),
    (r"sbas|waas|egnos|omnistar", 9),
    (r"ppp|converg", 2),
    (r"dead|estimat|extrapolat|\bdr\b", 6),
    (r"simul", 8),
    (r"manual", 7),
    (r"pps|precise", 3),
    (r"[23] ?d", 1),
    (r"gps[ _-]?fix|gnss[ _-]?fix|^gps$|^gnss$", 1),
    (r"single|autonomous|\bsps\b|stand-?alone", 1),
    (r"fix|rtk|integer|narrow_int|\bint\b|^r$", 4),
    (r"^none$|^0$|^no$", 0),
)
_PATTERNS = tuple((re.compile(pattern), quality) for pattern, quality in _WORDS)
_CENTIMETRES_M, _DECIMETRES_M = 0.05, 0.5
_NOT_AVAILABLE = 15  # ISO 11783-10: the receiver does not say


class Qualities(NamedTuple):
    """Qualities of a column, and the texts that could not be understood (taken as 1)."""

    codes: list[int]
    unknown: tuple[str, ...] = ()


def read_qualities(cells: Sequence[str], numbers_are_gga: bool) -> Qualities:
    """GGA's codes of numbers or of words like "RTK Fixed"; of a list, the lowest that it names.

    `numbers_are_gga` is false for columns whose numbers mean something else everywhere.
    """
    known = {cell: _one(cell.strip().lower(), numbers_are_gga) for cell in set(cells)}
    unknown = tuple(sorted(cell for cell, code in known.items() if code is None))
    codes = {cell: 1 if code is None else code for cell, code in known.items()}
    return Qualities([codes[cell] for cell in cells], unknown)


def _one(text: str, numbers_are_gga: bool) -> int | None:
    items = [item.strip(" '\"") for item in text.strip("[]()").split(",")]
    if len(items) > 1:
        codes = [_one(item, numbers_are_gga) for item in items if item]
        return min((c for c in codes if c is not None), key=_worth, default=None)
    text = items[0]
    if re.fullmatch(r"\d{1,2}(?:\.0*)?", text, re.ASCII):
        code = int(float(text))
        return code if numbers_are_gga and code <= 9 else None
    if not text or text == "nan":
        return 0
    return next((quality for pattern, quality in _PATTERNS if pattern.search(text)), None)


def _worth(code: int) -> int:
    """How good a quality is, worst first."""
    order = (0, 7, 8, 6, 1, 9, 2, 3, 5, 4)
    return order.index(code)


def from_position_status(status: int) -> int:
    """GGA's code of an ISO 11783-10 position status; 1 where the receiver does not say."""
    if status == _NOT_AVAILABLE:
        return 1
    return status if status <= 8 else 0


def by_sigma(sigma_m: npt.ArrayLike) -> Int64:
    """GGA's codes by the error that the receiver states, 1 where that is nothing above 0:
    centimetres need carrier phases."""
    sigma = np.asarray(sigma_m, dtype=np.float64)
    codes = np.where(sigma <= _CENTIMETRES_M, 4, np.where(sigma <= _DECIMETRES_M, 5, 1))
    return np.where(sigma > 0.0, codes, 1).astype(np.int64)
