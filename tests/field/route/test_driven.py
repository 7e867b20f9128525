"""Ground under the vehicle's own way is free to a route, until a later drive sees an obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fieldgrid import Datum, GridSpec, LocalGrid, Pose, open_map, plan_route
from fieldgrid.core import NoRouteError
from fieldgrid.maps import MapFile

SPEC = GridSpec(6.0, 8.0, 0.1)


def add(
    universal: MapFile, day: int, north_dm: range, *, sees: bool, columns: Sequence[int] = (30,)
) -> None:
    """A drive to the north that sees a cell 6 m north of the datum as an obstacle, or free."""
    with universal.add_session(f"day {day}") as session:
        for k, dm in enumerate(north_dm):
            density = np.zeros(SPEC.shape, np.uint8)
            if sees and dm < 60:
                density[60 - dm, columns] = 200
            grid = LocalGrid(SPEC, density, np.full(SPEC.shape, True))
            time_ns = (1_700_000_000 + 86_400 * day + k) * 1_000_000_000
            pose = Pose(time_ns, 0.0, dm / 10.0, 0.0, 0.0, 0.02, 0.3, 1.0)
            session.add(grid, pose, frame_id=f"{k:06d}")


@pytest.mark.parametrize("again", [False, True])
def test_a_cell_that_was_driven_over_is_free_until_it_is_seen_again(
    tmp_path: Path, again: bool
) -> None:
    path = tmp_path / "map.gpkg"
    with open_map(path, datum=Datum(39.4, -1.2, 700.0), cell_m=0.1) as universal:
        add(universal, 0, range(0, 100, 10), sees=True)
        if again:
            add(universal, 1, range(0, 24, 2), sees=True)
    asked = path, (0.0, 2.0, 0.0), (0.0, 8.0, 0.0)
    if again:
        assert plan_route(*asked).length_m > 6.05
        with pytest.raises(NoRouteError):
            plan_route(path, (0.0, 5.8, 0.0), (0.0, 8.0, 0.0))
    else:
        assert plan_route(*asked).length_m == pytest.approx(6.0, abs=0.01)


def test_cells_that_lie_beside_it_stay(tmp_path: Path) -> None:
    """The width is 1.2 m: one cell is 0.35 m beside the way, and one 0.85 m."""
    path = tmp_path / "map.gpkg"
    with open_map(path, datum=Datum(39.4, -1.2, 700.0), cell_m=0.1) as universal:
        add(universal, 0, range(0, 100, 10), sees=True, columns=(33, 38))
        view = universal.read(decide="density")
    worst = view.decision().worst
    j, i = 60 - view.window.j0, 3 - view.window.i0
    assert worst[j, i] == 0
    assert worst[j, i + 5] > 100
