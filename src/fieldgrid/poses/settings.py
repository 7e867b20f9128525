"""Where headings come from."""

from __future__ import annotations

import re
from typing import NamedTuple

from fieldgrid.core import ConfigError, quoted
from fieldgrid.geometry import wrap_deg


class HeadingSource(NamedTuple):
    """`kind` is smooth, course, recorded or constant; `constant_deg` belongs to the last."""

    kind: str
    constant_deg: float = 0.0

    def __str__(self) -> str:
        return f"constant:{self.constant_deg:g}" if self.kind == "constant" else self.kind


def heading_source(text: str) -> HeadingSource:
    """Parse smooth | course | recorded | constant:DEG."""
    if text in ("smooth", "course", "recorded"):
        return HeadingSource(text)
    match = re.fullmatch(r"constant:([-+]?\d+(?:\.\d+)?)", text)
    if not match or not -360.0 <= float(match[1]) <= 360.0:
        raise ConfigError(
            f"Heading source {quoted(text)} is none of smooth, course, recorded, constant:DEG "
            "(degrees clockwise from north, as in constant:-100)."
        )
    return HeadingSource("constant", float(wrap_deg(float(match[1]))))
