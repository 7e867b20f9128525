"""What a live session tells, for Foxglove: a server of its WebSocket protocol in a thread.

Messages are those of Foxglove's own schemas in Protocol Buffers. Of a grid, a pose or the path a
client gets the newest once it has taken what it was sent; fixes and sentences wait in a queue that
is bounded. What gives way is counted, and nobody waits for a client.
"""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import math
import re
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from fieldgrid.core import ConfigError, parse_json, shortened
from fieldgrid.export import foxglove_messages as messages
from fieldgrid.geometry import Pose, Status
from fieldgrid.live.results import LiveEvent, LiveGrid, LivePose, LiveResult, LiveWindow, What
from fieldgrid.live.servers.loop_server import LiveClient, LiveMessage, LoopServer
from fieldgrid.view import LOOPBACK

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")

BASE = "base_link"

MOST_CLIENTS = 8

MOST_PATH = 2_000
"""Poses of the path that are sent with each one that is new."""

_ORIGINS = (
    None,  # no browser
    re.compile(r"https://(app|studio)\.foxglove\.dev"),
    re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"),
    re.compile(r"(?!https?:)[a-z][a-z0-9+.-]{0,30}://.*"),  # programs with pages of their own
)
"""A web page can connect to whatever its reader's machine reaches, so others are refused."""

_MOST_ASKED_BYTES = 65_536
_DATA = struct.Struct("<BIQ")
_DATA_OP = 1
_CLOSE_S = 2.0
"""Time after which a client that does not read is cut off at the end."""


class FoxgloveTopic(NamedTuple):
    """A topic, the name of its schema, and whether more than its newest message counts."""

    topic: str
    schema: str
    keeps_all: bool = False


GRID, COSTMAP, POSE, PATH, FIX, TRANSFORM, LOG = range(7)
CHANNELS = (
    FoxgloveTopic("/grid", "Grid"),
    FoxgloveTopic("/costmap", "Grid"),
    FoxgloveTopic("/pose", "PoseInFrame"),
    FoxgloveTopic("/path", "PosesInFrame"),
    FoxgloveTopic("/fix", "LocationFix", keeps_all=True),
    FoxgloveTopic("/tf", "FrameTransform"),
    FoxgloveTopic("/log", "Log", keeps_all=True),
)


class _FoxgloveClient(LiveClient):
    """A client, which gets what it wants."""

    def __init__(self) -> None:
        super().__init__()
        self.wants: dict[int, int] = {}
        """The number of its subscription by that of the channel."""

    def offer(self, channel: int, message: LiveMessage, *, keeps_all: bool = False) -> None:
        if channel in self.wants:
            super().offer(channel, message, keeps_all=keeps_all)


