from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil

from fieldgrid.core import ConfigError, MapExistsError, MapWriteError
from fieldgrid.export import Selection, export_map
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import write_asymmetric_map
from tests.export.placed import Picture, faults, faults_at_centres, mutants, opened

SIDECARS = ["f.pgw", "f.png", "f.png.aux.xml", "f.prj"]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def by_hand(path: Path) -> Picture:
    """The picture by its world file and .prj alone, decoded without GDAL."""
    blue, green, red, alpha = cv2.split(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(blue, green)
    np.testing.assert_array_equal(blue, red)
    a, d, b, e, x, y = map(float, path.with_suffix(".pgw").read_text().split())
    assert (b, d) == (0.0, 0.0)
    # The world file gives the centre of the upper left pixel.
    wkt = path.with_suffix(".prj").read_text()
    return Picture(blue, alpha > 0, wkt, a, x - a / 2, e, y - e / 2)


@pytest.mark.parametrize("cell_m", [None, 0.25])
@pytest.mark.parametrize("layer", ["density", "max"])
def test_it_lands_in_its_place_by_either_sidecar(
    layer: str, cell_m: float | None, universal: MapFile, tmp_path: Path
) -> None:
    path = tmp_path / "f.png"
    done = export_map(universal, path, Selection(cell_m=cell_m, layer=layer))
    assert sorted(file.name for file in tmp_path.iterdir()) == SIDECARS
    assert sorted(file.name for file in done.paths) == SIDECARS
    assert done.paths[0] == path
    assert faults(by_hand(path), layer) == []
    assert faults(opened(path), layer) == []
    with rasterio.open(path) as dataset:
        assert float(dataset.tags()["FIELDGRID_DATUM_HEIGHT_M"]) == 742.0


def test_gdal_reads_the_world_file_where_its_own_notes_are_lost(
    universal: MapFile, tmp_path: Path
) -> None:
    export_map(universal, tmp_path / "f.png")
    (tmp_path / "f.png.aux.xml").unlink()
    with rasterio.open(tmp_path / "f.png") as dataset:
        assert tuple(dataset.bounds) == pytest.approx((-10.0, -7.0, 14.0, 9.0))


def test_mistakes_do_not_go_unnoticed(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "f.png")
    for mistake, wrong in mutants(by_hand(tmp_path / "f.png")).items():
        assert faults(wrong), mistake


def test_in_another_system(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "f.png", options={"epsg": 25830})
    assert faults_at_centres(by_hand(tmp_path / "f.png")) == []


@pytest.mark.parametrize("layer", ["count", "variance", "sessions", "persistence", "height"])
def test_layers_of_more_than_8_bits_are_refused(
    layer: str, universal: MapFile, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=f"png cannot hold the layer '{layer}'"):
        export_map(universal, tmp_path / "f.png", Selection(layer=layer))
    assert list(tmp_path.iterdir()) == []


def test_pictures_that_few_programs_open_are_refused(universal: MapFile, tmp_path: Path) -> None:
    for wide in (Bounds(0.0, 0.0, 4000.0, 1.0), Bounds(0.0, 0.0, 1700.0, 1700.0)):
        with pytest.raises(ConfigError, match="more than usual programs open"):
            export_map(universal, tmp_path / "f.png", Selection(wide))
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_replaced_only_when_asked(universal: MapFile, tmp_path: Path) -> None:
    world = tmp_path / "f.pgw"
    world.write_text("mine")
    with pytest.raises(MapExistsError, match=r"f\.pgw exists already"):
        export_map(universal, tmp_path / "f.png")
    assert [file.name for file in tmp_path.iterdir()] == ["f.pgw"]
    assert world.read_text() == "mine"
    export_map(universal, tmp_path / "f.png", overwrite=True)
    assert sorted(file.name for file in tmp_path.iterdir()) == SIDECARS


def test_a_picture_that_is_cut_short_is_none(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(source: Path, target: Path, **options: object) -> None:
        copy(source, target, **options)
        Path(target).write_bytes(Path(target).read_bytes()[:-1])

    copy = rasterio.shutil.copy
    monkeypatch.setattr(rasterio.shutil, "copy", cut)
    with pytest.raises(MapWriteError, match="cut the picture short"):
        export_map(universal, tmp_path / "f.png")
    assert list(tmp_path.iterdir()) == []
