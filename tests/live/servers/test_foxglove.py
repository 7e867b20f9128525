"""What a session tells Foxglove, read by a client of the protocol that is not the server's."""

from __future__ import annotations

import asyncio
import base64
import json
import math
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from fieldgrid.core import ConfigError
from fieldgrid.geometry import GridSpec, LocalGrid, Status, position_sigma_m
from fieldgrid.live import FoxgloveServer, LiveGrid, What
from fieldgrid.live.servers import foxglove
from fieldgrid.live.servers.loop_server import MOST_WAITING, LiveMessage
from tests.live.servers.making import (
    CELL_M,
    DATUM,
    FIRST_NS,
    TIMEOUT_S,
    event,
    noisy,
    pose_of,
    settled,
    window,
)

BIG = (1500, 1500)
"""A grid of which sockets hold a few at most."""

MANY = 30
"""So many of them no sockets hold."""


class Client:
    """A client as the protocol's description has it: it decodes by the schemas that it is sent."""

    def __init__(
        self, served: FoxgloveServer, *, protocol: str = "foxglove.sdk.v1", ahead: int = 16
    ) -> None:
        host, port = served.address
        self._connecting = connect(
            f"ws://{host}:{port}",
            subprotocols=[protocol],  # type: ignore[list-item]
            open_timeout=TIMEOUT_S,
            max_size=None,
            max_queue=ahead,
        )
        self.connection: ClientConnection = self._connecting.__enter__()
        assert self.connection.subprotocol == protocol
        self.info = self.told()
        advertised = self.told()
        assert (self.info["op"], advertised["op"]) == ("serverInfo", "advertise")
        self.channels = {channel["topic"]: channel for channel in advertised["channels"]}
        self._kinds = {topic: _kind(channel) for topic, channel in self.channels.items()}
        self._topics: dict[int, str] = {}

    def told(self) -> Any:
        text = self.connection.recv(TIMEOUT_S)
        assert isinstance(text, str)
        return json.loads(text)

    def say(self, **asked: Any) -> None:
        self.connection.send(json.dumps(asked))

    def subscribe(self, *topics: str, first: int = 70) -> None:
        wanted = []
        for number, topic in enumerate(topics, start=first):
            self._topics[number] = topic
            wanted.append({"id": number, "channelId": self.channels[topic]["id"]})
        self.say(op="subscribe", subscriptions=wanted)

    def settle(self) -> None:
        """Until the server has done all that it was asked for."""
        self.say(op="nothing")
        assert self.told()["op"] == "status"

    def next(self) -> tuple[str, int, Any]:
        """Topic, time and message of what comes next."""
        data = self.connection.recv(TIMEOUT_S)
        assert isinstance(data, bytes)
        op, number, time_ns = struct.unpack_from("<BIQ", data)
        assert op == 1
        topic = self._topics[number]
        message = self._kinds[topic]()
        message.ParseFromString(data[13:])
        return topic, time_ns, message

    def take(self, *topics: str) -> dict[str, Any]:
        """The first message of each topic that comes."""
        found: dict[str, Any] = {}
        while set(found) != set(topics):
            topic, _, message = self.next()
            found.setdefault(topic, message)
        return found

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self._connecting.__exit__(None, None, None)


def _kind(channel: Any) -> Any:
    """The class of the messages of a channel, from its own schema alone."""
    assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


@pytest.fixture
def served() -> Iterator[FoxgloveServer]:
    with FoxgloveServer(port=0, session="row 3") as made:
        yield made


def cells_of(grid: Any, name: str) -> Any:
    """The values of a field [rows, columns] of a foxglove.Grid."""
    (offset,) = (field.offset for field in grid.fields if field.name == name)
    data = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.row_stride)
    return data[:, offset :: grid.cell_stride][:, : grid.column_count]


