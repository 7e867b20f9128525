"""The page that follows the vehicle: its stream, what it refuses, and how it looks in a browser."""

from __future__ import annotations

import http.client
import json
import logging
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from fieldgrid.core import ConfigError, palette
from fieldgrid.live import LivePage, parse_server_address
from fieldgrid.live.servers import page
from tests.conftest import ROOT
from tests.live.servers.making import TIMEOUT_S, event, noisy, pose_of, settled, window

AXE = ROOT / "page" / "node_modules" / "axe-core" / "axe.min.js"
BIG = (1200, 1200)
"""A window of more bytes than sockets hold."""


POSTED = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{"
"""A request that is never whole."""


class Stream:
    """One who looks on: a connection of its own, and the events that came through it."""

    def __init__(self, served: LivePage, **headers: str) -> None:
        host = urlsplit(served.link).netloc.replace("localhost", "127.0.0.1")
        self._connection = http.client.HTTPConnection(host, timeout=TIMEOUT_S)
        sent = {name.replace("_", "-"): text for name, text in headers.items()}
        self._connection.request("GET", "/api/live", headers=sent)
        self.answer = self._connection.getresponse()

    def next(self) -> Any:
        """What is told next; None at the end of the session."""
        while line := self.answer.readline():
            if line.startswith(b"event: end"):
                return None
            if line.startswith(b"data: "):
                return json.loads(line[6:])
        raise EOFError

    def until(self, part: str) -> Any:
        """The first that says this of the doubt."""
        while part not in (told := self.next())["window"]["doubt"]:
            pass
        return told

    def close(self) -> None:
        self.answer.close()
        self._connection.close()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.fixture
def served() -> Iterator[LivePage]:
    with LivePage(session="row 3") as made:
        yield made


def ask(served: LivePage, path: str, method: str = "GET", **headers: str) -> tuple[int, Any, bytes]:
    host = urlsplit(served.link).netloc
    connection = http.client.HTTPConnection(host, timeout=TIMEOUT_S)
    sent = {name.replace("_", "-"): text for name, text in headers.items()}
    connection.request(method, path, headers=sent)
    answer = connection.getresponse()
    try:
        return answer.status, answer.headers, answer.read()
    finally:
        connection.close()


def test_who_comes_late_is_told_all_that_is_known(served: LivePage) -> None:
    served.take(settled(1.0, 2.0))
    served.take(window(pose_of(1.0, 2.0)))
    with Stream(served) as first:
        assert first.answer.headers["content-type"].startswith("text/event-stream")
        assert first.next()["path"] == [[1.0, 2.0, 1, True]]
        served.take(settled(2.0, 2.0))
        served.take(event("a word"))
        told = first.next()
        assert (told["path"], told["events"]) == ([[2.0, 2.0, 1, True]], [["pose", "a word"]])
        with Stream(served) as second:
            assert [step[0] for step in second.next()["path"]] == [1.0, 2.0]
        served.close()
        assert first.next() is None
    served.take(window(None))  # after the end nothing happens


def test_a_server_that_says_nothing_is_still_here(
    served: LivePage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "STILL_HERE_S", 0.02)
    with Stream(served) as stream:
        assert [stream.answer.readline() for _ in range(4)] == [b": still here\n", b"\n"] * 2


def test_an_onlooker_that_does_not_read_misses_windows_and_holds_up_nobody(
    served: LivePage,
) -> None:
    big = noisy(BIG, pose_of(1.0, 2.0))
    served.take(big)
    with Stream(served) as reads, Stream(served) as sleeps:
        assert reads.next()["number"] == 1
        for number in range(2, 9):
            served.take(big)
            while reads.next()["number"] < number:
                pass
        got = []
        while not got or got[-1] < 8:
            got.append(sleeps.next()["number"])
    # What it was being sent when it stopped, one that waited for that, and the newest.
    assert got[0] == 1
    assert len(got) <= 3


@pytest.mark.parametrize("sent", [b"GET / HTTP/1.1\r\n", POSTED])
def test_clients_that_ask_nothing_are_few_and_leave_soon(served: LivePage, sent: bytes) -> None:
    address = urlsplit(served.link).hostname, urlsplit(served.link).port
    with ExitStack() as stack:
        idle = [stack.enter_context(socket.create_connection(address)) for _ in range(200)]
        for one in idle:
            one.settimeout(0.0)
            with suppress(OSError):
                one.send(sent)
        deadline_s = time.monotonic() + TIMEOUT_S
        left = {sum(is_open(one) for one in idle)}
        while 0 not in left:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
            left.add(sum(is_open(one) for one in idle))
        assert 64 in left
    assert ask(served, "/")[0] == 200


def is_open(connection: socket.socket) -> bool:
    """Whether the server has not hung up."""
    try:
        return connection.recv(65_536) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def test_clients_come_and_go(served: LivePage) -> None:
    with ExitStack() as stack:
        streams = [stack.enter_context(Stream(served)) for _ in range(page.MOST_CLIENTS)]
        served.take(event("hello"))
        assert all(stream.next()["number"] == 1 for stream in streams)
        status, _, body = ask(served, "/api/live")
        assert (status, json.loads(body)["error"][:1]) == (503, "8")
        streams[0].close()
        while True:  # until its place is free
            with Stream(served) as another:
                if another.answer.status == 200:
                    assert another.next()["number"] == 1
                    break


def test_the_guard_of_the_viewer_stands_before_it(served: LivePage) -> None:
    for path in ("/", "/viewer.js", "/api/colours", "/api/live"):
        assert ask(served, path, Host="evil.example")[0] == 421
    assert ask(served, "/api/live", Sec_Fetch_Site="cross-site")[0] == 403
    assert ask(served, "/api/live", "POST")[0] == 401
    assert ask(served, "/api/live", "PUT")[0] == 405
    for path in ("/index.html", "/api/maps", "/static/live.html", "/../pyproject.toml"):
        assert ask(served, path)[0] == 404
    status, headers, body = ask(served, "/")
    assert status == 200
    assert b'data-page="live"' in body
    policy = headers["content-security-policy"]
    assert "default-src 'none'; script-src 'self'" in policy
    with Stream(served) as stream:
        assert stream.answer.headers["content-security-policy"] == policy


def test_another_machine_needs_the_token() -> None:
    with LivePage("localhost") as served:
        assert "http://localhost:" in served.link
        assert ask(served, "/")[0] == 200
        for path in ("/api/live", "/api/colours"):
            assert ask(served, path)[0] == 401
        token = served.link.partition("#token=")[2]
        with Stream(served, X_Fieldgrid_Token=token) as stream:
            served.take(event("hello"))
            assert stream.next()["events"] == [["pose", "hello"]]


def test_an_address_that_is_taken() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"Nothing can be served at 127.0.0.1:{port}"):
            LivePage(port=port)


