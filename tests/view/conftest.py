"""One map and one server for all tests of the viewer."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.geometry import LocalGrid
from fieldgrid.maps import open_map
from tests.conftest import TWO_LANES
from tests.field.changes.worlds import Box, lane, world_map
from tests.view.serving import Server, serving

LATER_NS = 60 * 86_400_000_000_000
GONE_ABOVE = 100


@pytest.fixture(scope="session")
def vineyard(two_lanes_map: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example drive, and two months later a drive over half of it that saw no obstacle.

    Its images lie where their names say, seen from the folder of the map.
    """
    folder = tmp_path_factory.mktemp("vineyard")
    path = folder / "vineyard.gpkg"
    shutil.copy(two_lanes_map, path)
    with open_map(path, writable=True) as universal:
        frames = list(universal.frames(with_grid=True))[:20]
        with universal.add_session("august") as session:
            for frame in frames:
                grid = frame.grid()
                density = np.where(grid.density > GONE_ABOVE, np.uint8(0), grid.density)
                session.add(
                    LocalGrid(grid.spec, density, grid.observed),
                    replace(frame.pose, time_ns=frame.pose.time_ns + LATER_NS),
                    frame_id=frame.frame_id,
                )
    return path


@pytest.fixture(scope="session")
def obstacle(vineyard: Path) -> tuple[float, float]:
    """A place in the middle of many obstacle cells that the first drive alone saw."""
    with open_map(vineyard) as universal:
        view = universal.read(layers=["sessions"], sessions=["two_lanes"])
        both = universal.read(layers=["sessions"])
    dense = (view.density > 150) & (both.layer("sessions") == 1)
    inside = dense.copy()
    for shift in range(-2, 3):
        for axis in (0, 1):
            inside &= np.roll(dense, shift, axis)
    j, i = np.argwhere(inside)[len(np.argwhere(inside)) // 2]
    east, north = view.lattice.centres(view.window)
    return float(east[i]), float(north[j])


@pytest.fixture(scope="session")
def with_crate(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Serves a lane that was driven twice; before the second time a crate was put there."""
    row, crate = Box(1.2, -1.0, 1.6, 13.0), Box(-1.5, 4.0, -0.7, 4.6)
    drives = {"first": ([row], lane(0.0)), "second": ([row, crate], lane(0.04, 100))}
    path = world_map(tmp_path_factory.mktemp("crate") / "map.gpkg", drives)
    with serving(path) as running:
        yield running


@pytest.fixture(scope="session")
def server(vineyard: Path) -> Iterator[Server]:
    """Serves the vineyard; for tests that do not change it."""
    with serving(vineyard, recordings=(TWO_LANES,)) as running:
        yield running


@pytest.fixture
def own_server(vineyard: Path, tmp_path: Path) -> Iterator[Server]:
    """Serves a copy of the vineyard, which a test may change."""
    shutil.copy(vineyard, tmp_path / "vineyard.gpkg")
    with serving(tmp_path / "vineyard.gpkg", recordings=(TWO_LANES,)) as running:
        yield running
