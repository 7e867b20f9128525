"""TOML and JSON that nobody vouches for, parsed within bounds."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from typing import Any

MAX_BYTES = 1 << 20
"""A settings file, a mounting or a description of a recording has some hundred lines."""

_TOO_DEEP = "it is nested too deeply"

# Comments and strings as TOML's grammar finds them, from the left; what stays are keys, numbers,
# brackets. What is open at the end is a string too, so that each sign is looked at once.
_TEXTS = re.compile(
    r"""#[^\n]*+"""
    r"""|\"{3}(?:\\.|[^\\"]|"(?!""))*+"{0,5}|'{3}.*?(?:'{3,5}|\Z)"""
    r"""|"(?:\\.|[^"\\\n])*+"?|'[^'\n]*+'?""",
    re.DOTALL,
)
_LONG_KEY = re.compile(r"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){32}")


def parse_toml(text: str, parse_float: Callable[[str], Any] = float) -> dict[str, Any]:
    """The tables of a TOML document. ValueError says why there are none.

    A key of many dots is refused before it is parsed, which takes memory by the square of them.
    """
    if _LONG_KEY.search(_TEXTS.sub("q", text)):
        raise ValueError(_TOO_DEEP)
    try:
        return tomllib.loads(text, parse_float=parse_float)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error


def parse_json(text: str | bytes, parse_float: Callable[[str], Any] = float) -> Any:
    """The value of a JSON document. ValueError says why there is none."""
    try:
        return json.loads(text, parse_float=parse_float)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