@pytest.mark.parametrize(
    "wrong", ["", "a", "a:", ":80", "99999", "a:b", "http://a:80", "a:80/x", "a@b:80", "[::1:80"]
)
def test_what_is_no_address(wrong: str) -> None:
    with pytest.raises(ConfigError, match="is no address; give --view PORT or --view HOST:PORT"):
        parse_server_address(wrong, "--view")


def test_addresses() -> None:
    assert parse_server_address("8080", "--view") == ("127.0.0.1", 8080)
    assert parse_server_address("0", "--view") == ("127.0.0.1", 0)
    assert parse_server_address("field.lan:80", "--view") == ("field.lan", 80)
    assert parse_server_address("[::1]:80", "--view") == ("::1", 80)


def colour_at(look: Any, east_m: float, north_m: float) -> tuple[int, ...]:
    box = look.page.locator("#map").bounding_box()
    x, y = look.place(east_m, north_m)
    pixel = look.map_pixels()[round(y - box["y"]), round(x - box["x"])]
    return tuple(int(value) for value in pixel)


def is_near(colour: tuple[int, ...], other: str) -> bool:
    return bool(np.abs(np.array(colour) - palette.rgb(other)).max() < 30)


def is_red(colour: tuple[int, ...]) -> bool:
    return colour[0] > colour[1] + 60


