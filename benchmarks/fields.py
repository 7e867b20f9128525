"""Fields whose rows are known: of rendered drives, surveys, pictures of real vineyards."""

from __future__ import annotations

import csv
import itertools
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from benchmarks.heading_scores import DATA
from fieldgrid.geometry import Datum, Lattice, Window, lengths, resampled
from fieldgrid.maps import FREE, OBSTACLE, Evidence

Array = npt.NDArray[np.float64]
SPACING_M = 2.5
"""What the usual distance between the rows of a picture is taken for."""


class Field(NamedTuple):
    """Rows as polylines in metres, holes in them (row, from, to along it), ends of lanes [n, 2]."""

    name: str
    rows: list[Array]
    missing: list[tuple[int, float, float]]
    ends: Array


class Vineyard(NamedTuple):
    """The truth of a rendered drive: rows, gaps, things by name, and the raster of what stands."""

    rows: list[Array]
    gaps: list[shapely.LineString]
    things: Mapping[str, shapely.Polygon]
    occupied: Evidence


def driven_vineyard(name: str) -> Vineyard:
    """The truth of one of the rendered drives, in metres of its own datum."""
    folder = DATA / name / "truth"
    rows = json.loads((folder / "rows.geojson").read_text())["features"]
    known = json.loads((folder / "obstacles.json").read_text())
    raster = np.load(folder / "obstacle_raster_5cm.npz")
    cell_m = float(raster["cell"])
    window = Window(
        round(float(raster["east0"]) / cell_m), round(float(raster["north0"]) / cell_m),
        raster["occupied"].shape[1], raster["occupied"].shape[0],
    )  # fmt: skip
    cells = np.where(raster["occupied"], OBSTACLE, FREE).astype(np.uint8)
    return Vineyard(
        [np.array(f["geometry"]["coordinates"], dtype=np.float64) for f in rows],
        [shapely.LineString([g["start_EN"], g["end_EN"]]) for g in known["missing_vine_gaps"]],
        {o["id"]: shapely.Polygon(o["footprint_EN"]) for o in known["obstacles"]},
        Evidence(Lattice(cell_m), window, cells),
    )


def surveyed_fields() -> list[Field]:
    """Two surveyed vineyards: rows through their posts or vines; a wide hole between two is one."""
    folder = DATA / "vineyard_survey_lcas"
    poles: dict[str, list[tuple[float, float]]] = defaultdict(list)
    content = json.loads((folder / "data" / "jojo_rtk_gps_poles.geojson").read_text())
    for feature in content["features"]:
        lon, lat = feature["geometry"]["coordinates"][:2]
        poles[str(feature["properties"]["Row"])].append((lat, lon))
    vines: dict[str, list[tuple[float, float]]] = defaultdict(list)
    with (folder / "ground_truth" / "vine_locations.csv").open(encoding="utf-8-sig") as file:
        for row in csv.DictReader(file):
            vines[row["Vine"][:5]].append((float(row["Lat"]), float(row["Long"])))
    straight = _surveyed("posts", poles, np.inf)
    return [
        straight,
        _surveyed("vines", vines, 2.6),
        Field("posts, bent", [_bent(r) for r in straight.rows], straight.missing, straight.ends),
    ]


def _surveyed(
    name: str, places: Mapping[str, Sequence[tuple[float, float]]], hole_m: float
) -> Field:
    every = np.array([p for group in places.values() for p in group])
    datum = Datum(float(every[:, 0].mean()), float(every[:, 1].mean()), 50.0)
    rows: list[Array] = []
    missing: list[tuple[int, float, float]] = []
    for group in places.values():
        degrees = np.array(group)
        east, north, _ = datum.to_enu(degrees[:, 0], degrees[:, 1], 50.0)
        points = np.column_stack([east, north])
        middle = points.mean(axis=0)
        along = np.linalg.svd(points - middle)[2][0]
        points = points[np.argsort((points - middle) @ along)]
        if len(points) < 2 or lengths(points)[-1] < 8.0:
            continue
        s = lengths(points)
        missing += [
            (len(rows), a + 0.4, b - 0.4) for a, b in itertools.pairwise(s) if b - a > hole_m
        ]
        rows.append(points)
    return Field(name, rows, missing, np.zeros((0, 2)))


def _bent(row: Array) -> Array:
    """The row on an arc of 250 m about a point in the west."""
    fine = resampled(row, 2.0)
    turn = fine[:, 1] / 250.0
    radius = 250.0 + fine[:, 0]
    return np.column_stack([radius * np.cos(turn) - 250.0, radius * np.sin(turn)])


def layout(number: int) -> Field:
    """Rows and marked ends of lanes of a picture of a vineyard, scaled to its usual spacing."""
    folder = DATA / "row_layouts"
    picture = cv2.imread(str(folder / f"img{number}.png"), cv2.IMREAD_GRAYSCALE)
    count, labels = cv2.connectedComponents((picture < 128).astype(np.uint8), connectivity=8)
    rows = []
    for k in range(1, count):
        j, i = np.nonzero(labels == k)
        points = np.column_stack([i, -j]).astype(np.float64)
        middle = points.mean(axis=0)
        along = np.linalg.svd(points - middle, full_matrices=False)[2][0]
        t, x = (points - middle) @ along, (points - middle) @ np.array([-along[1], along[0]])
        if len(points) < 20 or np.ptp(t) < 15.0:
            continue
        fit = np.polyfit(t, x, 2 if np.ptp(t) > 100.0 else 1)
        at = np.linspace(t.min() + 1.0, t.max() - 1.0, 20)
        across = np.polyval(fit, at)[:, None] * np.array([-along[1], along[0]])
        rows.append(middle + at[:, None] * along + across)
    lines = [shapely.LineString(row) for row in rows]
    tree = shapely.STRtree(lines)
    middles = [shapely.Point(row[10]) for row in rows]
    apart = [
        min(lines[o].distance(middles[k]) for o in tree.query(middles[k].buffer(120.0)) if o != k)
        for k in range(len(rows))
    ]
    scale = SPACING_M / float(np.median(apart))
    with (folder / "waypoints.csv").open() as file:
        ends = [
            (float(r["x_wp"]), -float(r["y_wp"]))
            for r in csv.DictReader(file)
            if r["N_img"] == f"img{number}"
        ]
    return Field(f"layout {number}", [row * scale for row in rows], [], np.array(ends) * scale)


def sides_of_lanes(
    rows: Sequence[Array], share: float, rng: np.random.Generator
) -> list[tuple[bool, bool]]:
    """From which sides (left, right) rows are seen, when a share of the lanes was not driven."""
    lines = [shapely.LineString(row) for row in rows]
    seen = [[True, True] for _ in rows]
    for k, row in enumerate(rows):
        middle, along = row[len(row) // 2], row[-1] - row[0]
        right = np.array([along[1], -along[0]]) / np.hypot(*along)
        look = shapely.LineString([middle + 0.3 * right, middle + 4.0 * right])
        beside = [o for o in range(len(rows)) if o != k and lines[o].intersects(look)]
        if beside and rng.random() < share:
            other = min(beside, key=lambda o: lines[o].distance(shapely.Point(middle)))
            seen[k][1] = False
            offset = rows[other][-1] - rows[other][0]
            step = middle - rows[other][0]
            from_left = offset[0] * step[1] > offset[1] * step[0]
            seen[other][0 if from_left else 1] = False
    return [(bool(a), bool(b)) for a, b in seen]
