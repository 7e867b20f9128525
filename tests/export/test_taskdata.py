"""Task data for a terminal: valid by the standard's schema, and right when read by another."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from lxml import etree

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.shapes import taskdata
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import (
    COARSE_M,
    EXTENT,
    SPRING,
    SUMMER,
    enu,
    geodetic,
    probes,
    track,
    truth,
    write_asymmetric_map,
)

SharedData = Callable[[str], Path]
UNSEEN, FREE, DOUBT, OBSTACLE = 0, 1, 2, 3


class TaskData(NamedTuple):
    """What a terminal finds in a folder: shapes in metres by PROJ, the grid in degrees."""

    boundary: Any
    obstacles: list[Any]
    curves: list[tuple[str, Any]]
    zones: npt.NDArray[np.uint8]
    south_west_deg: tuple[float, float]
    cell_deg: tuple[float, float]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@pytest.fixture(scope="module")
def folder(universal: MapFile, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("usb") / "TASKDATA"
    export_map(universal, out, Selection(cell_m=COARSE_M))
    return out


def read(folder: Path) -> TaskData:
    """By the letters of the standard: PFD > PLN > LSG > PNT, GGP > GPN, TSK > GRD and TZN."""
    root = etree.parse(folder / "TASKDATA.XML").getroot()
    (field,), (task,) = root.findall("PFD"), root.findall("TSK")
    assert task.get("E") == field.get("A")
    boundary = [polygon(p) for p in field.findall("PLN") if p.get("A") == "1"]
    obstacles = [polygon(p) for p in field.findall("PLN") if p.get("A") == "6"]
    curves = []
    for pattern in field.iterfind("GGP/GPN"):
        assert pattern.get("C") == "3"  # a curve
        (line,) = pattern.findall("LSG")
        kinds = [point.get("A") for point in line.findall("PNT")]
        assert (kinds[0], kinds[-1], set(kinds[1:-1]) - {"9"}) == ("6", "7", set())  # A to B
        curves.append((pattern.get("B"), shapely.LineString(places(line))))
    (grid,) = task.findall("GRD")
    assert grid.get("I") == "1"
    content = (folder / f"{grid.get('G')}.bin").read_bytes()
    assert len(content) == int(grid.get("H"))
    named = {zone.get("B"): int(zone.get("A")) for zone in task.findall("TZN")}
    assert named.pop("keep-out") == 4
    assert named == {"not observed": UNSEEN, "free": FREE, "in doubt": DOUBT, "obstacle": OBSTACLE}
    assert {task.get(key) for key in "HIJ"} == {str(UNSEEN)}
    return TaskData(
        shapely.union_all(boundary),
        obstacles,
        curves,
        np.frombuffer(content, dtype=np.uint8).reshape(int(grid.get("F")), int(grid.get("E"))),
        (float(grid.get("A")), float(grid.get("B"))),
        (float(grid.get("C")), float(grid.get("D"))),
    )


def polygon(element: Any) -> Any:
    rings = {"1": [], "2": []}  # type: dict[str, list[Any]]
    for line in element.findall("LSG"):
        rings[line.get("A")].append(places(line))
    (outer,) = rings["1"]
    return shapely.Polygon(outer, rings["2"])


def places(line: Any) -> npt.NDArray[np.float64]:
    lat_lon = np.array([[float(p.get("C")), float(p.get("D"))] for p in line.findall("PNT")])
    east, north, _ = enu(lat_lon[:, 0], lat_lon[:, 1])
    return np.c_[east, north]


def check(data: TaskData) -> None:
    """Obstacles to 5 mm of their edges; zones as seen from a terminal at a position."""
    whole = shapely.union_all(data.obstacles)
    east, north = probes()
    np.testing.assert_array_equal(
        shapely.contains_xy(whole, east, north), truth(east, north).density > 100
    )
    check_zones(data)


def check_zones(data: TaskData) -> None:
    random = np.random.default_rng(11)
    east, north = random.uniform(-12, 16, 4000), random.uniform(-9, 11, 4000)
    true = truth(east, north)
    wanted = np.select(
        [~true.observed, true.density > 100, true.density > 50], [UNSEEN, OBSTACLE, DOUBT], FREE
    )
    # Away from edges, since the grid's cells lie askew to the map's and show the worst in them.
    away = np.ones(len(east), dtype=bool)
    for step_e, step_n in ((0.3, 0), (-0.3, 0), (0, 0.3), (0, -0.3)):
        near = truth(east + step_e, north + step_n)
        away &= (near.density == true.density) & (near.observed == true.observed)
    lat, lon, _ = geodetic(east, north)
    found = zones_at(data, lat, lon)
    assert away.sum() > 3000
    np.testing.assert_array_equal(found[away], wanted[away])
    # And no obstacle is lost anywhere.
    assert (found[wanted == OBSTACLE] == OBSTACLE).mean() > 0.99


def zones_at(
    data: TaskData, lat: npt.NDArray[np.float64], lon: npt.NDArray[np.float64]
) -> npt.NDArray[np.uint8]:
    row = np.floor((lat - data.south_west_deg[0]) / data.cell_deg[0]).astype(int)
    column = np.floor((lon - data.south_west_deg[1]) / data.cell_deg[1]).astype(int)
    rows, columns = data.zones.shape
    inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
    found = np.full(lat.shape, UNSEEN, dtype=np.uint8)
    found[inside] = data.zones[row[inside], column[inside]]
    return found


def test_it_is_valid_by_the_schema(folder: Path, shared_data: SharedData) -> None:
    schema = etree.XMLSchema(
        etree.parse(shared_data("gnss/isoxml_samples/xsd/ISO11783_TaskFile_V4-3.xsd"))
    )
    schema.assertValid(etree.parse(folder / "TASKDATA.XML"))
    assert sorted(path.name for path in folder.iterdir()) == ["GRD00001.bin", "TASKDATA.XML"]


def test_it_comes_back(folder: Path) -> None:
    check(read(folder))


def moved(data: TaskData, wrong: Callable[[Any], Any]) -> TaskData:
    return data._replace(obstacles=[shapely.transform(shape, wrong) for shape in data.obstacles])


@pytest.mark.parametrize(
    "wrong",
    [
        lambda d: moved(d, lambda places: places[:, ::-1]),
        lambda d: moved(d, lambda places: places * np.array([-1.0, 1.0])),
        lambda d: moved(d, lambda places: places + np.array([COARSE_M / 2.0, 0.0])),
        lambda d: moved(d, lambda places: places + np.array([0.0, 0.02])),
        lambda d: d._replace(zones=d.zones[::-1]),
        lambda d: d._replace(zones=d.zones[:, ::-1]),
        lambda d: d._replace(zones=np.ascontiguousarray(d.zones.T)),
        lambda d: d._replace(south_west_deg=d.south_west_deg[::-1]),
        lambda d: d._replace(south_west_deg=(0.0, 0.0)),
        lambda d: d._replace(cell_deg=d.cell_deg[::-1]),
        lambda d: d._replace(zones=np.where(d.zones == UNSEEN, FREE, d.zones)),
    ],
)
def test_wrong_task_data_is_found(folder: Path, wrong: Callable[[TaskData], TaskData]) -> None:
    with pytest.raises(AssertionError):
        check(wrong(read(folder)))


def test_the_boundary_is_the_ground_that_was_mapped(folder: Path) -> None:
    root = etree.parse(folder / "TASKDATA.XML").getroot()
    assert read(folder).boundary.symmetric_difference(shapely.box(*EXTENT)).area < 0.1
    assert root.find("PFD").get("D") == "384"  # 24 x 16 m
    assert root.find("PFD").get("C") == "f"


def test_curves_are_the_forward_drives(folder: Path) -> None:
    curves = read(folder).curves
    assert {name.split()[0] for name, _ in curves} == {SPRING, SUMMER}
    spring = [line for name, line in curves if name.startswith(SPRING)]
    (line,) = spring  # its reverse is left out
    drive = track(SPRING)
    forward = shapely.LineString(np.c_[drive.east_m, drive.north_m][drive.gear > 0])
    assert shapely.hausdorff_distance(line, forward) < 0.06
    assert line.coords[0] == pytest.approx(forward.coords[0], abs=0.001)


def test_what_is_said_is_what_is_written(universal: MapFile, tmp_path: Path) -> None:
    done = export_map(universal, tmp_path / "TASKDATA", Selection(cell_m=COARSE_M))
    written = read(tmp_path / "TASKDATA")
    rows, columns = written.zones.shape
    assert dict(done.rows) == {
        "obstacles": str(len(written.obstacles)),
        "guidance curves": str(len(written.curves)),
        "grid of zones": f"{columns} x {rows}",
    }


def test_the_library_reads_it_too(folder: Path) -> None:
    from isoxml.util.isoxml_io import isoxml_from_path

    document, files = isoxml_from_path(folder)
    assert len(document.partfields[0].polygons) > 3
    assert list(files) == ["GRD00001"]


def test_what_cannot_be(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "TASKDATA"
    with pytest.raises(ConfigError, match="cannot hold the layer 'max', only what is traced"):
        export_map(universal, out, Selection(layer="max"))
    with pytest.raises(ConfigError, match="hold nothing of the map"):
        export_map(universal, out, Selection(Bounds(50.0, 50.0, 60.0, 60.0)))
    with monkeypatch.context() as patch:
        patch.setattr(taskdata, "MAX_GRID_CELLS", 1000)
        with pytest.raises(ConfigError, match="too large for a terminal; give a larger --cell"):
            export_map(universal, out)
    assert list(tmp_path.iterdir()) == []
    out.mkdir()
    (out / "TASKDATA.XML").write_text("<a/>")
    (out / "TLG00001.bin").write_text("the log of a terminal")
    with pytest.raises(MapExistsError, match="holds other things than exported task data"):
        export_map(universal, out, overwrite=True)
    assert (out / "TLG00001.bin").read_text() == "the log of a terminal"


def test_a_full_disk_leaves_nothing(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(taskdata, "_write", full)
    with pytest.raises(OSError, match="No space left"):
        export_map(universal, tmp_path / "TASKDATA")
    assert list(tmp_path.iterdir()) == []


def test_task_data_in_one_file_are_those_of_the_folder(
    universal: MapFile, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "TASKDATA.zip"
    for _ in range(2):
        export_map(universal, out, Selection(cell_m=COARSE_M), overwrite=True)
    with zipfile.ZipFile(out) as archive:
        packed = {Path(name).name: archive.read(name) for name in archive.namelist()}
        assert {Path(name).parent.name for name in archive.namelist()} == {"TASKDATA"}
    assert packed == {file.name: file.read_bytes() for file in folder.iterdir()}
    with zipfile.ZipFile(out, "a") as archive:
        archive.writestr("TASKDATA/TLG00001.bin", "work")
    with pytest.raises(MapExistsError, match="give another name"):
        export_map(universal, out, Selection(cell_m=COARSE_M), overwrite=True)
    assert list(tmp_path.iterdir()) == [out]
