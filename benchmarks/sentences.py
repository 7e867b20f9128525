"""What made-up sentences of a receiver end with."""

from __future__ import annotations

from functools import reduce
from operator import xor


def checksum(text: bytes) -> int:
    """Of what lies between $ and *."""
    return reduce(xor, text, 0)
