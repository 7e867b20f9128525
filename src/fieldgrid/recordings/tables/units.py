"""Units, in the names of columns and in cells: one table of what each is worth."""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import NamedTuple

_KNOT_MPS = 1852 / 3600
_US_FOOT_M = 1200 / 3937
GRAVITY_MPS2 = 9.80665
"""The standard gravity, 1 g."""

UNITS: dict[str, dict[str, float]] = {
    "": {},
    "speed": {
        "mps": 1.0, "m_s": 1.0, "mmps": 1e-3, "mm_s": 1e-3, "cm_s": 1e-2,
        "kmh": 1 / 3.6, "km_h": 1 / 3.6, "kph": 1 / 3.6, "mph": 0.44704,
        "knots": _KNOT_MPS, "knot": _KNOT_MPS, "kn": _KNOT_MPS, "kts": _KNOT_MPS,
    },
    "length": {
        "m": 1.0, "mm": 1e-3, "cm": 1e-2, "metres": 1.0, "meters": 1.0,
        "ft": 0.3048, "feet": 0.3048, "foot": 0.3048,
        "us_ft": _US_FOOT_M, "usft": _US_FOOT_M, "ftus": _US_FOOT_M,
        "us_survey_ft": _US_FOOT_M, "us_survey_feet": _US_FOOT_M,
    },
    "angle": {
        "deg": 1.0, "degrees": 1.0, "rad": 180.0 / math.pi, "radians": 180.0 / math.pi, "e7": 1e-7,
    },
    "rate": {
        "rad_s": 1.0, "radps": 1.0, "rad_s_1": 1.0,
        "deg_s": math.radians(1.0), "degps": math.radians(1.0), "dps": math.radians(1.0),
    },
    "force": {"m_s2": 1.0, "mps2": 1.0, "m_s_2": 1.0, "g": GRAVITY_MPS2},
}  # fmt: skip
"""By quantity, the unit as names of columns have it and its worth: metres a second, metres,
degrees, radians a second, metres a second squared. '' is a number without a unit."""

_LONGEST_FIRST = sorted((unit for units in UNITS.values() for unit in units), key=len, reverse=True)
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z][a-z])")
_NO_WORD = re.compile(r"[^a-z0-9]+")
_BEFORE_UNIT = re.compile(r"(.+)_(?:(\d+)p(\d+))?")
# Bounded, since the parts of the pattern can share what is between them.
_WITH_UNIT = re.compile(r"([+-]?\d{1,20}(?:\.\d{0,20})?)\s{0,9}([A-Za-z][A-Za-z .]{0,30}?)\.?")


class ColumnName(NamedTuple):
    """A column's name taken apart: words without unit, the unit, and a factor before it."""

    base: str
    unit: str = ""
    factor: float = 1.0

    def worth(self, quantity: str) -> float:
        """The worth of 1 in this column, of a quantity in `UNITS`; 1 without a unit of it."""
        return self.factor * UNITS[quantity].get(self.unit, 1.0)


@lru_cache(1 << 13)
def take_apart(name: str) -> ColumnName:
    """The words of a column name: ``Speed [km/h]`` is speed in km_h, ``up_0p1mm`` up in 0.1 mm."""
    plain = _NO_WORD.sub("_", _CAMEL.sub("_", name).lower()).strip("_")
    for unit in _LONGEST_FIRST:
        match = _BEFORE_UNIT.fullmatch(plain.removesuffix(unit)) if plain.endswith(unit) else None
        if match is not None:
            factor = float(f"{match[2]}.{match[3]}") if match[2] else 1.0
            return ColumnName(match[1], unit, factor)
    return ColumnName(plain)


def metres(cell: str) -> float | None:
    """The length of a cell that has its unit with it, like 2625.5 ft; None of another."""
    match = _WITH_UNIT.fullmatch(cell.strip())
    unit = "" if match is None else re.sub(r"[ .]+", "_", match[2].lower())
    known = UNITS["length"]
    return None if match is None or unit not in known else float(match[1]) * known[unit]
