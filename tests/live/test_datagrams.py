"""The window in datagrams, by the reader of the documentation, and what becomes of losses."""

from __future__ import annotations

import random
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from fieldgrid.errors import ConfigError
from fieldgrid.live import DatagramFeed, Feed, datagrams, open_feed
from fieldgrid.live.feed import encode_window
from tests.live.sources import TIMEOUT_S
from tests.live.windows import documented_readers, window

read_windows = documented_readers()["read_windows"]
SIZE = (40, 60)
"""A window of ten datagrams and a bit."""


@contextmanager
def listening(port: int = 0) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", port))
        made.settimeout(TIMEOUT_S)
        yield made


class Sent:
    """Stands for a socket: gives datagrams, and then says that there are no more."""

    def __init__(self, *given: bytes) -> None:
        self._left = list(given)

    def recv(self, _: int) -> bytes:
        if not self._left:
            raise EOFError
        return self._left.pop(0)


def numbers(*given: bytes) -> list[int]:
    """The numbers of the windows that a reader makes of datagrams."""
    found: list[int] = []
    windows = read_windows(Sent(*given))
    while True:
        try:
            found.append(next(windows)["number"])
        except EOFError:
            return found


def parts(number: int, session: int = 5) -> list[bytes]:
    return list(datagrams.cut(encode_window(window(7, size=SIZE), number), session, number))


def test_a_window_comes_through_a_socket_as_it_is() -> None:
    sent = window(3, size=SIZE)
    with listening() as udp, DatagramFeed(*udp.getsockname()) as feed:
        assert feed.address == udp.getsockname()
        windows = read_windows(udp)
        for number in (1, 2):
            feed.put(sent)
            got = next(windows)
            assert (got["number"], got["frames"]) == (number, 3)
            np.testing.assert_array_equal(got["costs"], sent.costmap.costs)
    feed.put(sent)  # after the end nothing happens


def test_datagrams_are_small_and_all_of_the_window() -> None:
    message = encode_window(window(7, size=SIZE), 3)
    made = parts(3)
    assert len(made) == 11
    assert all(len(one) <= 1228 for one in made)
    assert b"".join(one[28:] for one in made) == message
    assert numbers(*made) == [3]


def test_order_and_copies_do_not_matter() -> None:
    given = parts(3) * 2
    random.Random(1).shuffle(given)
    assert numbers(*given) == [3]


def test_a_window_of_which_a_part_is_lost_is_none() -> None:
    first, second = parts(1), parts(2)
    assert numbers(*first[:-1], *second) == [2]
    assert numbers(*second, *first) == [2]  # late
    # The count of windows begins again behind its end, and with another session.
    assert numbers(*parts(2**32 - 1), *parts(2**32)) == [2**32 - 1, 0]
    assert numbers(*parts(70), *parts(1, session=6)) == [70, 1]


@pytest.mark.parametrize("at", [0, 4, 9, 12, 17, 21, 25, 28, 300])
def test_what_was_changed_on_the_way_is_left_out(at: int) -> None:
    given = parts(1)
    spoilt = bytearray(given[4])
    spoilt[at] ^= 4
    assert numbers(*given[:4], bytes(spoilt), *given[5:]) == []
    assert numbers(*given[:4], bytes(spoilt), given[4][:20], b"", *given[4:]) == [1]


def test_it_goes_on_where_nobody_listens() -> None:
    told: list[str] = []
    with listening() as udp:
        address = udp.getsockname()
    with DatagramFeed(*address, told.append) as feed:
        for _ in range(3):
            feed.put(window(1, size=SIZE))
        with listening(address[1]) as udp:
            windows, done = read_windows(udp), threading.Event()

            def put() -> None:
                while not done.wait(0.01):
                    feed.put(window(2, size=SIZE))

            putting = threading.Thread(target=put)
            putting.start()
            try:
                assert next(windows)["frames"] in (1, 2)
            finally:
                done.set()
                putting.join()
    assert told == []


def test_the_newest_window_is_sent_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """While one is being sent, others give way to the newest."""
    begun, go_on = threading.Event(), threading.Event()

    def pause(_: float) -> None:
        begun.set()
        assert go_on.wait(TIMEOUT_S)

    monkeypatch.setattr(datagrams, "BURST", 5)
    monkeypatch.setattr("fieldgrid.live.datagrams.time.sleep", pause)
    with listening() as udp, DatagramFeed(*udp.getsockname()) as feed:
        feed.put(window(1, size=SIZE))
        assert begun.wait(TIMEOUT_S)
        for frames in range(2, 6):
            feed.put(window(frames, size=SIZE))
        go_on.set()
        windows = read_windows(udp)
        assert [next(windows)["number"] for _ in range(2)] == [1, 5]


def test_what_cannot_be_sent_is_told_once() -> None:
    told, is_told = [], threading.Event()

    def tell(text: str) -> None:
        told.append(text)
        is_told.set()

    # To all of a network is not allowed to just any socket.
    with pytest.raises(ConfigError, match=r"udp://255.255.255.255:9 \(Permission denied\)"):
        DatagramFeed("255.255.255.255", 9)
    with pytest.raises(ConfigError, match=r"cannot send to udp://nowhere\.invalid:9"):
        DatagramFeed("nowhere.invalid", 9)
    with listening() as udp, DatagramFeed(*udp.getsockname(), tell) as feed:
        lost: Any = feed._socket
        feed._socket = Broken()  # type: ignore[assignment]
        for _ in range(3):
            feed.put(window(1, size=SIZE))
            assert is_told.wait(TIMEOUT_S)
        feed._socket = lost
        feed.put(window(2, size=SIZE))
        assert next(read_windows(udp))["frames"] in (1, 2)
    (text,) = told
    assert text.endswith(": Network is unreachable.")


class Broken:
    """A socket whose network is gone."""

    def send(self, _: bytes) -> int:
        raise OSError(101, "Network is unreachable")


def test_an_address_says_which_feed() -> None:
    with listening() as udp, open_feed(f"udp://127.0.0.1:{udp.getsockname()[1]}") as feed:
        assert isinstance(feed, DatagramFeed)
    with open_feed("tcp://127.0.0.1:0") as feed:
        assert isinstance(feed, Feed)
