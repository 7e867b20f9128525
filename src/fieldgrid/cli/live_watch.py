"""What `fieldgrid live` prints while it drives, and the servers that get what a session tells."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from fieldgrid.cli import output

if TYPE_CHECKING:
    from fieldgrid.live import (
        Counts,
        Feed,
        FoxgloveServer,
        Live,
        LivePage,
        LiveResult,
        LiveWindow,
        RosSession,
    )
    from fieldgrid.pipeline import Progress

_DROPS_S = 5.0
"""Dropped frames are told so often at most."""


def open_feed_at(text: str, watch: Watch) -> Feed:
    """The feed at an address, which tells what it has to say through the session."""
    from fieldgrid.live import Feed, parse_feed

    feed = Feed(*parse_feed(text), watch.tell)
    host, port = feed.address
    output.message(f"the costmap is sent to every client of tcp://{host}:{port}")
    return feed


def open_page(text: str, session: str) -> LivePage:
    """The page at an address."""
    from fieldgrid.live import LivePage, parse_server_address

    page = LivePage(*parse_server_address(text, "--view"), session=session)
    output.message(f"the page that follows the vehicle is {page.link}")
    return page


def open_foxglove(text: str, session: str, watch: Watch) -> FoxgloveServer:
    """The server for Foxglove at an address."""
    from fieldgrid.live import FoxgloveServer, parse_server_address

    server = FoxgloveServer(
        *parse_server_address(text, "--foxglove"), session=session, tell=watch.tell
    )
    host, port = server.address
    output.message(f"Foxglove can connect to ws://{host}:{port}")
    return server


class Watch:
    """Prints what a session tells."""

    def __init__(self, line: Any, *, as_json: bool) -> None:
        self.live: Live | None = None
        self.feed: Feed | None = None
        self.servers: list[LivePage | FoxgloveServer | RosSession] = []
        self._line, self._as_json = line, as_json
        self._said_s = -math.inf
        self._window: LiveWindow | None = None

    def tell(self, text: str) -> None:
        """Let the session tell of a client."""
        from fieldgrid.live import What

        if self.live is not None:
            self.live.tell(What.CLIENT, text)

    def take(self, result: LiveResult) -> None:
        """Print a result, or let the status line say it."""
        from fieldgrid.live import LiveEvent, LiveWindow, What

        if self.feed is not None and isinstance(result, LiveWindow):
            self.feed.put(result)
        for server in self.servers:
            server.take(result)
        if self._as_json:
            output.print_json_line(result.as_dict())
            return
        if isinstance(result, LiveEvent):
            drops = result.what is What.FRAME_DROPPED
            if not drops or time.monotonic() - self._said_s > _DROPS_S:
                output.message(result.text)
            if drops:
                self._said_s = time.monotonic()
        elif self._line is not None and self.live is not None:
            self._window = result if isinstance(result, LiveWindow) else self._window
            self._line(_status(self._window, self.live.counts))

    def making_the_map(self, now: Progress | None = None) -> None:
        """Let the status line say how far the end of the session is."""
        if self._line is not None:
            grids = f": {now.frames_done} of {now.frames_total} grids made again" if now else ""
            self._line(f"making the map{grids}")


def _status(window: LiveWindow | None, counts: Counts) -> str:
    if window is None:
        return f"{counts.frames} frames, {counts.fixes} fixes, no pose yet"
    pose = window.pose
    where = ""
    if pose is not None and math.isfinite(pose.heading_sigma_deg):
        where = (
            f", {pose.east_m:.1f} E {pose.north_m:.1f} N ± {pose.position_sigma_m:.2f} m, "
            f"{pose.heading_deg:.0f} ± {pose.heading_sigma_deg:.1f}°"
        )
    doubt = f", NOT TO BE TRUSTED: {window.doubt}" if window.doubt else ""
    return f"{counts.frames} frames, {counts.dropped} dropped{where}{doubt}"