def place_of(grid: Any, row: float, column: float) -> tuple[float, float]:
    """Where a place of a foxglove.Grid lies in its frame: x along its columns, then y."""
    x, y = column * grid.cell_size.x, row * grid.cell_size.y
    yaw = 2 * math.atan2(grid.pose.orientation.z, grid.pose.orientation.w)
    return (
        grid.pose.position.x + x * math.cos(yaw) - y * math.sin(yaw),
        grid.pose.position.y + x * math.sin(yaw) + y * math.cos(yaw),
    )


def test_who_comes_late_gets_the_newest_of_everything(served: FoxgloveServer) -> None:
    sent = window(pose_of(10.0, -3.0, 30.0), fixes=[(9.0, -3.0)])
    served.take(settled(8.0, -3.0))
    served.take(settled(9.0, -3.0, Status.REJECTED))
    served.take(settled(9.5, -3.0))
    served.take(window(pose_of(1.0, 1.0)))
    served.take(sent)
    with Client(served) as client:
        assert client.info["name"] == "fieldgrid live row 3"
        client.subscribe("/costmap", "/pose", "/path", "/tf")
        got = client.take("/costmap", "/pose", "/path", "/tf")
    costmap = got["/costmap"]
    assert costmap.frame_id == "map"
    assert costmap.timestamp.ToNanoseconds() == FIRST_NS
    costs = sent.costmap.costs
    np.testing.assert_array_equal(cells_of(costmap, "cost"), costs)
    np.testing.assert_array_equal(cells_of(costmap, "alpha") == 0, costs == 255)
    np.testing.assert_array_equal(cells_of(costmap, "red"), 255 - costs)
    assert costmap.cell_size.x == costmap.cell_size.y == CELL_M
    assert place_of(costmap, 0, 0) == pytest.approx(sent.costmap.bounds[:2])
    # A heading of 30 degrees, clockwise from north, is a yaw of 60.
    pose, moved = got["/pose"].pose, got["/tf"]
    assert (pose.position.x, pose.position.y) == (10.0, -3.0)
    assert (moved.parent_frame_id, moved.child_frame_id) == ("map", "base_link")
    assert (moved.translation.x, moved.translation.y) == (10.0, -3.0)
    for turn in (pose.orientation, moved.rotation):
        assert math.degrees(2 * math.atan2(turn.z, turn.w)) == pytest.approx(60.0)
    assert [one.position.x for one in got["/path"].poses] == [8.0, 9.5]


def test_a_local_grid_lies_before_the_vehicle(served: FoxgloveServer) -> None:
    spec = GridSpec(4.0, 6.0, 0.5)
    density = np.arange(spec.n_x * spec.n_y, dtype=np.uint8).reshape(spec.shape)
    observed = density % 3 > 0
    local = LocalGrid(spec, density, observed)
    with Client(served, protocol="foxglove.websocket.v1") as client:
        client.subscribe("/grid")
        client.settle()
        served.take(LiveGrid("7", FIRST_NS, local, ground_found=True, latency_s=0.1))
        topic, time_ns, grid = client.next()
    assert (topic, time_ns, grid.frame_id) == ("/grid", FIRST_NS, "base_link")
    np.testing.assert_array_equal(cells_of(grid, "density"), density)
    np.testing.assert_array_equal(cells_of(grid, "alpha"), observed * 255)
    x, y = spec.centres_m()
    for row, column in ((0, 0), (3, 7), (11, 2)):
        # base_link is forward and left; the local grid is right and forward.
        place = place_of(grid, row + 0.5, column + 0.5)
        assert place == pytest.approx((y[row], -x[column]))


