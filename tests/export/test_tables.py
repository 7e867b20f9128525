"""Cells as tables: what comes back through other readers is the truth, cell by cell."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import geopandas
import numpy as np
import numpy.typing as npt
import pyarrow.parquet
import pytest

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import (
    COARSE_M,
    DATUM,
    cells,
    enu,
    write_asymmetric_map,
)

Columns = dict[str, npt.NDArray[np.float64]]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def read_csv(path: Path) -> Columns:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def read_parquet(path: Path) -> Columns:
    table = pyarrow.parquet.read_table(path)
    plain = [name for name in table.column_names if name not in ("geometry", "bbox")]
    return {name: table[name].to_numpy().astype(np.float64) for name in plain}


READERS = {".csv": read_csv, ".parquet": read_parquet}


def check(columns: Columns, cell_m: float = COARSE_M, layer: str = "density") -> None:
    """Every observed cell is there once, at its place in both planes, with its value and count."""
    east, north, true = cells(cell_m)
    column = np.round((columns["east_m"] - east[0]) / cell_m).astype(int)
    row = np.round((columns["north_m"] - north[0]) / cell_m).astype(int)
    found = np.zeros(true.observed.shape, dtype=np.int64)
    np.add.at(found, (row, column), 1)
    np.testing.assert_array_equal(found, true.observed.astype(np.int64))
    np.testing.assert_allclose(columns["east_m"], east[column], atol=1e-4)
    np.testing.assert_allclose(columns["north_m"], north[row], atol=1e-4)
    at_east, at_north, _ = enu(columns["lat_deg"], columns["lon_deg"])
    np.testing.assert_allclose(at_east, columns["east_m"], atol=0.001)
    np.testing.assert_allclose(at_north, columns["north_m"], atol=0.001)
    wanted = {"density": true.density, "persistence": true.persistence}[layer]
    np.testing.assert_allclose(columns[layer], wanted[row, column], atol=1e-6)
    np.testing.assert_array_equal(columns["n"], true.sessions[row, column])


@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("layer", ["density", "persistence"])
def test_every_cell_comes_back(universal: MapFile, tmp_path: Path, ending: str, layer: str) -> None:
    out = tmp_path / f"cells{ending}"
    done = export_map(universal, out, Selection(cell_m=COARSE_M, layer=layer))
    columns = READERS[ending](out)
    check(columns, layer=layer)
    assert dict(done.rows)["cells"] == str(len(columns["n"]))


@pytest.mark.parametrize(
    "wrong",
    [
        lambda c: {**c, "east_m": c["north_m"], "north_m": c["east_m"]},
        lambda c: {**c, "east_m": -c["east_m"]},
        lambda c: {**c, "north_m": c["north_m"] + COARSE_M / 2.0},
        lambda c: {**c, "lat_deg": c["lat_deg"] - DATUM.lat_deg},
        lambda c: {**c, "lat_deg": c["lon_deg"], "lon_deg": c["lat_deg"]},
        lambda c: {**c, "lon_deg": c["lon_deg"] + 1e-7},
        lambda c: {**c, "density": c["density"][::-1]},
        lambda c: {name: values[1:] for name, values in c.items()},
        lambda c: {**c, "n": c["n"] * 0.0 + 1.0},
    ],
)
def test_a_wrong_table_is_found(universal: MapFile, tmp_path: Path, wrong: object) -> None:
    out = tmp_path / "cells.csv"
    export_map(universal, out, Selection(cell_m=COARSE_M))
    with pytest.raises((AssertionError, IndexError)):
        check(wrong(read_csv(out)))  # type: ignore[operator]


def test_fine_cells_in_bounds_beyond_one_strip(universal: MapFile, tmp_path: Path) -> None:
    bounds = Bounds(-4.0, -3.0, 2.0, 4.0)
    export_map(universal, tmp_path / "part.parquet", Selection(bounds))
    columns = read_parquet(tmp_path / "part.parquet")
    east, north, true = cells(bounds=bounds)
    assert len(columns["n"]) == true.observed.sum() == len(east) * len(north)
    assert columns["density"].sum() == true.density.sum()


def test_a_csv_has_its_datum_beside_it(universal: MapFile, tmp_path: Path) -> None:
    done = export_map(universal, tmp_path / "cells.csv", Selection(at="spring"))
    assert [path.name for path in done.paths] == ["cells.csv", "cells.csv-metadata.json"]
    document = json.loads((tmp_path / "cells.csv-metadata.json").read_text())
    with (tmp_path / "cells.csv").open() as file:
        header = file.readline().strip().split(",")
    assert [column["name"] for column in document["tableSchema"]["columns"]] == header
    (notes,) = document["notes"]
    assert notes["datum"] == {
        "lat_deg": DATUM.lat_deg, "lon_deg": DATUM.lon_deg, "height_m": DATUM.height_m,
    }  # fmt: skip
    assert notes["at"] == "spring"
    assert notes["crs_wkt"].startswith("PROJCRS[")


def test_parquet_has_its_datum_inside(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "cells.parquet")
    schema = pyarrow.parquet.read_schema(tmp_path / "cells.parquet")
    about = json.loads(schema.metadata[b"fieldgrid"])
    assert about["datum"]["height_m"] == 742.0
    assert about["cell_m"] == 0.05


@pytest.mark.parametrize("ending", READERS)
def test_what_cannot_be_written_leaves_nothing(
    universal: MapFile, tmp_path: Path, ending: str
) -> None:
    out = tmp_path / f"cells{ending}"
    with pytest.raises(ConfigError, match="No cell was observed"):
        export_map(universal, out, Selection(Bounds(11.0, 6.0, 13.0, 8.0)))
    with pytest.raises(ConfigError, match="hold nothing of the map"):
        export_map(universal, out, Selection(Bounds(100.0, 6.0, 113.0, 8.0)))
    with pytest.raises(ConfigError, match="has no option 'obstacle_above'"):
        export_map(universal, out, options={"obstacle_above": 3})
    assert list(tmp_path.iterdir()) == []
    out.write_text("mine")
    with pytest.raises(MapExistsError, match="--overwrite"):
        export_map(universal, out)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert out.read_text() == "mine"


def test_parquet_is_geoparquet(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "m.parquet", Selection(cell_m=COARSE_M))
    frame = geopandas.read_parquet(tmp_path / "m.parquet")
    columns = read_parquet(tmp_path / "m.parquet")
    np.testing.assert_array_equal(frame.geometry.x, columns["east_m"])
    np.testing.assert_array_equal(frame.geometry.y, columns["north_m"])
    degrees = frame.geometry.to_crs("EPSG:4326")
    np.testing.assert_allclose(degrees.x, columns["lon_deg"], atol=1e-9)
    np.testing.assert_allclose(degrees.y, columns["lat_deg"], atol=1e-9)
    geo = json.loads(pyarrow.parquet.read_metadata(tmp_path / "m.parquet").metadata[b"geo"])
    assert geo["columns"]["geometry"]["bbox"] == pytest.approx(frame.total_bounds.tolist())
    part = geopandas.read_parquet(tmp_path / "m.parquet", bbox=(0.0, 0.0, 2.0, 2.0))
    inside = (frame.geometry.x.between(0.0, 2.0)) & (frame.geometry.y.between(0.0, 2.0))
    assert 0 < len(part) == int(inside.sum()) < len(frame)


def test_a_validator_of_geoparquet_has_nothing_to_say(universal: MapFile, tmp_path: Path) -> None:
    validator = pytest.importorskip("geoparquet_validator")
    out = tmp_path / "m.parquet"
    export_map(universal, out, Selection(cell_m=COARSE_M))
    report = validator.check(str(out))
    assert [
        (one["id"], one["message"]) for one in report["outcomes"] if one["status"] == "fail"
    ] == []
    passed = {one["id"] for one in report["outcomes"] if one["status"] == "pass"}
    assert passed >= {"/conf/core/wkb", "/conf/core/crs-projjson", "/conf/core/bbox-extent"}
    assert "/conf/covering/bbox-paths" in passed
    # It does find faults: bounds that are not those of the points.
    table = pyarrow.parquet.read_table(out)
    geo = json.loads(pyarrow.parquet.read_metadata(out).metadata[b"geo"])
    geo["columns"]["geometry"]["bbox"][0] += 1.0
    wrong = table.replace_schema_metadata({**table.schema.metadata, b"geo": json.dumps(geo)})
    pyarrow.parquet.write_table(wrong, out)
    assert "/conf/core/bbox-extent" in validator.failed(validator.check(str(out)))
