"""The network of lanes, and the graph of Nav2 that is made of it."""

from __future__ import annotations

import heapq
import itertools
import json
import math
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely

from benchmarks.planting import DATUM, Sight
from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.field import Planting, network_of, write_planting
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import Bounds
from tests.field.rows.fields import straight, view_of

QUIET = Sight(noise_per_m2=0.0, hole_share=0.0, margin_m=8.0, headland_m=6.0)


@cache
def two_blocks() -> Planting:
    """Five rows to the north-east, the third of them 6 m longer, and three others beyond a road of
    22 m; a thing stands in a lane and one on the headland."""
    rows = straight(5, 30.0, 2.6, 40.0)
    ahead = np.array([math.sin(math.radians(40.0)), math.cos(math.radians(40.0))])
    rows[2] = np.array([rows[2][0], rows[2][1] + 6.0 * ahead])
    rows += straight(3, 25.0, 2.6, 40.0, at=tuple(rows[0][1] + 22.0 * ahead))
    middle = 0.5 * (rows[0][0] + rows[1][1])
    before = 0.5 * (rows[0][0] + rows[1][0]) - 1.5 * ahead
    view = view_of(rows, QUIET, things=[(*middle, 0.3), (*before, 0.5)])
    return rows_of_view(view)


def test_strips_join_lanes_and_cross_no_row() -> None:
    planting = two_blocks()
    network = network_of(planting)
    assert (len(planting.blocks), len(planting.lanes)) == (2, 6)
    lanes = {strip.lane: strip for strip in network.strips if strip.lane}
    assert set(lanes) == {lane.id for lane in planting.lanes}
    rows = shapely.union_all([row.line for row in planting.rows])
    places = network.places_m
    for strip in network.strips:
        assert not strip.line.crosses(rows)
        ends = np.asarray(strip.line.coords)[[0, -1], :2]
        assert np.hypot(*(ends - places[list(strip.ends)]).T).max() < 0.2
        assert strip.area.is_valid
        sides = network.sides_m[list(strip.ends)]
        for place, bound in enumerate((strip.left, strip.right)):
            mine = [side[place ^ turned] for side, turned in zip(sides, strip.turned, strict=True)]
            assert np.allclose(np.asarray(bound.coords)[[0, -1], :2], mine, atol=1e-6)
        left, right = (one.interpolate(0.5, normalized=True) for one in (strip.left, strip.right))
        middle, ahead = strip.line.interpolate((0.5, 0.55), normalized=True)
        along = np.array([ahead.x - middle.x, ahead.y - middle.y])
        across = np.array([left.x - right.x, left.y - right.y])
        assert along[0] * across[1] - along[1] * across[0] > 0.0
    # Three strips at either end of each lane, and what joins the blocks.
    assert len(network.strips) == 7 * len(lanes) + sum("link" in s.id for s in network.strips)


def test_what_is_known_of_strips() -> None:
    """Things are named where they stand, clearances are true, what was not seen is not known."""
    planting = two_blocks()
    network = network_of(planting)
    things = {thing.id: thing.area for thing in planting.obstacles}
    assert len(things) == 2
    named = {name for strip in network.strips for name in strip.obstacles}
    assert named == set(things)
    (crossed,) = [s for s in network.strips if s.lane and s.obstacles]
    lane = planting.lane(crossed.lane)
    assert lane is not None
    assert lane.area.intersects(things[crossed.obstacles[0]])
    assert crossed.clearance_m < 0.8
    free = [s for s in network.strips if s.lane and not s.obstacles]
    for strip in free:
        # From the middle of a lane to the faces of rows 2.6 m apart.
        assert strip.clearance_m == pytest.approx(1.3 - 0.35, abs=0.15)
        assert strip.known > 0.95
    start = [s for s in network.strips if s.id == "B1-L3-start"]
    assert [s.known > 0.95 for s in start] == [True]
    rows = straight(4, 20.0, 2.5)
    unseen = (Bounds(-10.0, -20.0, 20.0, -0.2),)
    half = rows_of_view(view_of(rows, Sight(**{**vars(QUIET), "unseen": unseen})))
    by_end = {
        end: [s.known for s in network_of(half).strips if s.id.endswith(f"-{end}")]
        for end in ("start", "stop")
    }
    assert max(by_end["start"]) < 0.35
    assert min(by_end["stop"]) > 0.9


class Edge(NamedTuple):
    number: int
    start: int
    stop: int
    cost: float
    metadata: dict[str, Any]


