"""A planting as features, for every format that `geometry.shapes.vectors` writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fieldgrid.core import ConfigError
from fieldgrid.field.rows.formats.graph import write_graph
from fieldgrid.field.rows.formats.lanelet2 import write_lanelet2
from fieldgrid.field.rows.network import network_of
from fieldgrid.field.rows.result import Block, Gap, Headland, Lane, Obstacle, Planting
from fieldgrid.geometry import FEATURE_SUFFIXES, Feature, write_features

_NETWORKS = {".graph.geojson": write_graph, ".osm": write_lanelet2}
_MAX_LIMIT_KMH = 200.0

_ENDS = {
    (True, True): "both", (True, False): "start", (False, True): "stop", (False, False): "none",
}  # fmt: skip


def planting_features(planting: Planting) -> list[Feature]:
    """Blocks, headlands, lanes, rows, gaps and obstacles, in this order: later ones lie on top."""
    return [
        *(
            Feature(
                "block",
                b.area,
                {
                    "id": b.id, "rows": b.rows, "lanes": b.lanes, "heading_deg": b.heading_deg,
                    "spacing_m": b.spacing_m, "area_m2": float(b.area.area), **_rests_on(b),
                },
            )
            for b in planting.blocks
        ),
        *(
            Feature(
                "headland",
                h.area,
                {"id": h.id, "block": h.block, "end": h.end, "area_m2": h.area_m2, **_rests_on(h)},
            )
            for h in planting.headlands
        ),
        *(
            Feature(
                "lane",
                lane.line,
                {
                    "id": lane.id, "block": lane.block, "rows": lane.rows,
                    "length_m": lane.length_m, "free_width_m": lane.free_width_m,
                    "clear_width_m": lane.clear_width_m, "clear_sigma_m": lane.clear_sigma_m,
                    "known": lane.known, "driven": lane.driven, **_rests_on(lane),
                },
            )
            for lane in planting.lanes
        ),
        *(
            Feature(
                "row",
                r.line,
                {
                    "id": r.id, "block": r.block, "length_m": r.length_m, "sigma_m": r.sigma_m,
                    "spacing_m": r.spacing_m, "half_width_m": r.half_width_m, "sides": r.sides,
                    "known": r.known, "ends_seen": _ENDS[r.ends_seen], "cells": r.cells,
                    "sessions": r.sessions,
                },
            )
            for r in planting.rows
        ),
        *(
            Feature(
                "gap",
                g.line,
                {"id": g.id, "row": g.row, "length_m": g.length_m, **_rests_on(g)},
            )
            for g in planting.gaps
        ),
        *(
            Feature(
                "obstacle",
                o.area,
                {
                    "id": o.id, "lane": o.lane or None, "row": o.row or None,
                    "area_m2": o.area_m2, **_rests_on(o),
                },
            )
            for o in planting.obstacles
        ),
    ]  # fmt: skip


def _rests_on(found: Block | Gap | Headland | Lane | Obstacle) -> dict[str, Any]:
    """How sure its place is, and what it was found from."""
    return {"sigma_m": found.sigma_m, "cells": found.cells, "sessions": found.sessions}


def _ending(path: Path) -> str:
    name = path.name.lower()
    return next((ending for ending in _NETWORKS if name.endswith(ending)), path.suffix.lower())


def check_rows_target(path: Path, speed_limit_kmh: float | None = None) -> None:
    """Raise ConfigError for a name that is none of a planting, a speed limit that no road has, and
    one for a file that cannot hold it."""
    ending = _ending(path)
    known = (*FEATURE_SUFFIXES, *_NETWORKS)
    if ending not in known:
        raise ConfigError(f"{path.name} ends in none of {', '.join(known)}; choose one of them.")
    if speed_limit_kmh is None:
        return
    if ending not in _NETWORKS:
        raise ConfigError(
            f"A speed limit is for networks, and {path.name} ends in none of "
            f"{', '.join(_NETWORKS)}."
        )
    if not 0.0 < speed_limit_kmh <= _MAX_LIMIT_KMH:
        raise ConfigError(
            f"A speed limit of {speed_limit_kmh:g} km/h is outside 0..{_MAX_LIMIT_KMH:g} km/h."
        )


def write_planting(
    planting: Planting, path: Path, *, speed_limit_kmh: float | None = None, overwrite: bool = False
) -> None:
    """Write a planting as .geojson, .gpkg, .csv, .kml or .dxf, by the ending of `path`, with the
    strips of headlands as kind `turn`; its network as .osm for Lanelet2 or as .graph.geojson for
    Nav2, with a speed limit where one is given. ConfigError is as `check_rows_target` says."""
    check_rows_target(path, speed_limit_kmh)
    network, write_network = network_of(planting), _NETWORKS.get(_ending(path))
    if write_network is not None:
        write_network(network, path, speed_limit_kmh=speed_limit_kmh, overwrite=overwrite)
        return
    turns = [
        Feature(
            "turn",
            strip.line,
            {
                "id": strip.id, "length_m": float(strip.line.length), "width_m": strip.width_m,
                "clearance_m": strip.clearance_m, "known": strip.known,
                "obstacles": list(strip.obstacles),
            },
        )
        for strip in network.strips
        if not strip.lane
    ]  # fmt: skip
    found = [*planting_features(planting), *turns]
    write_features(path, found, planting.datum, overwrite=overwrite)
