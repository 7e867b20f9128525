"""Values of options that are more than one number; what does not fit is a usage error."""

from __future__ import annotations

import re

import typer

from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Bounds

_NUMBER = r"[-+]?\d+(?:\.\d+)?"


def size(text: str | None) -> tuple[float, float] | None:
    """`WxL`, metres across and ahead, as in 6.65x14."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)", text)
    if not match:
        raise typer.BadParameter(f"{text!r} is not WIDTHxLENGTH in metres, as in 6.65x14")
    return float(match[1]), float(match[2])


def span(text: str | None) -> tuple[float, float] | None:
    """`LOW:HIGH` in metres, as in 0.2:2.2."""
    if text is None:
        return None
    match = re.fullmatch(rf"({_NUMBER}):({_NUMBER})", text)
    if not match:
        raise typer.BadParameter(f"{text!r} is not BOTTOM:TOP in metres, as in 0.2:2.2")
    return float(match[1]), float(match[2])


def datum(text: str | None) -> Datum | None:
    """`LAT,LON,HEIGHT`: degrees, degrees, ellipsoidal metres."""
    if text is None:
        return None
    match = re.fullmatch(rf"({_NUMBER}),({_NUMBER}),({_NUMBER})", text.replace(" ", ""))
    if not match:
        raise typer.BadParameter(f"{text!r} is not LAT,LON,HEIGHT, as in 41.65,-4.72,787.4")
    return Datum(float(match[1]), float(match[2]), float(match[3]))


def bounds(values: tuple[float, float, float, float] | None) -> Bounds | None:
    """West, south, east, north in metres."""
    return None if values is None else Bounds(*values)
