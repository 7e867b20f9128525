"""A network as a graph of Nav2's route server: GeoJSON in metres of the frame `map`.

Edges are straight and lead one way: a strip is a chain of them in either direction.
"""

from __future__ import annotations

import itertools
import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import ConfigError, mentions, replacing
from fieldgrid.field.rows.network import LaneNetwork, NetworkStrip

_NAME = "fieldgrid route graph"
_KMH = 3.6
_TOLERANCE_M = 0.02


def write_graph(
    network: LaneNetwork,
    path: Path,
    *,
    speed_limit_kmh: float | None = None,
    overwrite: bool = False,
) -> None:
    """Write the strips of a network as edges, both ways; an edge costs its length.

    Its metadata are `lane`, `strip`, `width_m`, `clearance_m`, `known`, `obstacles` and `penalty`,
    the metres of it that were not seen; with a speed limit `abs_speed_limit` in m/s. Numbers have a
    decimal point, as the readers of Nav2 expect them. ConfigError without lanes, MapExistsError for
    a file that may not be overwritten, MapWriteError where it cannot be written.
    """
    if not network.strips:
        raise ConfigError("A route graph needs lanes, and none was found; see --crop.")
    places = network.places_m.round(4).tolist()
    edges: list[tuple[int, int, dict[str, Any]]] = []
    for strip in network.strips:
        inner = np.asarray(strip.line.simplify(_TOLERANCE_M).coords)[1:-1, :2].round(4).tolist()
        first, last = strip.ends
        chain = [first, *range(len(places), len(places) + len(inner)), last]
        places += inner
        about = _about(strip)
        if speed_limit_kmh is not None:
            about["abs_speed_limit"] = speed_limit_kmh / _KMH
        for a, b in itertools.pairwise(chain):
            edges += [(a, b, about), (b, a, about)]
    datum = network.planting.datum
    graph = {
        "type": "FeatureCollection",
        "name": _NAME,
        "datum": {
            "lat_deg": datum.lat_deg, "lon_deg": datum.lon_deg, "height_m": datum.height_m,
        },
        "features": [
            *(
                _feature("Point", place, {"id": number, "frame": "map"})
                for number, place in enumerate(places)
            ),
            *(
                _edge(number, a, b, [places[a], places[b]], about)
                for number, (a, b, about) in enumerate(edges, len(places))
            ),
        ],
    }  # fmt: skip
    ours = partial(mentions, mark=f'"name": "{_NAME}"'.encode())
    with replacing(path, overwrite=overwrite, ours=ours, what="a route graph") as draft:
        draft.write_text(json.dumps(graph, indent=1), encoding="utf-8")


def _about(strip: NetworkStrip) -> dict[str, Any]:
    """What is known of a strip; numbers that are not known are left out."""
    unseen_m = (1.0 - strip.known) * strip.line.length
    numbers = {
        "width_m": strip.width_m, "clearance_m": strip.clearance_m, "known": strip.known,
        "penalty": unseen_m,
    }  # fmt: skip
    return {
        "lane": strip.lane, "strip": strip.id, "obstacles": ",".join(strip.obstacles),
        **{key: round(value, 3) for key, value in numbers.items() if math.isfinite(value)},
    }  # fmt: skip


def _edge(
    number: int, start: int, stop: int, ends: list[list[float]], about: dict[str, Any]
) -> dict[str, Any]:
    cost = round(math.dist(*ends), 4)
    # Of edges that are not overridable Nav2 asks neither its costmap nor what was closed.
    ids = {"id": number, "startid": start, "endid": stop, "cost": cost, "overridable": True}
    return _feature("LineString", ends, {**ids, "metadata": about})


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }
