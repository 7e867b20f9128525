"""The bytes of an MCAP as a link gives them."""

from __future__ import annotations

from fieldgrid.live.intake import Intake
from fieldgrid.live.sources.links import Link

POLL_S = 0.25


class LinkBytes:
    """The bytes of a link, as many as are asked for."""

    def __init__(self, link: Link, intake: Intake) -> None:
        self._link, self._intake = link, intake
        self._held = bytearray()

    def read(self, count: int) -> bytes:
        """The next `count` bytes, or none where the session ends before; SourceEndedError where
        the stream does."""
        while len(self._held) < count:
            if self._intake.stop.is_set():
                return b""
            if data := self._link.read(POLL_S):
                self._intake.arrived()
            self._held += data
        taken = bytes(self._held[:count])
        del self._held[:count]
        return taken
