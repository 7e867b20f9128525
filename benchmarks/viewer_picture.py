"""docs/viewer.png: the viewer's answer to why a cell is an obstacle.

python -m benchmarks.viewer_picture vineyard.gpkg docs/viewer.png

It needs chromium and playwright. The map is that of examples/two_lanes with its RTK log, and the
images lie where its build found them.
"""

from __future__ import annotations

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

from tests.view.browsing import CHROMIUM_FLAGS, Watched, chromium
from tests.view.serving import serving

_CELL_M = (-11.57, 50.87)
_WHEEL_TURNS = 4


def take(map_: Path, out: Path) -> None:
    """Take the picture."""
    with serving(map_, recordings=(Path("examples/two_lanes"),)) as server, sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium(), args=CHROMIUM_FLAGS)
        page = Watched.open(browser, server.link, size=(1240, 760), color_scheme="light")
        for _ in range(_WHEEL_TURNS):
            page.page.mouse.move(*page.place(*_CELL_M))
            page.page.mouse.wheel(0, -240)
            page.page.wait_for_timeout(400)
            page.settle()
        page.page.get_by_label("Headings").check()
        page.click_map(*_CELL_M)
        page.page.wait_for_selector("#evidence img")
        page.settle()
        page.page.screenshot(path=str(out))
        page.close()
        browser.close()


if __name__ == "__main__":
    take(Path(sys.argv[1]), Path(sys.argv[2]))
