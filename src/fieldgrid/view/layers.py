"""How each layer of a map looks: the range of its values, its unit, its colours.

A tile of any layer is a PNG of grey and alpha: grey is where the value lies on the layer's scale,
alpha 255 where the cell was observed. The page gives it colours, so that choosing others costs no
request.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Bool, UInt8, palette
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds, TileIndex, tile_window
from fieldgrid.maps import LAYERS, MEANING, Change, MapView, Readable, encode_png, layers_by_subject

_SAMPLE_CELLS = 1 << 18
"""About how many cells the range of a layer is found from."""


class Scale(NamedTuple):
    """The values that grey 0 and 255 stand for."""

    low: float
    high: float

    def grey(self, values: AnyArray) -> UInt8:
        """Values as grey; those beyond an end are drawn as the end, NaN as 0."""
        span = self.high - self.low or 1.0
        share = (values.astype(np.float64) - self.low) * (255.0 / span)
        found: UInt8 = np.nan_to_num(np.clip(np.rint(share), 0.0, 255.0)).astype(np.uint8)
        return found


_TITLES = {"max": "highest density", "peak": "highest cell", "seen_share": "share that was seen"}


def describe(name: str) -> dict[str, Any]:
    """What the page says of a layer, but for its scale."""
    layer = LAYERS[name]
    return {
        "name": name,
        "subject": next(key for key, names in layers_by_subject().items() if name in names),
        "title": _TITLES.get(name, name),
        "says": layer.meaning,
        "unit": "" if layer.unit == "1" else layer.unit,
        "ramp": [list(stop) for stop in layer.colours.ramp],
        "obstacle_above": OBSTACLE_ABOVE if layer.colours.ramp == palette.DENSITY else None,
    }


def describe_changes() -> list[dict[str, Any]]:
    """The kinds of change in the order of their numbers, with their colours."""
    return [
        {
            "name": kind.name.lower(),
            "says": MEANING[kind],
            "colour": palette.CHANGES[kind.name.lower()],
        }
        for kind in Change
    ]


def scale_of(universal: Readable, layer: str) -> Scale:
    """The range of a layer's values over the map, seen with coarse cells where it is large."""
    colours = LAYERS[layer].colours
    if colours.low is not None and colours.high is not None:
        return Scale(colours.low, colours.high)
    west_m, south_m, east_m, north_m = universal.bounds
    cells = (east_m - west_m) * (north_m - south_m) / universal.cell_m**2
    level = max(0, math.ceil(math.log2(max(cells, 1.0) / _SAMPLE_CELLS) / 2.0))
    view = universal.read(cell_m=universal.cell_m * 2**level, layers=[layer])
    values = view.layer(layer)
    values = values[view.observed & np.isfinite(values)]
    if values.size == 0:
        return Scale(0.0, 1.0)
    low = float(values.min()) if colours.low is None else colours.low
    high = float(values.max()) if colours.high is None else colours.high
    return Scale(low, max(high, low + 1e-9))


def tile_bounds(universal: Readable, level: int, tile: TileIndex) -> tuple[Bounds, float]:
    """The ground of a tile and the side of its cells; `level` 0 has the map's own."""
    cell_m, window = universal.cell_m * 2**level, tile_window(tile)
    side = 1.0 / cell_m
    bounds = Bounds(
        window.i0 / side,
        window.j0 / side,
        (window.i0 + window.width) / side,
        (window.j0 + window.height) / side,
    )
    return bounds, cell_m


def draw_layer(view: MapView, layer: str, scale: Scale) -> bytes | None:
    """The PNG of a view of a tile; None where nothing was observed."""
    if not view.observed.any():
        return None
    values = view.layer(layer)
    return encode(scale.grey(values), view.observed & np.isfinite(values))


def encode(grey: UInt8, seen: Bool) -> bytes:
    """Grey and alpha [rows, columns], row 0 in the south, as PNG, row 0 in the north."""
    return encode_png(grey * seen, seen)
