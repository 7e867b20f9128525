"""How values look in a notebook: tables as HTML, paths as SVG, cells as PNG; without matplotlib."""

from __future__ import annotations

import io
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from fieldgrid.core.array_types import Bool, Float64, UInt8
from fieldgrid.core.palette import UNSEEN, Ramp, rgb

_LONG_SIDE_PX = 480
_MOST_POINTS = 2000
"""Number of points of all lines of a drawing together."""

_MOST_PX = 1024


class Line(NamedTuple):
    """A line to be drawn: its colour (`#rrggbb`), metres east and north [n]."""

    colour: str
    east_m: Float64
    north_m: Float64


def table(rows: Sequence[Sequence[str]], header: Sequence[str] = ()) -> str:
    """An HTML table of text."""

    def row(cells: Sequence[str], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

    head = f"<thead>{row(header, 'th')}</thead>" if header else ""
    return f"<table>{head}<tbody>{''.join(row(one, 'td') for one in rows)}</tbody></table>"


def drawing(lines: Sequence[Line]) -> str:
    """Lines as SVG, north up and to scale; empty text where there is nothing to draw."""
    known = [
        (colour, np.column_stack((east_m, north_m))[np.isfinite(east_m) & np.isfinite(north_m)])
        for colour, east_m, north_m in lines
    ]
    known = [(colour, points) for colour, points in known if len(points) > 1]
    if not known:
        return ""
    every = np.concatenate([points for _, points in known])
    low, size = every.min(axis=0), np.ptp(every, axis=0)
    scale = (_LONG_SIDE_PX - 16) / max(float(size.max()), 1e-9)
    width, height = (16 + size * scale).tolist()
    step = -(-len(every) // _MOST_POINTS)
    parts = []
    for colour, points in known:
        kept = np.concatenate((points[:-1:step], points[-1:]))
        x, y = ((kept - low) * scale + 8).T
        text = " ".join(f"{a:.1f},{height - b:.1f}" for a, b in zip(x, y, strict=True))
        parts.append(f'<polyline points="{text}" stroke="{colour}" fill="none" stroke-width="2"/>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}">'
        f"{''.join(parts)}</svg>"
    )


def picture(values: UInt8, known: Bool, ramp: Ramp) -> bytes:
    """A PNG of cells [rows north, columns east], row 0 in the south, in the colours of a ramp.

    Where there are more cells than pixels, a pixel has the highest value under it, so that no
    obstacle is lost.
    """
    step = -(-max(values.shape) // _MOST_PX)
    if step > 1:
        starts = [np.arange(0, count, step) for count in values.shape]
        values = np.where(known, values, 0)
        for axis in (0, 1):
            values = np.maximum.reduceat(values, starts[axis], axis=axis)
            known = np.logical_or.reduceat(known, starts[axis], axis=axis)
    from PIL import Image

    shares = [stop.share for stop in ramp]
    colours = np.array([rgb(stop.colour) for stop in ramp], dtype=np.float64)
    steps = np.arange(256) / 255.0
    palette = np.stack([np.interp(steps, shares, band) for band in colours.T], axis=1)
    pixels = np.rint(palette).astype(np.uint8)[values]
    pixels[~known] = rgb(UNSEEN)
    written = io.BytesIO()
    Image.fromarray(pixels[::-1]).save(written, "PNG")
    return written.getvalue()