def as_nav2_reads(path: Path) -> tuple[dict[int, tuple[float, float]], list[Edge]]:
    """Nodes and edges as `GeoJsonGraphFileLoader` of nav2_route takes them, and no more: ids are
    unsigned, coordinates numbers in the frame, an edge's nodes exist. Metadata are strings, truth
    values or numbers, and scorers read only numbers with a decimal point (`any_cast<float>`)."""
    content = json.loads(path.read_text())
    nodes, edges = {}, []
    for feature in content["features"]:
        properties, shape = feature["properties"], feature["geometry"]
        if shape["type"] == "Point":
            assert properties["frame"] == "map"
            x, y = shape["coordinates"]
            assert isinstance(x, float)
            assert isinstance(y, float)
            nodes[properties["id"]] = (x, y)
        elif shape["type"] in ("LineString", "MultiLineString"):
            assert properties["overridable"] is True
            for value in properties["metadata"].values():
                assert isinstance(value, float | str)
            edges.append(
                Edge(properties["id"], properties["startid"], properties["endid"],
                     properties["cost"], properties["metadata"])
            )  # fmt: skip
            assert shape["coordinates"] == [list(nodes[k]) for k in edges[-1][1:3]]
    ids = [*nodes, *(edge.number for edge in edges)]
    assert len(set(ids)) == len(ids) == len(content["features"])
    assert all(isinstance(number, int) and number >= 0 for number in ids)
    return nodes, edges


def cheapest(edges: list[Edge], start: int) -> dict[int, float]:
    """The cost to each node that can be reached, as `RoutePlanner` finds it (Dijkstra)."""
    after = defaultdict(list)
    for edge in edges:
        assert edge.cost > 0.0
        after[edge.start].append(edge)
    found, queue = {}, [(0.0, start)]
    while queue:
        cost, node = heapq.heappop(queue)
        if node not in found:
            found[node] = cost
            for edge in after[node]:
                heapq.heappush(queue, (cost + edge.cost, edge.stop))
    return found


def test_nav2_finds_a_way_from_any_lane_to_any_other(tmp_path: Path) -> None:
    planting = two_blocks()
    path = tmp_path / "lanes.graph.geojson"
    write_planting(planting, path, speed_limit_kmh=3.6)
    nodes, edges = as_nav2_reads(path)
    pairs = {(edge.start, edge.stop) for edge in edges}
    assert {pair[::-1] for pair in pairs} == pairs  # both ways
    assert {edge.metadata["abs_speed_limit"] for edge in edges} == {1.0}
    for edge in edges:
        assert edge.cost == pytest.approx(math.dist(nodes[edge.start], nodes[edge.stop]), abs=1e-3)
    of_lane = {edge.metadata["lane"]: edge for edge in edges if edge.metadata["lane"]}
    assert set(of_lane) == {lane.id for lane in planting.lanes}
    for lane in planting.lanes:
        mine = [e for e in edges if e.metadata["lane"] == lane.id]
        assert sum(e.cost for e in mine) == pytest.approx(2.0 * lane.length_m, rel=1e-3)
        assert mine[0].metadata["known"] == pytest.approx(lane.known, abs=1e-3)
        unseen_m = (1.0 - lane.known) * lane.length_m
        assert mine[0].metadata["penalty"] == pytest.approx(unseen_m, abs=1e-3)
        places = shapely.points([nodes[e.start] for e in mine])
        assert shapely.distance(lane.line, places).max() < 0.03
    for a, b in itertools.permutations(of_lane.values(), 2):
        assert b.start in cheapest(edges, a.stop)
    # Beside each other: no farther than around the end of the row between.
    way = cheapest(edges, of_lane["B1-L3"].start)[of_lane["B1-L4"].start]
    assert way < 30.0 + 10.0


def test_headlands_are_turns_in_degrees(tmp_path: Path) -> None:
    planting = two_blocks()
    write_planting(planting, tmp_path / "lanes.geojson")
    features = json.loads((tmp_path / "lanes.geojson").read_text())["features"]
    turns = {f["properties"]["id"]: f for f in features if f["properties"]["kind"] == "turn"}
    strips = [strip for strip in network_of(planting).strips if not strip.lane]
    assert set(turns) == {strip.id for strip in strips}
    for strip in strips:
        told = turns[strip.id]["properties"]
        assert told["known"] == pytest.approx(strip.known, abs=1e-3)
        assert told["width_m"] == pytest.approx(strip.width_m, abs=1e-3)
        places = np.array(turns[strip.id]["geometry"]["coordinates"])
        east, north, _ = DATUM.to_enu(places[:, 1], places[:, 0], DATUM.height_m)
        assert np.allclose(np.column_stack([east, north]), strip.line.coords, atol=1e-3)


def test_graphs_are_overwritten_when_they_are_ours(tmp_path: Path) -> None:
    path = tmp_path / "lanes.graph.geojson"
    write_planting(two_blocks(), path)
    with pytest.raises(MapExistsError, match="--overwrite"):
        write_planting(two_blocks(), path)
    write_planting(two_blocks(), path, overwrite=True)
    path.write_text("my own notes")
    with pytest.raises(MapExistsError, match="another name"):
        write_planting(two_blocks(), path, overwrite=True)
    bare = rows_of_view(view_of(straight(1, 20.0), QUIET))
    with pytest.raises(ConfigError, match="route graph needs lanes"):
        write_planting(bare, tmp_path / "none.graph.geojson")


def test_places_of_lanes() -> None:
    network = network_of(two_blocks())
    lane = network.planting.lanes[1]
    assert shapely.Point(network.place(lane.id)).distance(lane.line) < 1e-6
    with pytest.raises(ConfigError, match="no lane 'B7-L7'; there are B1-L1, "):
        network.place("B7-L7")
