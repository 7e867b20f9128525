"""The viewer in a browser, as tests see it: what it asked for, what went wrong, what is drawn."""

from __future__ import annotations

import io
import shutil
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from PIL import Image

from fieldgrid.core import UInt8

CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PATIENCE_MS = 120_000

_TWO_FRAMES = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"

_VIOLATIONS = """
window.__violations = [];
document.addEventListener("securitypolicyviolation", (event) =>
  window.__violations.push(`${event.violatedDirective} ${event.blockedURI}`));
"""


def chromium() -> str | None:
    """The browser's program, where it is installed."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if (found := shutil.which(name))), None)


class Watched:
    """A page of the viewer, and all that it did."""

    def __init__(self, context: Any, page: Any, link: str) -> None:
        self.context, self.page = context, page
        self.expected: tuple[str, ...] = ()
        """Parts of messages that a test provokes."""
        self._host = urlsplit(link).netloc
        self.requests: list[str] = []
        self._problems: list[str] = []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self._problems.append(f"uncaught: {error}"))
        page.on("console", self._said)

    @classmethod
    def open(
        cls, browser: Any, link: str, *, size: tuple[int, int] = (1280, 800), **options: Any
    ) -> Watched:
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, accept_downloads=True, **options
        )
        context.set_default_timeout(PATIENCE_MS)
        context.set_default_navigation_timeout(PATIENCE_MS)
        page = context.new_page()
        page.add_init_script(_VIOLATIONS)
        watched = cls(context, page, link)
        page.goto(link)
        watched.settle()
        return watched

    def _said(self, message: Any) -> None:
        if message.type == "error":
            self._problems.append(f"console: {message.text}")

    def settle(self) -> None:
        """Wait until all that was asked for is there and drawn."""
        self.page.wait_for_selector("#map canvas")
        self.page.evaluate(_TWO_FRAMES)
        self.page.wait_for_selector('#map[aria-busy="false"]')
        self.page.evaluate(_TWO_FRAMES)

    def close(self) -> None:
        """End, once it is sure that nothing went wrong and nothing was asked of anybody else."""
        violations = self.page.evaluate("window.__violations ?? []")
        self.context.close()
        foreign = [
            url
            for url in self.requests
            if urlsplit(url).scheme in ("http", "https", "ws", "wss")
            and urlsplit(url).netloc != self._host
        ]
        problems = [
            text for text in self._problems if not any(part in text for part in self.expected)
        ]
        wrong = foreign, violations, problems
        assert wrong == ([], [], []), wrong

    def asked(self, part: str) -> list[str]:
        """The addresses asked for that contain a text."""
        return [url for url in self.requests if part in url]

    def map_pixels(self) -> UInt8:
        """The map as it is drawn, RGB [row, column], row 0 at the top."""
        picture = self.page.locator("#map").screenshot()
        return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"))

    def place(self, east_m: float, north_m: float) -> tuple[float, float]:
        """The pixel of the window at which a place of the map is drawn."""
        box = self.page.locator("#map").bounding_box()
        seen = self.page.locator("#map").get_attribute("data-extent")
        west, south, east, north = (float(edge) for edge in seen.split())
        return (
            box["x"] + box["width"] * (east_m - west) / (east - west),
            box["y"] + box["height"] * (north - north_m) / (north - south),
        )

    def position(self) -> tuple[float, float]:
        """Metres east and north under the pointer, as the page says them."""
        words = self.page.locator("#readout").text_content().split()
        return float(words[1]), float(words[4])

    def click_map(self, east_m: float, north_m: float) -> None:
        self.page.mouse.click(*self.place(east_m, north_m))