def test_the_page_follows_the_vehicle_and_says_what_is_doubtful(look: Any) -> None:
    with LivePage(session="row 3") as served:
        link = served.link
        served.take(settled(8.0, 5.0))
        for east_m, gear in ((6.0, 1), (9.0, 1), (9.0, -1), (12.0, -1)):
            served.take(settled(east_m, 2.0, gear=gear))
        fixes = [(8.0, 5.0), (9.0, 5.0)]
        served.take(window(pose_of(10.0, 5.0), gear=-1, fixes=fixes))
        seen = look(link)
        seen.page.wait_for_selector("#doubt >> text=Can be trusted.")
        seen.page.wait_for_selector("#pose >> text=reverse")
        seen.settle()
        assert "token" not in seen.page.url
        facts = seen.page.locator("#pose").inner_text()
        for part in ("10.00, 5.00 ± 0.02 m", "90.0° ± 0.4°", "2, 2 RTK fixed, 1 not used"):
            assert part in facts
        # The vehicle is in the middle, in the colour of its gear; a wall is north of it.
        assert is_near(colour_at(seen, 10.0, 5.0), palette.GEARS[-1])
        # Its path has the colours of the gears.
        assert is_near(colour_at(seen, 7.5, 2.0), palette.GEARS[1])
        assert is_near(colour_at(seen, 10.5, 2.0), palette.GEARS[-1])
        assert is_red(colour_at(seen, 12.05, 7.25))
        assert is_near(colour_at(seen, 12.05, 8.25), palette.COST[0].colour)
        assert not is_red(colour_at(seen, 8.05, 7.25))  # not seen
        seen.page.mouse.move(*seen.place(12.05, 7.25))
        assert "cost 254" in seen.page.locator("#readout").text_content()

        served.take(event("The receiver is silent."))
        served.take(window(pose_of(12.0, 5.0), doubt="no fix for 4 s"))
        seen.page.wait_for_selector("#doubt.bad >> text=Not to be trusted: no fix for 4 s.")
        assert "The receiver is silent." in seen.page.locator("#events").inner_text()
        seen.page.wait_for_selector("#pose >> text=12.00")
        seen.settle()
        assert extent_of(seen)[0] + extent_of(seen)[2] == pytest.approx(24.0, abs=0.05)

        # By its key and by a drag it follows no more; the button lets it follow again.
        seen.page.keyboard.press("f")
        seen.page.wait_for_selector('#follow[aria-pressed="false"]')
        served.take(window(pose_of(14.0, 5.0)))
        seen.page.wait_for_selector("#pose >> text=14.00")
        seen.settle()
        assert extent_of(seen)[0] + extent_of(seen)[2] == pytest.approx(24.0, abs=0.05)
        seen.page.click("#follow")
        seen.settle()
        assert extent_of(seen)[0] + extent_of(seen)[2] == pytest.approx(28.0, abs=0.05)
        x, y = seen.place(14.0, 5.0)
        seen.page.mouse.move(x, y)
        seen.page.mouse.down()
        seen.page.mouse.move(x + 80, y, steps=4)
        seen.page.mouse.up()
        seen.page.wait_for_selector('#follow[aria-pressed="false"]')
        seen.page.select_option("#layer", "age")
        seen.page.wait_for_selector("#legend >> text=64 s or more")
    # The session ends; another one at the same place is found without a hand.
    seen.page.wait_for_selector("#doubt.bad >> text=The session has ended")
    seen.expected = ("ERR_CONNECTION_REFUSED", "Failed to load", "ERR_INCOMPLETE")
    with LivePage(port=urlsplit(link).port or 0, session="row 4") as served:
        served.take(window(pose_of(3.0, 1.0)))
        seen.page.wait_for_selector("header >> text=row 4")
        seen.page.wait_for_selector("#doubt >> text=Can be trusted.")
        assert seen.page.locator("#events").inner_text() == ""
        assert seen.page.title() == "row 4 · fieldgrid live"


def extent_of(look: Any) -> list[float]:
    return [float(edge) for edge in look.page.locator("#map").get_attribute("data-extent").split()]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_serious_in_the_way_of_anybody(served: LivePage, look: Any, scheme: str) -> None:
    if not AXE.exists():
        pytest.skip("axe-core is not installed (npm ci in page/)")
    served.take(event("The receiver is silent."))
    served.take(window(pose_of(12.0, 5.0), doubt="no fix for 4 s", fixes=[(1.0, 1.0)]))
    seen = look(served.link, color_scheme=scheme)
    seen.page.wait_for_selector("#doubt.bad >> text=no fix")
    seen.page.evaluate(AXE.read_text())
    found = seen.page.evaluate(
        "axe.run().then((result) => result.violations.map((one) => "
        "[one.impact, one.id, one.nodes.map((n) => `${n.html} ${n.failureSummary}`)]))"
    )
    assert [one for one in found if one[0] in ("serious", "critical")] == []


def test_the_log_of_other_servers_is_left_as_it_is() -> None:
    log = logging.getLogger("uvicorn.error")
    before = log.level, list(log.filters)
    LivePage(port=0).close()
    assert (log.level, list(log.filters)) == before
