"""Cells that are larger than the map's own: never more optimistic than those in them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import shapely

from fieldgrid import CostCurve, Costmap
from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.shapes.taskdata import OBSTACLE, UNSEEN, zone_grid
from fieldgrid.geometry import Datum, GridSpec, LocalGrid, Pose, Status
from fieldgrid.maps import LETHAL, UNKNOWN_COST, MapFile, create_map, open_map
from tests.export.nav2_loader import load

DATUM = Datum(41.0, 2.0, 100.0)
CELL_M, SIDE_M = 0.05, 12.0
COARSE_M = (0.1, 0.12, 0.25, 0.4)
NEVER = 101
"""An obstacle of the lowest density that is one."""


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    """Free ground with single obstacle cells far apart, and holes that nobody saw."""
    random = np.random.default_rng(5)
    cells = round(SIDE_M / CELL_M)
    density = np.zeros((cells, cells), dtype=np.uint8)
    density[random.integers(0, cells, 60), random.integers(0, cells, 60)] = NEVER
    observed = random.random(density.shape) < np.linspace(0.05, 1.0, cells)[None, :]
    observed |= density > 0
    spec = GridSpec(SIDE_M, SIDE_M, CELL_M)
    path = tmp_path_factory.mktemp("coarse") / "m.gpkg"
    with create_map(path, DATUM, cell_m=CELL_M) as made, made.add_session("a") as session:
        # North, with its corner on the lattice: each local cell is a cell of the map.
        session.add(LocalGrid(spec, density, observed), pose())
    return open_map(path)


def pose() -> Pose:
    return Pose(
        time_ns=1_775_210_400_000_000_000,
        east_m=SIDE_M / 2.0,
        north_m=0.0,
        up_m=0.0,
        heading_deg=0.0,
        position_sigma_m=0.02,
        heading_sigma_deg=0.5,
        speed_mps=1.0,
        status=Status.OK,
    )


def inside(
    universal: MapFile, cell_m: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """The centres of the map's own cells that are obstacles, and all that were seen."""
    own = universal.read()
    east, north = np.meshgrid(*own.lattice.centres(own.window))
    obstacle = own.observed & (own.density > 100)
    assert obstacle.sum() > 40
    return east, north, obstacle


@pytest.mark.parametrize("cell_m", COARSE_M)
def test_costs_forget_no_obstacle_and_call_nothing_free_that_few_have_seen(
    universal: MapFile, cell_m: float
) -> None:
    costmap = Costmap.from_map(universal, cell_m=cell_m)
    east, north, obstacle = inside(universal, cell_m)
    assert (costmap.cost(east[obstacle], north[obstacle]) == LETHAL).all()
    view = universal.read(cell_m=cell_m, layers=("peak", "seen_share"), decide="density")
    costs = CostCurve().cost(view.peak, view.seen_share)
    share = np.nan_to_num(view.seen_share)
    assert (costs[(share < 0.5) & (view.peak <= 100)] == UNKNOWN_COST).all()
    assert (costs[(share >= 0.5) & (view.peak == 0)] == 0).all()
    assert (costs == 0).any()
    # The mean alone would have called some of them free.
    assert (view.density[costs == LETHAL] <= 50).any()


def test_how_much_must_be_seen_can_be_set(universal: MapFile) -> None:
    view = universal.read(cell_m=0.25, layers=("peak", "seen_share"), decide="density")
    free = [
        np.count_nonzero(CostCurve(least_seen=share).cost(view.peak, view.seen_share) == 0)
        for share in (0.1, 0.5, 0.9)
    ]
    assert free[0] > free[1] > free[2] > 0
    for share in (0.0, 1.1, float("nan")):
        with pytest.raises(ConfigError, match="least share seen"):
            CostCurve(least_seen=share)


@pytest.mark.parametrize("cell_m", COARSE_M)
def test_the_map_server_reads_every_obstacle(
    universal: MapFile, cell_m: float, tmp_path: Path
) -> None:
    export_map(universal, tmp_path / "m.yaml", Selection(cell_m=cell_m), format="nav2")
    grid = load(tmp_path / "m.yaml")
    east, north, obstacle = inside(universal, cell_m)
    column = np.floor((east[obstacle] - grid.origin[0]) / cell_m).astype(int)
    row = np.floor((north[obstacle] - grid.origin[1]) / cell_m).astype(int)
    assert (grid.data[row, column] == 100).all()


@pytest.mark.parametrize("cell_m", [None, *COARSE_M])
def test_outlines_enclose_every_obstacle_cell(
    universal: MapFile, cell_m: float | None, tmp_path: Path
) -> None:
    out = tmp_path / "m.geojson"
    export_map(universal, out, Selection(cell_m=cell_m), options={"simplify_m": 0.3})
    features = json.loads(out.read_text())["features"]
    shapes = [
        shapely.geometry.shape(one["geometry"])
        for one in features
        if one["geometry"]["type"] == "MultiPolygon"
    ]
    whole = shapely.union_all(shapes)
    east, north, obstacle = inside(universal, cell_m or CELL_M)
    edge = 0.49 * CELL_M  # degrees are rounded to a tenth of a millimetre
    for step_e, step_n in ((-edge, -edge), (edge, -edge), (edge, edge), (-edge, edge)):
        e, n = east[obstacle] + step_e, north[obstacle] + step_n
        lat, lon, _ = DATUM.to_geodetic(e, n, np.zeros(e.size))
        assert shapely.contains_xy(whole, lon, lat).all()


def test_zones_of_a_terminal_keep_obstacles_and_what_is_unseen(universal: MapFile) -> None:
    view = universal.read(cell_m=0.4, layers=("peak", "seen_share"), decide="density")
    grid = zone_grid(view)
    east, north, obstacle = inside(universal, 0.4)
    lat, lon, _ = DATUM.to_geodetic(east[obstacle], north[obstacle], np.zeros(obstacle.sum()))
    row = ((lat - grid.south_deg) / grid.cell_north_deg).astype(int)
    column = ((lon - grid.west_deg) / grid.cell_east_deg).astype(int)
    assert (grid.zones[row, column] == OBSTACLE).all()
    assert (grid.zones == UNSEEN).any()


def test_a_view_of_larger_cells_must_say_what_decides(universal: MapFile) -> None:
    with pytest.raises(ConfigError, match="layers="):
        Costmap.from_view(universal.read(cell_m=0.25))
    Costmap.from_view(universal.read())
