"""The lanes of a planting as a network: with the headlands and the turns between them, both ways.

Its nodes are the mouths of lanes and the places beyond the ends of rows; strips lead from node to
node. At each end of a lane a strip turns to the end of either row beside it, and one passes the
mouth, from row end to row end. What is still apart (blocks, tracks without rows) is linked by the
shortest lines that cross no row. Exports write it as it is; routes between lanes are planned along
its lanes for a vehicle, on the ground as it is.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from fieldgrid.core import ConfigError, Float64, quoted
from fieldgrid.field.rows.measuring.neighbours import linked_parts
from fieldgrid.field.rows.result import Lane, Planting
from fieldgrid.geometry import normals

_LEAST_HALF_M = 0.05
_ENDS, _SIDES = ("start", "stop"), ("left", "right")
_CURVE = np.linspace(0.0, 1.0, 7)
_NEIGHBOURS = 8
_TOLERANCE_M = 0.005


class NetworkStrip(NamedTuple):
    """A way between two nodes, that may be driven both ways; left and right are meant along `line`.

    `lane` is the id of its lane, empty on a headland. `ends` are the numbers of its nodes, and
    `turned` says of each whether the strip passes it against the node's own direction. `left` and
    `right` bound its ground; they end at the sides of its nodes. `width_m` is the free width of a
    lane, NaN where none was measured, and what is taken for a headland. `clearance_m` is the
    distance from its line to the nearest thing or face of a row, NaN where there is none. `known`
    is the share of its ground that was seen, and `obstacles` are the ids of what stands in it.
    """

    id: str
    lane: str
    ends: tuple[int, int]
    turned: tuple[bool, bool]
    line: shapely.LineString
    left: shapely.LineString
    right: shapely.LineString
    width_m: float
    clearance_m: float = math.nan
    known: float = 0.0
    obstacles: tuple[str, ...] = ()

    @property
    def area(self) -> shapely.Polygon:
        """Its ground, metres east and north."""
        ring = [*self.left.coords, *self.right.coords[::-1]]
        return shapely.Polygon(ring).buffer(0.0)


class LaneNetwork(NamedTuple):
    """Strips between nodes of a planting. `sides_m` [n, 2, 2] are the left and the right side of
    each node, east and north; the node is in the middle."""

    planting: Planting
    sides_m: Float64
    strips: tuple[NetworkStrip, ...]

    @property
    def places_m(self) -> Float64:
        """The nodes [n, 2], metres east and north."""
        return np.asarray(self.sides_m.mean(axis=1))

    def place(self, lane: str) -> tuple[float, float]:
        """The middle of a lane, metres east and north. ConfigError where there is no such lane."""
        found = self.planting.lane(lane)
        if found is None:
            names = ", ".join(one.id for one in self.planting.lanes) or "none"
            raise ConfigError(f"There is no lane {quoted(lane)}; there are {names}.")
        middle = found.line.interpolate(0.5, normalized=True)
        return middle.x, middle.y


def network_of(planting: Planting) -> LaneNetwork:
    """The network of the lanes of a planting; one without lanes has no strips."""
    if not planting.lanes:
        return LaneNetwork(planting, np.zeros((0, 2, 2)), ())
    return _Drawing(planting).network()


class _Drawing:
    """A network as it is drawn."""

    def __init__(self, planting: Planting) -> None:
        self._planting = planting
        self._rows = {row.id: row for row in planting.rows}
        self._walls = shapely.STRtree([row.line for row in planting.rows])
        faces = [row.line.buffer(row.half_width_m, cap_style="flat") for row in planting.rows]
        self._solid = shapely.union_all([*faces, *(o.area for o in planting.obstacles)])
        self._things = shapely.STRtree([thing.area for thing in planting.obstacles])
        self._seen = shapely.union_all(
            [*(h.area for h in planting.headlands), *(lane.area for lane in planting.lanes)]
        )
        shapely.prepare(self._seen)
        self._beside: dict[tuple[str, str], list[Lane]] = {}
        for lane in planting.lanes:
            for name, side in zip(lane.rows, _SIDES, strict=True):
                self._beside.setdefault((name, side), []).append(lane)
        self._sides: list[Float64] = []
        self._at: dict[tuple[str, int], int] = {}
        self._strips: list[NetworkStrip] = []
        # Of each node, before it is linked: whether it faces its strips, or turns its back to them.
        self._faced: dict[int, set[bool]] = defaultdict(set)

    def network(self) -> LaneNetwork:
        for lane in self._planting.lanes:
            self._add_lane(lane)
        for lane in self._planting.lanes:
            for end in (0, 1):
                self._add_headland(lane, end)
        for strip in self._strips:
            for place, node in enumerate(strip.ends):
                self._faced[node].add(strip.turned[place] == (place == 1))
        for number, (a, b) in enumerate(self._apart(), 1):
            self._add(f"link-{number}", (a, b), self._width(a, b))
        sides = np.array(self._sides).reshape(-1, 2, 2)
        return LaneNetwork(self._planting, sides, tuple(self._strips))

    def _add_lane(self, lane: Lane) -> None:
        bounds, line = [], np.asarray(lane.line.coords)[:, :2]
        for side, name, half_m in zip((1.0, -1.0), lane.rows, self._halves_m(lane), strict=True):
            face_m = self._rows[name].half_width_m if name in self._rows else 0.0
            away = side * max(half_m - face_m, _LEAST_HALF_M)
            parts = shapely.get_parts(shapely.offset_curve(lane.line, away, join_style="mitre"))
            bound = shapely.get_coordinates(max(parts, key=lambda one: one.length))
            bound[[0, -1]] = (line + away * normals(line))[[0, -1]]
            bounds.append(shapely.LineString(bound).simplify(_TOLERANCE_M))
        ends = tuple(
            self._node(lane.id, end, np.array([bound.coords[-end] for bound in bounds]))
            for end in (0, 1)
        )
        width = lane.clear_width_m if math.isfinite(lane.clear_width_m) else lane.free_width_m
        strip = NetworkStrip(lane.id, lane.id, (ends[0], ends[1]), (False, False), lane.line,
                             bounds[0], bounds[1], width, known=lane.known)  # fmt: skip
        self._keep(strip)

    def _halves_m(self, lane: Lane) -> tuple[float, float]:
        """From the middle of a lane to its left and right row, or to the sides of its ground."""
        middle, half_m = lane.line.interpolate(0.5, normalized=True), 0.5 * lane.area.area
        left, right = (
            float(self._rows[name].line.distance(middle))
            if name in self._rows
            else half_m / lane.length_m
            for name in lane.rows
        )
        return left, right

    def _add_headland(self, lane: Lane, end: int) -> None:
        """The strips from a mouth to the ends of the rows beside it, and past it."""
        line = np.asarray(lane.line.coords)[:, :2]
        mouth, width_m = line[-end], sum(self._halves_m(lane))
        along = normals(line)[-end] @ np.array([[0.0, -1.0], [1.0, 0.0]])
        out = along if end else -along
        corners, here, tag = [], self._at[lane.id, end], f"{lane.id}-{_ENDS[end]}"
        for name, side in zip(lane.rows, _SIDES, strict=True):
            row = self._rows.get(name)
            if row is None:
                continue
            tip = np.asarray(row.line.coords)[:, :2][-end]
            beside = [o.line.coords[-end][:2] for o in self._beside[name, side]]
            if np.hypot(*(beside - tip).T).min() < math.dist(mouth, tip):
                continue  # another lane beside the row is nearer to its end
            # Beyond the longer of a row and the mouth, so that no corner lies in a lane.
            place = tip + out * (max((mouth - tip) @ out, 0.0) + 0.5 * width_m)
            left = 0.5 * width_m * along
            corner = self._node(row.id, end, np.array([place + left, place - left]))
            self._add(f"{tag}-{side}", (here, corner) if end else (corner, here), width_m)
            corners.append(corner)
        if len(corners) == 2:
            self._add(tag, (corners[0], corners[1]), width_m)

    def _node(self, name: str, end: int, sides: Float64) -> int:
        """The number of the node at an end of a lane or a row, made where there is none yet."""
        number = self._at.setdefault((name, end), len(self._sides))
        if number == len(self._sides):
            self._sides.append(sides)
        return number

    def _add(self, name: str, ends: tuple[int, int], width_m: float) -> None:
        """A strip over open ground, that bends from the direction of one node into the other's."""
        sides = np.array([self._sides[k] for k in ends])
        middles = sides.mean(axis=1)
        chord = middles[1] - middles[0]
        # Nodes face ahead of their left and right sides.
        ahead = (sides[:, 0] - sides[:, 1]) @ np.array([[0.0, -1.0], [1.0, 0.0]])
        ahead /= np.hypot(*ahead.T)[:, None]
        turned = ahead @ chord < 0.0
        for place, node in enumerate(ends):
            if len(self._faced[node]) == 1:  # a link leads on from where all others arrive
                turned[place] = (True not in self._faced[node]) == (place == 1)
        ahead[turned] *= -1.0
        sides[turned] = sides[turned][:, ::-1]
        line, left, right = (
            shapely.LineString(_bent(*ends_m, *ahead)).simplify(_TOLERANCE_M)
            for ends_m in (middles, sides[:, 0], sides[:, 1])
        )
        strip = NetworkStrip(
            name, "", ends, (bool(turned[0]), bool(turned[1])), line, left, right, width_m
        )
        known = strip.area.intersection(self._seen).area / max(strip.area.area, 1e-9)
        self._keep(strip._replace(known=known))

    def _keep(self, strip: NetworkStrip) -> None:
        """Add a strip with what stands in it or beside it."""
        hit = np.sort(self._things.query(strip.area, predicate="intersects"))
        things = tuple(self._planting.obstacles[k].id for k in hit)
        clearance_m = float(strip.line.distance(self._solid))
        self._strips.append(strip._replace(clearance_m=clearance_m, obstacles=things))

    def _width(self, *nodes: int) -> float:
        return float(min(np.hypot(*(self._sides[k][0] - self._sides[k][1])) for k in nodes))

    def _apart(self) -> Iterator[tuple[int, int]]:
        """Pairs of nodes that join what is apart, by the shortest lines that cross no row."""
        places = np.array([side.mean(axis=0) for side in self._sides]).reshape(-1, 2)
        ends = np.array([strip.ends for strip in self._strips]).reshape(-1, 2)
        label = linked_parts(ends, len(places))
        while label.any():
            inside, outside = np.flatnonzero(label == 0), np.flatnonzero(label)
            count = min(_NEIGHBOURS, len(inside))
            away, near = cKDTree(places[inside]).query(places[outside], [*range(1, count + 1)])
            for at in np.argsort(away, axis=None):
                k, n = np.unravel_index(at, away.shape)
                a, b = int(inside[near[k, n]]), int(outside[k])
                line = shapely.LineString(places[[a, b]])
                if not len(self._walls.query(line, predicate="intersects")):
                    yield a, b
                    label[label == label[b]] = 0
                    break
            else:
                return


def _bent(start: Float64, stop: Float64, ahead: Float64, arriving: Float64) -> Float64:
    """Points from one to another place that leave it in one direction and arrive in another: a
    straight line where no corner lies between."""
    cross = float(ahead[0] * arriving[1] - ahead[1] * arriving[0])
    chord = stop - start
    if abs(cross) < 0.2:
        return np.array([start, stop])
    before = float(chord[0] * arriving[1] - chord[1] * arriving[0]) / cross
    after = float(ahead[0] * chord[1] - ahead[1] * chord[0]) / cross
    if min(before, after) <= 0.0:
        return np.array([start, stop])
    corner, t = start + before * ahead, _CURVE[:, None]
    return np.asarray((1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * stop)
