"""The bytes of an MCAP as a link gives them, and what its channels are."""

from __future__ import annotations

from typing import Any

from fieldgrid.live.intake import Intake
from fieldgrid.live.sources.links import Link, LinkEndedError
from fieldgrid.recordings import Connection, Definition, ros2_name

POLL_S = 0.25
_SYNTAX = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}


class LinkDoneError(Exception):
    """The session ends, or the stream does."""


class LinkBytes:
    """The bytes of a link, as many as are asked for."""

    def __init__(self, link: Link, intake: Intake) -> None:
        self._link, self._intake = link, intake
        self._held = bytearray()
        self.has_ended = False

    def read(self, count: int) -> bytes:
        """The next `count` bytes; LinkDoneError where there are no more."""
        while len(self._held) < count:
            if self._intake.stop.is_set():
                raise LinkDoneError
            try:
                data = self._link.read(POLL_S)
            except LinkEndedError:
                self.has_ended = True
                raise LinkDoneError from None
            if data:
                self._intake.arrived()
            self._held += data
        taken = bytes(self._held[:count])
        del self._held[:count]
        return taken


def connection_of(channel: Any, schema: Any) -> Connection:
    """What the messages of a channel are, as readers of bags have it."""
    definition = None
    if schema is not None and schema.encoding in _SYNTAX and schema.data.strip():
        definition = Definition(_SYNTAX[schema.encoding], schema.data.decode("utf-8", "replace"))
    name, encoding = "" if schema is None else schema.name, channel.message_encoding
    if encoding in ("cdr", "ros1"):
        name = ros2_name(name)
    return Connection(channel.topic, name, encoding, definition)
