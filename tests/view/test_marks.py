"""Marks in the viewer: drawn, listed, removed and restored, by those who may."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fieldgrid.maps import Mark, MarkKind, open_map
from tests.maps.file.maps import drive, write_map
from tests.view.serving import TOKEN_HEADER, Server, serving

POND = {
    "kind": "keepout", "corners": [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5]],
    "name": "pond", "note": "deep", "author": "Ana",
}  # fmt: skip


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_map(tmp_path / "map.gpkg", [drive(2)])


def test_a_mark_is_added_removed_and_restored(small: Path) -> None:
    with serving(small) as server:
        version = server.json("/api/maps")["maps"][0]["version"]
        answer = server.post("/api/maps/0/marks", {"version": version, **POND})
        assert (answer.status, answer.json()) == (200, {"id": 1})
        # The map is no longer the one that was seen.
        assert server.post("/api/maps/0/marks", {"version": version, **POND}).status == 400
        (about,) = server.json("/api/maps")["maps"]
        (mark,) = about["marks"]
        assert {key: mark[key] for key in POND} == POND
        for action in ("remove", "restore"):
            asked = {"version": about["version"], "action": action, "mark": 1}
            assert server.post("/api/maps/0/marks/change", asked).status == 200
            (about,) = server.json("/api/maps")["maps"]
            assert (about["marks"][0]["removed"] is None) == (action == "restore")
        assert about["marks"] == [mark]
        assert server.json("/api/maps/0/features") == {"tables": []}  # each is drawn once
    with open_map(small) as universal:
        assert universal.verify(deep=True).sound


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "lake"}, "kind"),
        ({"corners": []}, "corners"),
        ({"corners": [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]}, "crosses itself"),
        ({"corners": [[0.0, 1e400]]}, "corners"),
        ({"corners": [[0.0, 0.0]] * 2001}, "corners"),
        ({"name": "x" * 501}, "name"),
        ({"kind": "place", "name": " "}, "no name"),
        ({"created": "2000-01-01"}, "created"),
    ],
)
def test_what_cannot_be_marked_is_refused(small: Path, change: dict[str, Any], words: str) -> None:
    before = small.read_bytes()
    with serving(small) as server:
        version = server.json("/api/maps")["maps"][0]["version"]
        answer = server.post("/api/maps/0/marks", {"version": version, **POND, **change})
        assert answer.status == 400
        assert words in answer.json()["error"]
    assert small.read_bytes() == before


@pytest.mark.parametrize(
    ("writable", "headers", "status"),
    [
        (False, {}, 404),
        (True, {TOKEN_HEADER: None}, 401),
        (True, {"Origin": "http://evil.example"}, 403),
        (True, {"Sec_Fetch_Site": "cross-site"}, 403),
        (True, {"Content_Type": "text/plain"}, 415),
    ],
)
def test_nobody_else_marks_anything(
    small: Path, writable: bool, headers: dict[str, str | None], status: int
) -> None:
    before = small.read_bytes()
    with serving(small, writable=writable) as server:
        version = server.json("/api/maps")["maps"][0]["version"]
        for path, asked in (
            ("marks", POND),
            ("marks/change", {"action": "remove", "mark": 1}),
        ):
            answer = server.post(f"/api/maps/0/{path}", {"version": version, **asked}, **headers)
            assert answer.status == status
    assert small.read_bytes() == before


def test_an_area_is_drawn_kept_and_undone(own_server: Server, look: Any) -> None:
    page = look(own_server.link)
    page.page.click("#mark-area")
    for corner in ((-14.0, 56.0), (-8.0, 56.0), (-8.0, 62.0)):
        page.page.mouse.click(*page.place(*corner))
        page.page.wait_for_timeout(300)  # two clicks are no double click
    page.page.click("#finish")
    page.page.wait_for_selector("dialog >> text=Mark this?")
    page.page.fill("#mark-name", "pond")
    page.page.fill("#mark-author", "Ana")
    page.page.click("dialog button.primary")
    page.page.wait_for_selector("#mark-list >> text=pond")
    with open_map(own_server.folder / "vineyard.gpkg") as universal:
        (pond,) = universal.marks()
    assert (pond.kind, pond.name, pond.author) == (MarkKind.KEEPOUT, "pond", "Ana")
    assert pond.bounds == pytest.approx((-14.0, 56.0, -8.0, 62.0), abs=0.2)

    page.page.reload()
    page.page.wait_for_selector("#mark-list >> text=pond")
    page.settle()
    page.click_map(-9.0, 57.0)
    page.page.wait_for_selector("#marked >> text=keep out")
    page.page.click("#mark-list >> text=Remove")
    page.page.click("dialog button.primary")
    page.page.wait_for_selector("#mark-list .removed >> text=Restore")
    with open_map(own_server.folder / "vineyard.gpkg") as universal:
        assert universal.marks() == ()


def test_a_point_is_marked_on_a_phone_and_by_keyboard(own_server: Server, look: Any) -> None:
    page = look(own_server.link, size=(400, 780), has_touch=True, is_mobile=True)
    page.page.locator("#show-panels").tap()
    page.page.locator("#mark-point").tap()
    assert page.page.locator("#panels").is_hidden()
    page.page.touchscreen.tap(*page.place(-10.0, 55.0))
    page.page.wait_for_selector("dialog >> text=Mark this?")
    page.page.select_option("#mark-kind", "free")
    page.page.locator("dialog button.primary").tap()
    page.page.locator("#announcements >> text=Marked").wait_for()
    page.page.locator("#show-panels").tap()
    page.page.locator("#mark-area").tap()
    for _ in range(3):
        page.page.keyboard.press("Enter")
        page.page.keyboard.press("ArrowUp" if _ else "ArrowRight")
        page.page.wait_for_timeout(400)
    page.page.locator("#finish").tap()
    page.page.wait_for_selector("dialog >> text=The area of 3 corners")
    page.page.keyboard.press("Escape")
    with open_map(own_server.folder / "vineyard.gpkg") as universal:
        (free,) = universal.marks()
    assert (free.kind, free.is_point) == (MarkKind.FREE, True)
    assert free.corners[0] == pytest.approx((-10.0, 55.0), abs=0.3)


def test_who_may_only_read_sees_marks_and_no_buttons(look: Any, small: Path) -> None:
    with open_map(small, writable=True) as universal:
        universal.add_marks([Mark(MarkKind.PLACE, ((0.0, 5.0),), "gate")])
    with serving(small, writable=False) as server:
        page = look(server.link)
        page.page.wait_for_selector("#mark-list >> text=gate")
        assert page.page.locator("#mark-area").count() == 0
        assert page.page.locator("#mark-list >> text=Remove").count() == 0


def test_a_metre_is_no_thousand_millimetres(look: Any, server: Server) -> None:
    page = look(server.link)
    x, y = page.place(-10.0, 55.0)
    page.page.mouse.move(x, y)
    said = set()
    for _ in range(7):
        page.page.mouse.wheel(0, -600)
        page.page.wait_for_timeout(100)
        said.add(page.page.locator(".ol-scale-line-inner").text_content())
    assert not [text for text in said if text.endswith("mm") and int(text.split()[0]) >= 10]
    assert any(text.endswith("cm") for text in said)
