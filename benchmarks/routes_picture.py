"""docs/routes.png: routes over the map of the example, one of them over unseen ground.

python -m benchmarks.routes_picture vineyard.gpkg docs/routes.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.cost import LETHAL, UNKNOWN_COST, CostCurve
from fieldgrid.mapfile import DECISION_LAYERS, open_map
from fieldgrid.route import Vehicle, plan_route
from fieldgrid.route.verify import swept_hulls

CURVE = CostCurve(obstacle_above=130)
ROUTES = (
    ("#c0392b", (-14.0, 49.7, 37.0), (6.0, 76.0), False),
    ("#2b5fd6", (-8.0, 57.7, 37.0), (-1.7, 61.2, -143.0), True),
)


def draw(map_: Path, out: Path) -> None:
    """Draw what routes sweep over what they keep away from."""
    with open_map(map_) as universal:
        view = universal.read(cell_m=0.2, layers=DECISION_LAYERS)
        routes = [
            (colour, plan_route(universal, start, goal, Vehicle(), allow_unknown=any_, curve=CURVE))
            for colour, start, goal, any_ in ROUTES
        ]
    cost, bounds = CURVE.cost(view.peak, view.seen_share), view.bounds
    picture = np.full((*cost.shape, 3), 255, dtype=np.uint8)
    picture[cost == UNKNOWN_COST] = (222, 226, 232)
    picture[cost == LETHAL] = (90, 90, 90)
    high, wide = bounds.north_m - bounds.south_m, bounds.east_m - bounds.west_m
    figure = Figure(figsize=(7.0, 7.0 * high / wide), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    extent = (bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest")
    for colour, route in routes:
        print(route.length_m, route.turning_share, route.cusps, route.least_clearance_m)
        for hull in swept_hulls(route.path, route.vehicle)[0][::3]:
            axes.fill(*hull.exterior.xy, color=colour, alpha=0.06, lw=0)
        axes.plot(route.east_m, route.north_m, color=colour, lw=1.4)
        axes.plot(route.east_m[0], route.north_m[0], "o", color=colour, ms=5)
        axes.plot(route.east_m[-1], route.north_m[-1], "s", color=colour, ms=5)
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="east, m", ylabel="north, m", aspect="equal")
    figure.savefig(out)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