def test_fixes_and_words_come_once_each(served: FoxgloveServer) -> None:
    with Client(served) as client:
        client.subscribe("/fix", "/log")
        client.settle()
        served.take(window(None, fixes=[(1.0, 2.0), (2.0, 2.0)]))
        served.take(event("can be trusted"))
        served.take(window(None, fixes=[(1.0, 2.0), (2.0, 2.0), (3.0, 2.0)], doubt="no fix"))
        served.take(event("is not to be trusted"))
        served.take(event("dropped", What.FRAME_DROPPED))
        served.take(event("goes on", What.SESSION))
        got = [client.next() for _ in range(6)]
    fixes = [message for topic, _, message in got if topic == "/fix"]
    words = [message for topic, _, message in got if topic == "/log"]
    assert [(word.message, word.level) for word in words] == [
        ("can be trusted", 2), ("is not to be trusted", 3), ("goes on", 2)
    ]  # fmt: skip
    east, north, _ = DATUM.to_enu(
        [fix.latitude for fix in fixes],
        [fix.longitude for fix in fixes],
        [fix.altitude for fix in fixes],
    )
    assert east == pytest.approx([1.0, 2.0, 3.0], abs=1e-4)
    assert north == pytest.approx([2.0, 2.0, 2.0], abs=1e-4)
    sigma = float(position_sigma_m(4, math.nan))
    expected = np.diag([1.0, 1.0, 4.0]).reshape(-1) * sigma**2
    assert list(fixes[0].position_covariance) == pytest.approx(expected.tolist())
    assert [time_ns for topic, time_ns, _ in got if topic == "/fix"] == [
        FIRST_NS, FIRST_NS + 100_000_000, FIRST_NS + 200_000_000
    ]  # fmt: skip


def test_what_is_not_wanted_is_not_sent(served: FoxgloveServer) -> None:
    with Client(served) as client:
        client.subscribe("/pose", "/tf")
        client.say(op="unsubscribe", subscriptionIds=[71, 99])
        client.settle()
        served.take(window(pose_of(1.0, 1.0)))
        served.take(window(pose_of(2.0, 1.0)))
        while client.next()[2].pose.position.x < 2.0:  # of /tf it knows no pose
            pass
    assert served.missed <= 1


def test_a_client_that_does_not_read_misses_grids_and_holds_up_nobody() -> None:
    told: list[str] = []
    is_told = threading.Event()

    def tell(text: str) -> None:
        told.append(text)
        is_told.set()

    with FoxgloveServer(port=0, tell=tell) as served:
        big = noisy(BIG, pose_of(1.0, 2.0))
        with Client(served) as reads, Client(served, ahead=1) as sleeps:
            for client in (reads, sleeps):
                client.subscribe("/costmap")
                client.settle()
            number = 0
            while not served.missed:  # what sockets hold is up to the system and its load
                number += 1
                assert number < MANY
                object.__setattr__(big, "time_ns", FIRST_NS + number)
                served.take(big)
                assert reads.next()[1] == FIRST_NS + number
            got = [sleeps.next()[1]]
            while got[-1] < FIRST_NS + number:
                got.append(sleeps.next()[1])
            assert len(got) + served.missed == number
        assert is_told.wait(TIMEOUT_S)
    (text,) = told
    assert text.startswith("A client of Foxglove missed ")


def test_a_client_that_does_not_read_is_cut_off_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("fieldgrid.live.servers.foxglove._CLOSE_S", 0.05)
    served = FoxgloveServer(port=0)
    with Client(served, ahead=1) as sleeps:
        sleeps.subscribe("/costmap")
        sleeps.settle()
        big, number = noisy(BIG, pose_of(1.0, 2.0)), 0
        while not served._clients[0].missed:
            number += 1
            assert number < MANY
            served.take(big)
            asyncio.run_coroutine_threadsafe(asyncio.sleep(0.0), served._loop).result()
        served.close()
        assert not served._thread.is_alive()