class FoxgloveServer(LoopServer):
    """Serves Foxglove, in a thread of its own, until it is closed.

    Give it results with `take`, which never blocks. Whoever reaches the port gets the messages:
    `host` is this machine alone unless the network is to see them. `port` 0 is any that is free,
    which `address` tells. ConfigError where it cannot be had or the extra is not installed.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = 8765,
        *,
        session: str = "",
        tell: Callable[[str], None] | None = None,
    ) -> None:
        try:
            import foxglove_schemas_protobuf  # noqa: F401
            import websockets  # noqa: F401
        except ImportError as error:
            raise ConfigError(
                "Foxglove needs libraries that are not installed; run: "
                "pip install 'fieldgrid[foxglove]'."
            ) from error
        super().__init__(host, port, "fieldgrid-foxglove", tell)
        self._session = session
        self._path: deque[Pose] = deque(maxlen=MOST_PATH)
        self._fixes_ns: frozenset[int] = frozenset()
        self._is_trusted = False
        self._left = 0
        self._thread.start()

    @property
    def missed(self) -> int:
        """Messages that gave way to newer ones before a client took them."""
        return self._left + sum(client.missed for client in tuple(self._clients))

    def take(self, result: LiveResult) -> None:
        """Send a result to whoever wants it; it never blocks. Not from several threads at once."""
        if isinstance(result, LiveGrid):
            local, at_ns = result.grid, result.time_ns
            self._put(GRID, at_ns, lambda: messages.local_grid(local, at_ns, BASE))
        elif isinstance(result, LivePose):
            if result.is_settled and result.pose.status is not Status.REJECTED:
                self._path.append(result.pose)
                poses, at_ns = tuple(self._path), result.pose.time_ns
                self._put(PATH, at_ns, lambda: messages.path(poses, at_ns))
        elif isinstance(result, LiveEvent):
            if result.what is not What.FRAME_DROPPED:
                can_drive = result.what is What.POSE and self._is_trusted
                is_warning = not (can_drive or result.what is What.SESSION)
                make = partial(messages.log, result.text, result.time_ns, is_warning=is_warning)
                self._put(LOG, result.time_ns, make)
        else:
            self._take_window(result)

    def _take_window(self, window: LiveWindow) -> None:
        self._is_trusted = window.is_trusted
        pose, costmap = window.pose, window.costmap
        if pose is not None and math.isfinite(pose.east_m + pose.heading_deg):
            self._put(TRANSFORM, pose.time_ns, lambda: messages.transform(pose, BASE))
            self._put(POSE, pose.time_ns, lambda: messages.pose(pose))
        for fix in window.fixes:
            if fix.time_ns not in self._fixes_ns:
                self._put(FIX, fix.time_ns, partial(messages.location_fix, fix, BASE))
        self._fixes_ns = frozenset(window.fixes.time_ns.tolist())
        bounds, cell_m, time_ns = costmap.bounds, costmap.lattice.cell_m, window.time_ns
        self._put(
            COSTMAP, time_ns, lambda: messages.cost_grid(costmap.costs, bounds, cell_m, time_ns)
        )

    def _put(self, channel: int, time_ns: int, make: Callable[[], messages.EncodedMessage]) -> None:
        offer = partial(self._offer, keeps_all=CHANNELS[channel].keeps_all)
        self._call(offer, channel, LiveMessage(time_ns, lambda: make().data))

    async def _serve(self) -> None:
        from websockets.asyncio.server import serve

        # What comes to a port that is open is not news; a mistake of one's own is told below.
        silent = logging.Logger("fieldgrid.foxglove", logging.CRITICAL)
        async with serve(
            self._connected,
            sock=self._listening,
            subprotocols=SUBPROTOCOLS,  # type: ignore[arg-type]
            origins=_ORIGINS,
            compression=None,
            max_size=_MOST_ASKED_BYTES,
            # Else who never ends a handshake, or is being refused, delays the end.
            open_timeout=_CLOSE_S,
            close_timeout=_CLOSE_S,
            server_header=None,
            logger=silent,
        ) as server:
            await self._closing.wait()
            connections = server.connections
            server.close()
            with suppress(TimeoutError):
                await asyncio.wait_for(server.wait_closed(), _CLOSE_S)
            for connection in connections:
                connection.transport.abort()

    async def _connected(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        if self._is_full("Foxglove", MOST_CLIENTS):
            await connection.close(1013, f"{MOST_CLIENTS} clients are connected already")
            return
        client = _FoxgloveClient()
        try:
            with self._serving(client, partial(_send_to, connection, client)):
                info = {
                    "op": "serverInfo",
                    "name": f"fieldgrid live {self._session}".rstrip(),
                    "capabilities": [],
                    "sessionId": str(time.time_ns()),
                }
                await connection.send(json.dumps(info))
                await connection.send(json.dumps({"op": "advertise", "channels": _channels()}))
                async for text in connection:
                    if wrong := self._asked(client, text):
                        status = {"op": "status", "level": 1, "message": wrong}
                        await connection.send(json.dumps(status))
        except ConnectionClosed:
            pass
        except Exception as error:  # noqa: BLE001 - a mistake with one client ends none of the others
            self._tell(f"A connection of Foxglove failed: {shortened(repr(error))}")
        finally:
            self._left += client.missed
            if client.missed:
                self._tell(
                    f"A client of Foxglove missed {client.missed} messages, which gave way to "
                    "newer ones."
                )

    def _asked(self, client: _FoxgloveClient, text: str | bytes) -> str:
        """Do what a client asks for; returns why it is not done, or nothing."""
        try:
            asked = parse_json(text)
            op = asked["op"]
            if op == "subscribe":
                for one in asked["subscriptions"]:
                    number, channel = int(one["id"]), int(one["channelId"])
                    if not (0 <= channel < len(CHANNELS) and 0 <= number < 1 << 32):
                        return f"There is no channel {channel} for a subscription {number}."
                    client.wants[channel] = number
                    if channel in self._latest and not CHANNELS[channel].keeps_all:
                        client.offer(channel, self._latest[channel])
            elif op == "unsubscribe":
                gone = {int(number) for number in asked["subscriptionIds"]}
                client.wants = {c: n for c, n in client.wants.items() if n not in gone}
            else:
                return "This server takes subscribe and unsubscribe alone."
        except (ValueError, TypeError, KeyError):
            return "That was no message of the protocol."
        return ""


async def _send_to(
    connection: ServerConnection,
    client: _FoxgloveClient,
    channel: int,
    message: LiveMessage,
    data: bytes,
) -> None:
    """Send a message, where the client wants it still."""
    from websockets.exceptions import ConnectionClosed

    number = client.wants.get(channel)
    if number is not None:
        with suppress(ConnectionClosed):
            await connection.send(_DATA.pack(_DATA_OP, number, message.time_ns) + data)


def _channels() -> list[dict[str, Any]]:
    return [
        {
            "id": number,
            "topic": channel.topic,
            "encoding": "protobuf",
            "schemaName": f"foxglove.{channel.schema}",
            "schema": base64.b64encode(messages.schema(channel.schema)).decode("ascii"),
            "schemaEncoding": "protobuf",
        }
        for number, channel in enumerate(CHANNELS)
    ]
