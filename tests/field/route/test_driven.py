"""Ground under the vehicle's own way is free to a route, until a later drive sees something there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fieldgrid import Datum, GridSpec, LocalGrid, NoRouteError, Pose, create_map, plan_route

SPEC = GridSpec(6.0, 8.0, 0.1)


def drive(path: Path, *days: bool) -> Path:
    """A map of drives 10 m to the north, a day each, which see a cell in their way or do not."""
    with create_map(path, Datum(39.4, -1.2, 700.0), cell_m=0.1) as universal:
        for day, sees in enumerate(days):
            with universal.add_session(f"day {day}") as session:
                for k in range(10 if sees is days[0] or not sees else 3):
                    density = np.zeros(SPEC.shape, np.uint8)
                    if sees:
                        density[60 - 10 * k if k < 6 else 0, 30] = 200 if k < 6 else 0
                    grid = LocalGrid(SPEC, density, np.full(SPEC.shape, True))
                    time_ns = (1_700_000_000 + 86_400 * day + k) * 1_000_000_000
                    pose = Pose(time_ns, 0.0, float(k), 0.0, 0.0, 0.02, 0.3, 1.0)
                    session.add(grid, pose, frame_id=f"{k:06d}")
    return path


def test_a_cell_that_the_vehicle_drove_over_is_free(tmp_path: Path) -> None:
    route = plan_route(drive(tmp_path / "one.gpkg", True), (0.0, 2.0, 0.0), (0.0, 8.0, 0.0))
    assert route.length_m == pytest.approx(6.0, abs=0.01)


def test_a_later_drive_that_sees_something_there_counts(tmp_path: Path) -> None:
    path = drive(tmp_path / "two.gpkg", False, True)
    with pytest.raises(NoRouteError):
        plan_route(path, (0.0, 5.8, 0.0), (0.0, 8.0, 0.0))