@pytest.mark.parametrize("said", [b"", b"GET / HTTP/1.1\r\nHost: x\r\n"])
def test_who_never_ends_a_handshake_does_not_delay_the_end(
    said: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.live.servers.foxglove._CLOSE_S", 0.05)
    monkeypatch.setattr("fieldgrid.live.servers.loop_server._PATIENCE_S", 3.0)
    served = FoxgloveServer(port=0)
    with socket.create_connection(served.address) as client:
        client.sendall(said)
        with Client(served) as later:  # the server knows of the one before, then
            later.settle()
        served.close()
        assert not served._thread.is_alive()


def test_what_waits_is_bounded_and_what_gives_way_is_counted() -> None:
    client = foxglove._FoxgloveClient()
    message = LiveMessage(0, bytes)
    client.offer(foxglove.FIX, message, keeps_all=True)
    assert client.next() is None  # it does not want it
    client.wants = {foxglove.FIX: 1, foxglove.GRID: 2, foxglove.POSE: 3}
    for _ in range(MOST_WAITING + 5):
        client.offer(foxglove.FIX, message, keeps_all=True)
        client.offer(foxglove.GRID, message)
    client.offer(foxglove.POSE, message)
    assert client.missed == 5 + MOST_WAITING + 4
    order = []
    while (found := client.next()) is not None:
        order.append(found[0])
    assert order == [foxglove.FIX] * MOST_WAITING + [foxglove.POSE, foxglove.GRID]


@pytest.mark.parametrize(
    "wrong",
    [
        "no JSON", "[]", "7", '{"op": "subscribe"}', '{"op": "advertise", "channels": []}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 0}]}',
        '{"op": "subscribe", "subscriptions": [{"id": "x", "channelId": 0}]}',
        '{"op": "unsubscribe", "subscriptionIds": [[]]}', b"\x01\x00\x00", "[" * 20_000,
    ],
)  # fmt: skip
def test_what_is_no_question_is_answered_so(served: FoxgloveServer, wrong: str | bytes) -> None:
    with Client(served) as client:
        client.connection.send(wrong)
        assert client.told()["level"] == 1
        client.subscribe("/pose")  # and the connection lives on
        served.take(window(pose_of(1.0, 1.0)))
        assert client.next()[0] == "/pose"


def test_a_question_that_is_too_long_ends_the_connection(served: FoxgloveServer) -> None:
    with Client(served) as client:
        client.connection.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            client.told()


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("https://evil.example", 403), ("https://app.foxglove.dev.evil.example", 403),
        ("http://app.foxglove.dev", 403), ("null", 403), ("http://localhost.evil.example", 403),
        ("https://app.foxglove.dev", 101), ("http://localhost:8080", 101), ("file://", 101),
    ],
)  # fmt: skip
def test_no_other_site_may_connect(served: FoxgloveServer, origin: str, status: int) -> None:
    host, port = served.address
    found = 101
    try:
        with connect(f"ws://{host}:{port}", subprotocols=["foxglove.sdk.v1"], origin=origin):  # type: ignore[arg-type, list-item]
            pass
    except InvalidStatus as error:
        found = error.response.status_code
    assert found == status


def test_another_protocol_is_refused(served: FoxgloveServer) -> None:
    host, port = served.address
    for offered in (None, ["chat"]):
        with (
            pytest.raises(InvalidStatus),
            connect(f"ws://{host}:{port}", subprotocols=offered),  # type: ignore[arg-type]
        ):
            pass


def test_clients_come_and_go(capfd: pytest.CaptureFixture[str]) -> None:
    told: list[str] = []
    with FoxgloveServer(port=0, tell=told.append) as served, ExitStack() as stack:
        clients = [stack.enter_context(Client(served)) for _ in range(foxglove.MOST_CLIENTS)]
        with pytest.raises(ConnectionClosed, match="8 clients are connected already"):
            Client(served)
        assert told == ["Foxglove has 8 clients already; one more was refused."]
        clients[0].connection.close()
        while True:  # until its place is free
            try:
                stack.enter_context(Client(served))
                break
            except ConnectionClosed:
                continue
        with pytest.raises(ConfigError, match=r"Nothing can be served at 127\.0\.0\.1"):
            FoxgloveServer(*served.address)
        served.close()
        with pytest.raises(ConnectionClosed):
            clients[1].told()
    served.take(window(None))  # after the end nothing happens
    assert capfd.readouterr().err == ""


def test_without_the_extra_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "websockets", None)
    with pytest.raises(ConfigError, match=r"pip install 'fieldgrid\[foxglove\]'"):
        FoxgloveServer(port=0)
