"""Lanes and tracks as swaths of task data: valid by the schema, and right when read by another."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from lxml import etree

from fieldgrid.export import Selection, TaskdataOptions, export_taskdata
from fieldgrid.field import Lane, Planting
from fieldgrid.field.rows.result import Block
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import COARSE_M, write_asymmetric_map
from tests.export.test_taskdata import places, polygon

SharedData = Callable[[str], Path]
STRAIGHT = [(-9.0, -6.0), (3.0, 7.0)]
BENT = [(-5.0, -7.0), (0.0, -4.0), (7.0, -3.0)]
GROUND = shapely.box(-11.0, -8.0, 9.0, 9.0).difference(shapely.box(5.0, 4.0, 7.0, 5.0))


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@pytest.fixture(scope="module")
def root(universal: MapFile, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The file, of a straight and a bent track 2.4 m wide on ground with a hole."""
    lanes = []
    for name, corners in (("F1-T1", STRAIGHT), ("F1-T2", BENT)):
        line = shapely.LineString(corners)
        area = line.buffer(1.2, cap_style="flat", join_style="mitre")
        area = area if name == "F1-T1" else shapely.box(0.0, 0.0, line.length, 2.4)
        lanes.append(Lane(name, "F1", ("", ""), line, area, line.length, np.nan, np.zeros(0), 1.0,
                          False))  # fmt: skip
    blocks = (Block("F1", GROUND, 0, 2, 42.0, 2.4),)
    planting = Planting(universal.datum, universal.bounds, 0.2, (), tuple(lanes), (), (), blocks,
                        ())  # fmt: skip
    out = tmp_path_factory.mktemp("usb") / "tracks.taskdata.zip"
    export_taskdata(
        universal, out, Selection(cell_m=COARSE_M), TaskdataOptions(), overwrite=False,
        planting=planting,
    )  # fmt: skip
    with zipfile.ZipFile(out) as archive:
        return etree.parse(BytesIO(archive.read("TASKDATA/TASKDATA.XML")))


def test_it_is_valid_by_the_schema(root: Any, shared_data: SharedData) -> None:
    schema = etree.XMLSchema(
        etree.parse(shared_data("gnss/isoxml_samples/xsd/ISO11783_TaskFile_V4-3.xsd"))
    )
    schema.assertValid(root)


def test_a_straight_track_is_an_ab_line_and_a_bent_one_a_curve(root: Any) -> None:
    """From A to B in their own direction, with the width; nothing is repeated beside them."""
    (group,) = root.findall("PFD/GGP")
    assert group.get("B") == "F1"
    straight, bent = group.findall("GPN")
    for pattern, name, kind, corners, between in (
        (straight, "F1-T1", "1", STRAIGHT, 0),
        (bent, "F1-T2", "3", BENT, 1),
    ):
        assert (pattern.get("B"), pattern.get("C")) == (name, kind)
        assert (pattern.get("E"), pattern.get("F")) == ("4", "4")  # not repeated, not carried on
        assert (pattern.get("N"), pattern.get("O")) == ("0", "0")
        (line,) = pattern.findall("LSG")
        assert (line.get("A"), line.get("C")) == ("5", "2400")
        kinds = [point.get("A") for point in line.findall("PNT")]
        assert kinds == ["6", *["9"] * between, "7"]
        assert np.allclose(places(line), corners, atol=0.01)
    assert len({pattern.get("A") for pattern in (straight, bent)}) == 2


def test_the_boundary_keeps_its_hole(root: Any) -> None:
    (outline,) = root.findall("PFD/GGP/PLN")
    assert outline.get("A") == "1"
    found = polygon(outline)
    assert len(found.interiors) == 1
    assert found.symmetric_difference(GROUND).area < 0.01 * GROUND.length
    assert shapely.hausdorff_distance(found.boundary, GROUND.boundary) < 0.01
