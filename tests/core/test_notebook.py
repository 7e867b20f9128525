"""How values look in a notebook."""

from __future__ import annotations

import io
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from fieldgrid.core import notebook, palette
from fieldgrid.maps import open_map
from tests.maps.file.maps import drive, track, write_map


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_map(tmp_path / "a <b>.gpkg", [drive(2), drive(1)], trajectory=track(7))


def test_a_map_and_its_sessions_are_tables(path: Path) -> None:
    with open_map(path, writable=True) as universal:
        universal.remove_session("1")
        text = universal._repr_html_()
        one = universal.sessions()[0]._repr_html_()
    assert "<td>a &lt;b&gt;.gpkg</td>" in text
    assert text.count("<tr>") == 3 + 3
    assert "removed" in text
    assert "2 of 2" in one
    assert "removed" not in one
    assert "closed" in universal._repr_html_()


def test_a_view_is_a_picture_of_its_cells(path: Path) -> None:
    with open_map(path) as universal:
        view = universal.read()
    pixels = np.asarray(Image.open(io.BytesIO(view._repr_png_())))[::-1]
    assert pixels.shape == (*view.density.shape, 3)
    assert (pixels[~view.observed] == palette.rgb(palette.UNSEEN)).all()
    red = pixels[..., 0].astype(int) > pixels[..., 1].astype(int) + 40
    dense = view.observed & (view.density > 100)
    assert red[dense].all()
    assert not red[view.observed & (view.density < 50)].any()


def test_a_large_picture_keeps_single_obstacles() -> None:
    values = np.zeros((3000, 2500), dtype=np.uint8)
    known = np.ones_like(values, dtype=np.bool_)
    values[1234, 2345] = 255
    known[:, :600] = False
    pixels = np.asarray(Image.open(io.BytesIO(notebook.picture(values, known, palette.DENSITY))))
    assert max(pixels.shape) <= 1024
    worst = (pixels == palette.rgb(palette.DENSITY[-1].colour)).all(axis=-1)
    assert np.argwhere(worst[::-1]).tolist() == [[1234 // 3, 2345 // 3]]
    assert (pixels[:, 0] == palette.rgb(palette.UNSEEN)).all()


def test_a_trajectory_is_its_path_by_gear(path: Path) -> None:
    with open_map(path) as universal:
        found = universal.trajectory("0")
    text = found._repr_html_()
    assert f"{len(found)}, {found.accepted.sum()} accepted" in text
    svg = re.match(r"<svg.*</svg>", text)
    assert svg is not None
    strokes = {line.get("stroke") for line in ET.fromstring(svg[0])}
    assert strokes <= set(palette.GEARS.values())


def test_lines_are_to_scale_and_thinned() -> None:
    east = np.linspace(0.0, 100.0, 50_000)
    text = notebook.drawing([notebook.Line("#123456", east, east / 2.0)])
    (line,) = ET.fromstring(text)
    points = [tuple(map(float, one.split(","))) for one in (line.get("points") or "").split()]
    assert len(points) <= 2001
    (x0, y0), (x1, y1) = points[0], points[-1]
    assert (x1 - x0) == pytest.approx(2 * (y0 - y1), abs=0.2)  # north is up
    nowhere = np.full(3, np.nan)
    assert notebook.drawing([notebook.Line("#123456", nowhere, nowhere)]) == ""
