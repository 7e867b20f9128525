"""docs/live.png: the page that follows the vehicle, in the middle of the bundled drive.

python -m benchmarks.live_picture docs/live.png

It needs chromium and playwright.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from pathlib import Path

from playwright.sync_api import sync_playwright

from benchmarks import EXAMPLE
from fieldgrid.live import Live, LivePage, LivePose, LiveResult, replay
from fieldgrid.recordings import open_recording
from tests.view.browsing import CHROMIUM_FLAGS, chromium

_SETTLED = 30
"""Poses that are settled when the picture is taken."""


def take(out: Path) -> None:
    """Take the picture."""
    is_there, settled = threading.Event(), 0
    with (
        tempfile.TemporaryDirectory() as folder,
        open_recording(EXAMPLE, gnss="gnss_rtk.nmea") as recording,
        LivePage(session=recording.name) as page,
    ):

        def keep(result: LiveResult) -> None:
            nonlocal settled
            page.take(result)
            settled += isinstance(result, LivePose) and result.is_settled
            if settled >= _SETTLED:
                is_there.set()

        live = Live(Path(folder) / "map.gpkg", recording.rig, name="two_lanes", on_result=keep)
        stop = threading.Event()
        driver = threading.Thread(target=replay, args=(live, recording), kwargs={"stop": stop})
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium(), args=CHROMIUM_FLAGS)
            shown = browser.new_page(viewport={"width": 1240, "height": 760})
            shown.goto(page.link)
            driver.start()
            is_there.wait()
            shown.wait_for_selector("#doubt >> text=Can be trusted.")
            shown.screenshot(path=str(out))
            browser.close()
        stop.set()
        driver.join()
        live.stop()


if __name__ == "__main__":
    take(Path(sys.argv[1]))
