"""The viewer as a user works with it, in a real browser."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import Bool, UInt8, palette
from fieldgrid.maps import open_map
from tests.conftest import ROOT
from tests.view.serving import Server

AXE = ROOT / "page" / "node_modules" / "axe-core" / "axe.min.js"
OBSTACLE = palette.rgb(palette.DENSITY[-1].colour)
FREE = palette.rgb(palette.DENSITY[0].colour)


def is_colour(pixels: UInt8, colour: tuple[int, int, int], within: int = 40) -> Bool:
    return np.abs(pixels.astype(int) - np.array(colour)).max(axis=-1) <= within


def test_a_map_opens_with_its_cells_and_nothing_from_outside(look: Any, server: Server) -> None:
    page = look(server.link)
    pixels = page.map_pixels()
    assert is_colour(pixels, FREE).sum() > 5_000
    assert is_colour(pixels, OBSTACLE).sum() > 200
    assert page.page.title() == "vineyard · fieldgrid"
    assert page.page.locator(".ol-scale-line-inner").text_content().endswith(" m")
    # The token is not left in the address, where a screenshot would show it.
    assert "token" not in page.page.url
    assert page.asked("/tiles/density/")


def test_cells_are_drawn_where_they_are(
    look: Any, server: Server, vineyard: Path, obstacle: tuple[float, float]
) -> None:
    page = look(server.link)
    x, y = page.place(*obstacle)
    page.page.mouse.move(x, y)
    for _ in range(12):
        page.page.mouse.wheel(0, -400)
        page.page.wait_for_timeout(30)
    page.page.wait_for_timeout(400)
    page.settle()
    with open_map(vineyard) as universal:
        view = universal.read()
    pixels = page.map_pixels()
    box = page.page.locator("#map").bounding_box()
    checked = 0
    for row, column in np.ndindex(9, 9):
        at = (box["width"] * (column + 0.7) / 10, box["height"] * (row + 0.7) / 10)
        page.page.mouse.move(box["x"] + at[0], box["y"] + at[1])
        east, north = page.position()
        i, j = (int(index) for index in view.lattice.index(east, north))
        near = (abs(value / 0.05 - round(value / 0.05)) < 0.1 for value in (east, north))
        if any(near):
            continue  # the page says centimetres: too near to a cell's edge to tell
        density = view.density[j - view.window.j0, i - view.window.i0]
        colour = pixels[int(at[1]), int(at[0])]
        is_red = int(colour[0]) > int(colour[1]) + 50 or colour.max() < 110
        if view.observed[j - view.window.j0, i - view.window.i0]:
            assert is_red == (density > 100), (east, north, density, colour)
            checked += 1
    assert checked > 10


def test_panning_and_the_position_under_the_pointer(
    look: Any, server: Server, vineyard: Path
) -> None:
    page = look(server.link)
    x, y = page.place(-10.0, 55.0)
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 120, y - 60, steps=4)
    page.page.mouse.up()
    page.page.wait_for_timeout(600)  # it glides on for a moment
    moved = page.place(-10.0, 55.0)
    assert moved[0] - x > 60
    assert moved[1] - y < -30
    page.page.mouse.move(*moved)
    text = page.page.locator("#readout").text_content()
    with open_map(vineyard) as universal:
        lat, lon, _ = universal.datum.to_geodetic(*page.position(), 0.0)
    shown = [float(part) for part in re.findall(r"(-?\d+\.\d+)°", text)]
    assert shown == pytest.approx([float(lat), float(lon)], abs=2e-7)


def test_another_layer_has_its_own_legend(look: Any, server: Server) -> None:
    page = look(server.link)
    page.page.select_option("#layer", "count")
    page.page.wait_for_selector("#legend >> text=frames that observed the cell")
    page.settle()
    assert page.asked("/tiles/count/")
    pixels = page.map_pixels()
    assert is_colour(pixels, FREE, 10).sum() < 500
    low = palette.rgb(palette.VALUES[1].colour)
    assert is_colour(pixels, low).sum() > 2_000


def test_why_is_there_an_obstacle(look: Any, server: Server, obstacle: tuple[float, float]) -> None:
    page = look(server.link)
    page.click_map(*obstacle)
    page.page.wait_for_selector("#verdict >> text=Obstacle")
    values = page.page.locator("#values").inner_text()
    assert re.search(r"density\s+\d{3}", values)
    assert "sigma of the density" in values
    assert page.page.locator("#other-values").is_hidden()
    page.page.click("#evidence >> text=Other layers")
    assert re.search(r"highest density\s+\d", page.page.locator("#other-values").inner_text())
    # The two photographs that say so, with the cell marked in each.
    page.page.wait_for_selector("#evidence ol.frames > li:first-child img >> nth=1")
    photos = page.page.locator("#evidence ol.frames > li:first-child .photo")
    assert photos.count() == 2
    for k in range(2):
        photo, place = (photos.nth(k).locator(part).bounding_box() for part in ("img", ".place"))
        assert 1.0 < place["width"] < photo["width"] / 3
        assert photo["x"] - 3 <= place["x"] <= photo["x"] + photo["width"]
    images = page.page.evaluate(
        "[...document.querySelectorAll('#evidence img')]"
        ".map((image) => [image.naturalWidth, image.naturalHeight])"
    )
    assert images[:2] == [[640, 480], [640, 480]]
    page.page.keyboard.press("Escape")
    assert page.page.locator("#evidence").is_hidden()


def test_sessions_switched_off_and_two_states_beside_each_other(look: Any, server: Server) -> None:
    page = look(server.link)

    def red(part: slice) -> int:
        page.settle()
        r, g, b = np.moveaxis(page.map_pixels()[:, part].astype(int), -1, 0)
        return int(((r > g + 55) & (r > b + 40)).sum())

    half = page.page.locator("#map").bounding_box()["width"] // 2
    left, right = slice(0, int(half) - 4), slice(int(half) + 4, None)
    page.page.locator("#session-1").uncheck()
    june = red(left), red(right)
    page.page.locator("#session-1").check()
    page.page.locator("#session-0").uncheck()
    assert red(slice(None)) == 0  # august saw none
    page.page.locator("#session-0").check()
    both = red(left), red(right)
    assert both[0] < june[0]  # half of what june saw as obstacle is thinned by august's mean

    page.page.locator("#compare > summary").click()
    page.page.select_option("#compare-mode", "swipe")
    page.page.select_option("#compare-before", "0")
    page.page.select_option("#compare-after", "1")
    swiped = red(left), red(right)
    assert swiped[0] == pytest.approx(june[0], rel=0.02)
    assert swiped[1] == pytest.approx(both[1], rel=0.02)
    page.page.locator("#compare-share").fill("0")
    assert red(left) == pytest.approx(both[0], rel=0.02)

    page.page.select_option("#compare-mode", "change")
    page.page.wait_for_selector("#legend >> text=obstacle that vanished")
    page.settle()
    vanished = palette.rgb(palette.CHANGES["vanished"])
    assert is_colour(page.map_pixels(), vanished, 10).sum() > 100


def test_what_changed_is_listed_outlined_and_shown(look: Any, with_crate: Server) -> None:
    page = look(with_crate.link)
    page.page.locator("#compare > summary").click()
    page.page.select_option("#compare-mode", "change")
    found = page.page.locator("#change-list button")
    assert found.text_content() == "c1 appeared"
    assert "free: first" in page.page.locator("#change-list").text_content()
    found.click()
    page.settle()
    seen = page.page.locator("#map").get_attribute("data-extent")
    west, south, east, north = map(float, seen.split())
    assert west < -1.5 < -0.7 < east
    assert south < 4.0 < 4.6 < north
    assert min(east - west, north - south) < 8.0
    x, y = page.place(-1.1, 4.3)
    box = page.page.locator("#map").bounding_box()
    near = page.map_pixels()[int(y - box["y"]) - 80 :, int(x - box["x"]) - 80 :][:160, :160]
    assert (near.max(axis=-1) < 30).sum() > 100  # its black outline
    page.page.select_option("#compare-mode", "off")
    assert page.page.locator("#change-list li").count() == 0


def test_time_lines_and_map_point_at_each_other(look: Any, server: Server, vineyard: Path) -> None:
    page = look(server.link)
    page.page.click("#show-timeline")
    page.page.wait_for_selector(".charts figure >> nth=4")
    chart = page.page.locator(".charts figure .u-over").first.bounding_box()
    before = page.map_pixels()
    page.page.mouse.move(chart["x"] + 0.4 * chart["width"], chart["y"] + 10)
    page.page.wait_for_selector("#timeline-text >> text=heading")
    from_chart = page.page.locator("#timeline-text").text_content()
    page.settle()
    assert (before != page.map_pixels()).any()  # the pose is marked

    with open_map(vineyard) as universal:
        track = universal.trajectory("two_lanes")
    row = len(track) // 3
    page.page.mouse.move(*page.place(float(track.east_m[row]), float(track.north_m[row])))
    page.page.wait_for_function(
        "(old) => document.querySelector('#timeline-text').textContent !== old", arg=from_chart
    )
    said = page.page.locator("#timeline-text").text_content()
    heading = float(re.search(r"heading (-?[\d.]+)", said)[1])  # type: ignore[index]
    assert heading == pytest.approx(float(track.heading_deg[row]), abs=5.0)
    # With the keyboard, too.
    page.page.locator("#timeline-row").focus()
    page.page.keyboard.press("Home")
    first = page.page.locator("#timeline-text").text_content()
    assert first.startswith(str(track.time_ns[0].astype("datetime64[ns]"))[:10])


def test_on_a_phone(look: Any, server: Server, obstacle: tuple[float, float]) -> None:
    page = look(server.link, size=(400, 780), has_touch=True, is_mobile=True)
    assert page.page.locator("#panels").is_hidden()
    assert page.page.evaluate("document.documentElement.scrollWidth") == 400
    page.page.touchscreen.tap(*page.place(*obstacle))
    page.page.wait_for_selector("#verdict >> text=Obstacle")
    page.page.wait_for_timeout(200)
    sheet = page.page.locator("#evidence").bounding_box()
    assert sheet["width"] == 400
    _, y = page.place(*obstacle)
    assert y < sheet["y"]  # the cell that was asked about is still seen
    page.page.locator("#evidence .close").tap()
    page.page.locator("#show-panels").tap()
    assert page.page.locator("#layer").is_visible()
    assert page.page.evaluate("document.documentElement.scrollWidth") == 400


def test_by_keyboard_alone(look: Any, server: Server) -> None:
    page = look(server.link)
    page.page.locator("#map").focus()
    middle = page.position()
    page.page.keyboard.press("ArrowUp")
    page.page.wait_for_timeout(500)
    assert page.position()[1] > middle[1]
    page.page.keyboard.press("Enter")
    page.page.wait_for_selector("#verdict")
    page.page.keyboard.press("Escape")
    assert page.page.evaluate("document.activeElement.id") == "map"


def test_a_distance_is_measured_in_metres(look: Any, server: Server) -> None:
    page = look(server.link)
    start, end = page.place(-10.0, 50.0), page.place(2.0, 66.0)
    page.page.click("#measure-length")
    page.page.mouse.click(*start)
    page.page.mouse.dblclick(*end)
    said = page.page.locator("#tool-says").text_content()
    assert float(said.split()[0]) == pytest.approx(20.0, abs=0.3)
    page.page.keyboard.press("Escape")
    assert page.page.locator("#tool-says").text_content() == ""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_serious_in_the_way_of_anybody(
    scheme: str, look: Any, server: Server, obstacle: tuple[float, float]
) -> None:
    if not AXE.exists():
        pytest.skip("axe-core is not installed (npm ci in page/)")
    page = look(server.link, color_scheme=scheme)
    page.page.click("#show-timeline")
    page.page.locator("#compare > summary").click()
    page.click_map(*obstacle)
    page.page.wait_for_selector("#evidence img >> nth=1")
    # Evaluated by the driver, which the page's policy does not bind.
    page.page.evaluate(AXE.read_text())
    found = page.page.evaluate(
        "axe.run().then((result) => result.violations.map((one) => "
        "[one.impact, one.id, one.nodes.map((n) => `${n.html} ${n.failureSummary}`)]))"
    )
    assert [one for one in found if one[0] in ("serious", "critical")] == []


def test_what_goes_wrong_is_said(look: Any, vineyard: Path, tmp_path: Path) -> None:
    """A map that is no longer there, while its page is open."""
    from tests.view.serving import serving

    path = tmp_path / "here.gpkg"
    path.write_bytes(vineyard.read_bytes())
    with serving(path) as server:
        page = look(server.link)
        page.expected = ("409", "Failed to load")
        path.unlink()
        page.click_map(-10.0, 55.0)
        page.page.wait_for_selector("#evidence .error")
        assert "here.gpkg" in page.page.locator("#evidence .error").text_content()
        page.page.wait_for_timeout(100)
        page.close = lambda: page.context.close()
