"""A viewer that serves in a thread, and a client that may say what a browser would not."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.view import listen, loopback_access, make_server, network_access
from fieldgrid.view.app import Viewer, make_app
from fieldgrid.view.farms import shown_at
from fieldgrid.view.security import TOKEN_HEADER

TOKEN = "a-token-of-the-tests"


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    body: bytes

    def json(self) -> Any:
        return json.loads(self.body)


class Server(NamedTuple):
    port: int
    folder: Path

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def link(self) -> str:
        return f"http://{self.host}/#token={TOKEN}"

    def get(self, path: str, **headers: str) -> Answer:
        return self.ask("GET", path, headers=headers)

    def json(self, path: str) -> Any:
        answer = self.get(path)
        assert answer.status == 200, answer.body
        return answer.json()

    def post(self, path: str, value: Any, **headers: str | None) -> Answer:
        """As the page posts; a header given as None is left out."""
        usual = {
            "Origin": f"http://{self.host}",
            "Content-Type": "application/json",
            TOKEN_HEADER: TOKEN,
        }
        given = {name.replace("_", "-"): text for name, text in headers.items()}
        wanted = {name: text for name, text in {**usual, **given}.items() if text is not None}
        return self.ask("POST", path, wanted, json.dumps(value).encode())

    def ask(
        self, method: str, path: str, headers: Mapping[str, str], body: bytes | None = None
    ) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            sent = {"Host": self.host, **{k.replace("_", "-"): v for k, v in headers.items()}}
            if body is not None and "Content-Length" not in sent:
                sent["Content-Length"] = str(len(body))
            for name, value in sent.items():
                connection.putheader(name, value)
            connection.endheaders(body)
            answer = connection.getresponse()
            try:
                body = answer.read()
            except ConnectionResetError:  # what is no HTTP is answered and cut off
                body = b""
            return Answer(answer.status, dict(answer.headers), body)
        finally:
            connection.close()


@contextmanager
def serving(
    *maps: Path,
    writable: bool = True,
    network: bool = False,
    recordings: tuple[Path, ...] = (),
    routes: tuple[Path, ...] = (),
) -> Iterator[Server]:
    """A server of maps, as `view_maps` makes it, until the block ends."""
    listening = listen("127.0.0.1", 0)
    port = int(listening.getsockname()[1])
    access = network_access(TOKEN, port, "0.0.0.0") if network else loopback_access(TOKEN, port)
    server = make_server(make_app(Viewer(shown_at(maps), access, writable, recordings, routes)))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    try:
        # Requests wait in the socket until the server takes them.
        yield Server(port, maps[0].parent)
    finally:
        server.should_exit = True
        thread.join(30)
        listening.close()
