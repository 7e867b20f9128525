"""The feed of the window, read by a reader of its own, and by clients that do not read."""

from __future__ import annotations

import socket
import threading
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import ConfigError
from fieldgrid.live import Feed, parse_feed
from fieldgrid.live.servers import feed
from tests.live.sources import TIMEOUT_S
from tests.live.windows import documented_readers, window


def connect(address: tuple[str, int]) -> socket.socket:
    connection = socket.create_connection(address, TIMEOUT_S)
    connection.settimeout(TIMEOUT_S)
    return connection


documented = documented_readers()


def receive(connection: socket.socket) -> Any:
    return documented["read_window"](connection.recv)


def test_a_window_has_all_that_is_in_it() -> None:
    sent = window()
    with Feed("127.0.0.1", 0) as served:
        assert served.address[0] == "127.0.0.1"
        served.put(sent)  # before anybody listens
        with connect(served.address) as connection:
            got = receive(connection)
    assert (got["number"], got["time_ns"], got["datum"]) == (
        1,
        sent.time_ns,
        (41.65, -4.72, 787.4),
    )
    assert (got["cell_m"], got["west_m"], got["south_m"]) == (0.05, -2.0, 3.0)
    assert got["pose"] == (-1.5, 3.25, 271.5, 0.02, 0.4, 1.25)
    assert (got["doubt"], got["frames"]) == (3, 7)
    np.testing.assert_array_equal(got["costs"], sent.costmap.costs)
    ages, sigmas, seen = got["age_s"], got["sigma_m"], sent.view.observed
    assert np.isnan(ages[~seen]).all()
    assert np.isnan(sigmas[~seen]).all()
    most = np.minimum(sent.age_s[seen], 655.34)
    assert (most > 655.0).any()
    assert (ages[seen] - most >= -1e-3).all()  # no cell is said to be newer than it is
    assert (ages[seen] - most < 0.011).all()
    apart = sigmas[seen] - sent.sigma_m[seen]
    assert ((apart > -1e-6) & (apart < 0.0011)).all()


def test_without_a_pose_nothing_is_known_of_it() -> None:
    sent = window()
    object.__setattr__(sent, "pose", None)
    values = feed.HEADER.unpack(feed.encode_window(sent, 1 << 33)[:136])
    assert np.isnan(values[14:20]).all()
    assert values[4] == 0


BIG = (1200, 1200)
"""A window of more bytes than sockets hold."""


def test_a_client_that_does_not_read_loses_windows_and_holds_up_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "fieldgrid.live.servers.feed.STUCK_S", TIMEOUT_S
    )  # or a slow machine drops it
    with Feed("127.0.0.1", 0) as served:
        served.put(window(1, size=BIG))
        with connect(served.address) as reads, connect(served.address) as sleeps:
            assert receive(reads)["number"] == 1
            for number in range(2, 6):
                served.put(window(number, size=BIG))
                assert receive(reads)["frames"] == number  # while the other takes nothing
            # It gets the rest of the first one, then the newest, and none between them.
            assert [receive(sleeps)["number"] for _ in range(2)] == [1, 5]


def test_a_client_that_takes_nothing_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fieldgrid.live.servers.feed.STUCK_S", 0.05)
    told, is_told = [], threading.Event()

    def tell(text: str) -> None:
        told.append(text)
        is_told.set()

    with Feed("127.0.0.1", 0, tell) as served, connect(served.address) as sleeps:
        served.put(window(1, size=BIG))
        assert is_told.wait(TIMEOUT_S)
        with pytest.raises((EOFError, ConnectionError)):
            receive(sleeps)
    assert told == ["A client of the feed does not read; it was dropped."]


def test_clients_come_and_go() -> None:
    told: list[str] = []
    with Feed("127.0.0.1", 0, told.append) as served, ExitStack() as stack:
        first, second, *_, last = (
            stack.enter_context(connect(served.address)) for _ in range(feed.MOST_CLIENTS + 1)
        )
        assert last.recv(1) == b""
        assert told == ["The feed has 16 clients already; one more was refused."]
        first.sendall(b"GET / HTTP/1.0\r\n\r\n")  # is not answered
        served.put(window(9))
        assert receive(first)["frames"] == 9
        second.close()
        while True:  # until its place is free
            with connect(served.address) as another:
                if another.recv(4) == b"FGWN":
                    break
        with pytest.raises(ConfigError, match="Address already in use"):
            Feed(*served.address)
        served.close()
        assert first.recv(1) == b""
    served.put(window())  # after the end nothing happens


@pytest.mark.parametrize(
    "wrong",
    [
        "7007",
        "udp://127.0.0.1:7007",
        "ws://a:1",
        "tcp://:1",
        "tcp://a",
        "tcp://a:1/x",
        "tcp://[:1",
        "",
    ],
)
def test_what_is_no_feed(wrong: str) -> None:
    with pytest.raises(ConfigError, match=r"is no feed; give a TCP address, such as tcp:"):
        parse_feed(wrong)


def test_places_of_a_feed() -> None:
    assert parse_feed("tcp://127.0.0.1:0") == ("127.0.0.1", 0)
    assert parse_feed("tcp://[::1]:7007") == ("::1", 7007)
    assert parse_feed("tcp://field.lan:7007/") == ("field.lan", 7007)
    with pytest.raises(ConfigError, match=r"served at nowhere\.invalid:1"):
        Feed("nowhere.invalid", 1)
