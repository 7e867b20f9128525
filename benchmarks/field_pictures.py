"""docs/routes.png and docs/coverage.png: routes and coverage of the example; docs/tracks.png:
tracks over a field of the benchmark.

python -m benchmarks.field_pictures vineyard.gpkg docs
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.coverage import random_field
from benchmarks.planting import DATUM
from fieldgrid.core import UInt8
from fieldgrid.core.palette import SESSIONS
from fieldgrid.field import Route, Tracks, Vehicle, find_rows, plan_coverage, plan_route
from fieldgrid.field.coverage.plan import coverage_in_view
from fieldgrid.field.route.plan import planning_view
from fieldgrid.field.route.verify import swept_hulls
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import LETHAL, UNKNOWN_COST, CostCurve, MapFile, MapView, open_map

ROUTES = (
    ("#c0392b", (-14.0, 50.0, 37.0), (6.0, 76.0), False),
    ("#2b5fd6", (-8.0, 57.7, 37.0), (-1.7, 61.2, -143.0), True),
)
SEED = 44
"""The field that stands for others in the picture of coverage."""


def draw_tracks(out: Path) -> None:
    """Draw tracks, what they work and the route over a field with an obstacle and a corner that was
    not seen."""
    density, seen = np.zeros((150, 200), np.uint8), np.ones((150, 200), np.bool_)
    density[60:70, 90:100], seen[110:, :40] = 200, False
    view = MapView(Lattice(0.2), Window(0, 0, 200, 150), density, seen, DATUM, is_base=True)
    vehicle = Vehicle(0.8, 0.4, 1.0, turning_radius_m=1.2)
    coverage = coverage_in_view(view, Tracks(width_m=2.0, overlap_m=0.1), vehicle)
    figure = _figure(1)
    axes = _over(figure, 111, view, density > 0, ~seen)
    for lane in coverage.planting.lanes:
        axes.fill(*lane.area.exterior.xy, color="#3a9d5d", alpha=0.25, lw=0)
        axes.annotate(lane.id, lane.line.coords[0], fontsize=7, color="#0b4a22")
    route = coverage.route
    axes.plot(route.east_m, route.north_m, color="#c0392b", lw=1.0)
    figure.savefig(out)


def draw_routes(universal: MapFile, out: Path) -> None:
    """Draw what routes sweep over what they keep away from."""
    figure = _figure(1)
    axes = _over_costs(figure, 111, planning_view(universal, None, None, None))
    for colour, start, goal, any_ in ROUTES:
        route = plan_route(universal, start, goal, Vehicle(), allow_unknown=any_)
        print(route.length_m, route.turning_share, route.cusps, route.least_clearance_m)
        _draw_route(axes, route, slice(None), colour)
        axes.plot(route.east_m[0], route.north_m[0], "o", color=colour, ms=5)
        axes.plot(route.east_m[-1], route.north_m[-1], "s", color=colour, ms=5)
    figure.savefig(out)


def draw_coverage(universal: MapFile, out: Path) -> None:
    """Draw the coverage of the map's driven lanes, and that of a field of the benchmark."""
    task = random_field(SEED)
    view = planning_view(universal, None, None, None)
    driven = [lane.id for lane in find_rows(universal).lanes if lane.driven]
    ours = plan_coverage(universal, Vehicle(), lanes=driven, allow_unknown=True)
    other = coverage_in_view(task.view, task.planting, task.vehicle)
    figure = _figure(2)
    for place, shown, coverage in ((121, view, ours), (122, task.view, other)):
        axes, route = _over_costs(figure, place, shown), coverage.route
        print(route.length_m, coverage.turning_share, route.cusps, route.least_clearance_m)
        print(task.vehicle, [entry.lane for entry in coverage.left_out])
        _draw_route(axes, route, slice(None), "#2b5fd6")
        for number, lane in enumerate(coverage.lanes):
            mine = np.flatnonzero(route.lane == lane.lane)
            colour = SESSIONS[number % len(SESSIONS)]
            _draw_route(axes, route, slice(mine[0], mine[-1] + 2), colour)
            middle = mine[len(mine) // 2]
            axes.annotate(str(number + 1), (route.east_m[middle], route.north_m[middle]))
    figure.savefig(out)


def _draw_route(axes: Axes, route: Route, poses: slice, colour: str) -> None:
    hulls = swept_hulls(route.path, route.vehicle)[0]
    for hull in hulls[poses][::3]:
        axes.fill(*hull.exterior.xy, color=colour, alpha=0.06, lw=0)
    axes.plot(route.east_m[poses], route.north_m[poses], color=colour, lw=1.4)


def _figure(columns: int) -> Figure:
    figure = Figure(figsize=(7.0 * columns, 8.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _over_costs(figure: Figure, place: int, view: MapView) -> Axes:
    cost: UInt8 = CostCurve().cost(*view.decision())
    return _over(figure, place, view, cost == LETHAL, cost == UNKNOWN_COST)


def _over(figure, place, view, blocked, unseen) -> Axes:  # type: ignore[no-untyped-def]
    """Axes in metres east and north over what is blocked (dark) and not seen (grey)."""
    picture = np.full((*blocked.shape, 3), 255, dtype=np.uint8)
    picture[unseen], picture[blocked] = (222, 226, 232), (90, 90, 90)
    bounds = view.bounds
    extent = (bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m)
    axes = figure.add_subplot(place)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest")
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="east, m", ylabel="north, m", aspect="equal")
    return axes


if __name__ == "__main__":
    folder = Path(sys.argv[2])
    with open_map(sys.argv[1]) as opened:
        draw_routes(opened, folder / "routes.png")
        draw_coverage(opened, folder / "coverage.png")
    draw_tracks(folder / "tracks.png")
