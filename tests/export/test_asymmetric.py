"""The map that the exporters are tested with is what it says it is."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.maps import MapFile, open_map
from tests.export import asymmetric
from tests.export.asymmetric import CELL_M, COARSE_M, EXTENT, cells, write_asymmetric_map


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@pytest.mark.parametrize("cell_m", [CELL_M, COARSE_M])
def test_the_map_is_the_truth(universal: MapFile, cell_m: float) -> None:
    names = ("sessions", "variance", "max", "persistence")
    view = universal.read(cell_m=cell_m, layers=names)
    assert tuple(view.bounds) == pytest.approx(tuple(EXTENT))
    _, _, true = cells(cell_m)
    np.testing.assert_array_equal(view.density, true.density)
    np.testing.assert_array_equal(view.observed, true.observed)
    np.testing.assert_array_equal(view.layer("sessions"), true.sessions)
    np.testing.assert_allclose(view.layer("variance"), true.variance)
    np.testing.assert_array_equal(view.layer("max"), true.highest)
    np.testing.assert_allclose(view.layer("persistence"), true.persistence)


def test_no_mistake_leaves_it_as_it_is() -> None:
    _, _, true = cells()
    value = np.where(true.observed, true.density.astype(np.int64), -1)
    square = value[:320, :320]
    for wrong in (value[::-1], value[:, ::-1], value[::-1, ::-1], np.roll(value, 1, 0)):
        assert np.count_nonzero(wrong != value) > 800
    assert np.count_nonzero(square != square.T) > 800


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (-10.0, 9.0, 0.3), (14.0, -7.0, -2.0)])
def test_places_on_earth_are_those_of_the_datum(point: tuple[float, float, float]) -> None:
    lat, lon, height = asymmetric.geodetic(*point)
    assert asymmetric.DATUM.to_enu(lat, lon, height) == pytest.approx(point, abs=1e-6)
    assert asymmetric.enu(lat, lon, height) == pytest.approx(point, abs=1e-6)
