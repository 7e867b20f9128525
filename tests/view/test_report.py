"""A page to send: one file that shows a map, and asks nobody for anything."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fieldgrid.core import ConfigError, palette
from fieldgrid.geometry import Bounds
from fieldgrid.maps import Mark, MarkKind, open_map
from fieldgrid.view import report, write_report
from tests.maps.file.maps import drive, track, write_map
from tests.view.test_page import FREE, OBSTACLE, is_colour


def data_of(page: Path) -> dict[str, Any]:
    (found,) = re.findall(r'id="fieldgrid-data">(.*?)</script>', page.read_text())
    result: dict[str, Any] = json.loads(found)
    return result


def check_tiles(data: dict[str, Any], path: Path, number: int) -> int:
    """Every tile of the finest level is what the map says of cells as large; how many there are."""
    about, tiles = data["about"]["maps"][number], data["maps"][number]["tiles"]
    count, cell_m = 0, about["cell_m"]
    with open_map(path) as universal:
        for key, text in tiles.items():
            level, ty, tx = (int(part) for part in key.split("/"))
            if level:
                continue
            west_m, south_m = 256 * cell_m * tx, 256 * cell_m * ty
            bounds = Bounds(west_m, south_m, west_m + 256 * cell_m, south_m + 256 * cell_m)
            view = universal.read(bounds, cell_m)
            found = np.asarray(Image.open(io.BytesIO(base64.b64decode(text))))[::-1]
            np.testing.assert_array_equal(found[..., 1] > 0, view.observed)
            np.testing.assert_array_equal(found[..., 0][view.observed], view.density[view.observed])
            count += 1
    return count


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Its name would end a script, were it not taken care of."""
    return write_map(tmp_path / "<b>&.gpkg", [drive(2), drive(1)], trajectory=track(4))


def test_a_page_has_the_map(path: Path, tmp_path: Path) -> None:
    with open_map(path, writable=True) as universal:
        universal.add_marks([Mark(MarkKind.PLACE, ((1.0, 2.0),), "gate")])
    out = tmp_path / "report.html"
    report = write_report([path, path], out)
    assert report.size_bytes == out.stat().st_size
    assert [mark["name"] for mark in data_of(out)["about"]["maps"][1]["marks"]] == ["gate"]
    assert report.cells_m == (0.1, 0.1)
    data = data_of(out)
    assert [one["name"] for one in data["about"]["maps"]] == ["<b>&", "<b>&"]
    assert check_tiles(data, path, 0) == check_tiles(data, path, 1) > 0
    assert data["maps"][0]["tracks"]["0"]["rows"] == 4
    assert data["maps"][0]["frames"]["of"] == 3
    text = out.read_text()
    assert "<title>&lt;b>&amp;, &lt;b>&amp;</title>" in text
    assert "<b>" not in text.partition("<!--\n")[0]
    assert "BSD-2-Clause" in text.partition("<!--\n")[2]


def test_what_is_too_large_is_left_out_from_the_finest_level(
    vineyard: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = write_report([vineyard], tmp_path / "whole.html")
    assert whole.cells_m == (0.05,)
    levels = data_of(tmp_path / "whole.html")["about"]["maps"][0]["levels"]
    monkeypatch.setattr(report, "MAX_BYTES", whole.size_bytes - 20_000)
    less = write_report([vineyard], tmp_path / "less.html")
    assert less.size_bytes <= whole.size_bytes - 20_000
    times = less.cells_m[0] / 0.05
    assert times in (2.0, 4.0, 8.0)
    data = data_of(tmp_path / "less.html")
    assert data["about"]["maps"][0]["levels"] == levels - int(np.log2(times))
    assert check_tiles(data, vineyard, 0) > 0
    monkeypatch.setattr(report, "MAX_BYTES", 100_000)
    with pytest.raises(ConfigError, match="fewer maps"):
        write_report([vineyard], tmp_path / "none.html")
    assert not (tmp_path / "none.html").exists()


def test_a_page_opens_from_the_disk(
    look: Any, vineyard: Path, obstacle: tuple[float, float], tmp_path: Path
) -> None:
    write_report([vineyard], tmp_path / "report.html")
    page = look((tmp_path / "report.html").as_uri())
    assert page.page.title() == "vineyard · fieldgrid"
    pixels = page.map_pixels()
    assert is_colour(pixels, FREE).sum() > 5_000
    assert is_colour(pixels, OBSTACLE).sum() > 200
    assert is_colour(pixels, palette.rgb(palette.session_colour(0)), 20).sum() > 100  # its path
    # A cell says its value; what only the map knows is not offered.
    page.click_map(*obstacle)
    page.page.wait_for_selector("#verdict >> text=Obstacle")
    page.click_map(-20.0, 75.0)
    page.page.wait_for_selector("#verdict >> text=Never seen")
    for button in ("#export", "#compare", ".sessions button"):
        assert page.page.locator(button).count() == 0
    page.page.click("#show-timeline")
    page.page.wait_for_selector(".charts figure >> nth=4")
    assert [url for url in page.requests if not url.startswith(("file:", "blob:", "data:"))] == []
