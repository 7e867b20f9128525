"""A QGIS project: what is in it, and what QGIS itself makes of it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.geometry import Bounds
from fieldgrid.maps import Mark, MarkKind, open_map
from tests.maps.file.maps import drive, track, write_map
from tests.maps.file.test_qgis import PYTHON, is_there

UPPERMOST_FIRST = ["footprint", "frame_position", "trajectory", "density"]

PROGRAM = """
import json, os, sys
from qgis.core import QgsApplication, QgsMapLayerType, QgsProject
application = QgsApplication([], False)
application.initQgis()
project = QgsProject.instance()
result = {"read": project.read(sys.argv[1]), "layers": {}}
for node in project.layerTreeRoot().findLayers():
    layer = node.layer()
    about = {"valid": layer.isValid(), "visible": node.isVisible(), "kind": layer.renderer().type()}
    if layer.type() == QgsMapLayerType.VectorLayer:
        about["count"] = layer.featureCount()
        about["rules"] = [rule.label() for rule in layer.renderer().rootRule().children()]
        about["time"] = layer.temporalProperties().startField()
        if layer.labelsEnabled():
            about["labelled by"] = layer.labeling().settings().fieldName
    result["layers"][node.layerId()] = about
result["from"] = project.timeSettings().temporalRange().begin().toString("yyyy-MM-dd")
print(json.dumps(result))
sys.stdout.flush()
os._exit(0)  # QGIS may crash when it is taken down in the wrong order
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_map(tmp_path / "field 1.gpkg", [drive(2), drive(1)], trajectory=track(4))


def document(project: Path) -> ET.Element:
    with zipfile.ZipFile(project) as archive:
        (name,) = archive.namelist()
        assert name == f"{project.stem}.qgs"
        return ET.fromstring(archive.read(name))


def test_the_layers_are_in_order_and_refer_to_the_map(path: Path, tmp_path: Path) -> None:
    (tmp_path / "gis").mkdir()
    with open_map(path) as universal:
        export_map(universal, tmp_path / "gis" / "p.qgz")
    root = document(tmp_path / "gis" / "p.qgz")
    tree = root.iter("layer-tree-layer")
    assert [layer.get("id") for layer in tree] == [f"fieldgrid_{name}" for name in UPPERMOST_FIRST]
    sources = [layer.findtext("datasource") for layer in root.iter("maplayer")]
    assert sources[0] == "GPKG:../field 1.gpkg:density"
    assert sources[1] == "../field 1.gpkg|layername=trajectory"
    systems = {element.text for element in root.iter("wkt")}
    assert len(systems) == 1


def test_the_project_opens_where_it_was_asked_to(path: Path, tmp_path: Path) -> None:
    bounds = Bounds(-4.0, 4.0, 0.0, 8.0)
    with open_map(path) as universal:
        export_map(universal, tmp_path / "p.qgz", Selection(bounds))
        with pytest.raises(ConfigError):
            export_map(universal, tmp_path / "q.qgz", Selection(Bounds(900.0, 0.0, 901.0, 1.0)))
    extent = document(tmp_path / "p.qgz").find("mapcanvas/extent")
    assert extent is not None
    seen = [float(edge.text or "nan") for edge in extent]
    assert seen == pytest.approx([-4.12, 3.88, 0.12, 8.12])  # with a margin


def test_what_a_project_cannot_show_is_refused(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.qgz"
    with open_map(path) as universal:
        for selection, says in (
            (Selection(layer="count"), "geotiff"),
            (Selection(cell_m=0.5), "--cell"),
            (Selection(at="0"), "--at"),
        ):
            with pytest.raises(ConfigError, match=says):
                export_map(universal, out, selection)
        assert not out.exists()
        export_map(universal, out)
        with pytest.raises(MapExistsError):
            export_map(universal, out)


def test_qgis_opens_it_where_map_and_project_have_been_moved_to(path: Path, tmp_path: Path) -> None:
    if not is_there():
        pytest.skip("QGIS's library (Debian's python3-qgis) is not installed")
    with open_map(path, writable=True) as universal:
        universal.add_marks(
            [
                Mark(MarkKind.KEEPOUT, ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0)), "pond"),
                Mark(MarkKind.PLACE, ((1.0, 2.0),), "gate"),
                Mark(MarkKind.PLACE, ((2.0, 2.0),), "well"),
            ]
        )
        first_ns = min(info.first_time_ns or 0 for info in universal.sessions())
        moment = str(np.datetime64(first_ns, "ns"))[:10]
        export_map(universal, tmp_path / "p.qgz")
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for file in (path, tmp_path / "p.qgz"):
        shutil.move(file, moved)
    done = subprocess.run(
        [PYTHON, "-c", PROGRAM, str(moved / "p.qgz")],
        capture_output=True, text=True, timeout=120, check=False,
        env={
            "PATH": os.environ["PATH"],
            "HOME": str(tmp_path),
            "QT_QPA_PLATFORM": "offscreen",
            "XDG_RUNTIME_DIR": str(tmp_path),
        },
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    layers = found["layers"]
    assert found["read"]
    marks = ["mark_point", "mark_area"]
    assert list(layers) == [f"fieldgrid_{name}" for name in [*marks, *UPPERMOST_FIRST]]
    assert [layers[f"fieldgrid_{name}"]["count"] for name in marks] == [2, 1]
    for name in marks:
        assert layers[f"fieldgrid_{name}"]["rules"][0] == "keep out"
        assert layers[f"fieldgrid_{name}"]["labelled by"] == "name"
    assert all(layer["valid"] for layer in layers.values())
    visible = [layer["visible"] for layer in layers.values()]
    assert visible == [True, True, True, False, True, True]
    assert layers["fieldgrid_density"]["kind"] == "singlebandpseudocolor"
    assert layers["fieldgrid_trajectory"]["rules"] == ["0", "1", "rejected", "other sessions"]
    assert layers["fieldgrid_trajectory"]["time"] == "time"
    assert layers["fieldgrid_footprint"]["count"] == 3
    assert found["from"] == moment
