"""What the server refuses: foreign names, foreign pages, paths, and what is too large."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from fieldgrid.view import loopback_access, network_access
from fieldgrid.view.security import Access
from tests.view.serving import TOKEN, Server, serving


def test_the_server_is_on_this_machine_alone(server: Server) -> None:
    """An address of the machine other than loopback has nobody behind the port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: it only picks an interface
            own = probe.getsockname()[0]
        except OSError:
            own = "127.0.1.1"
    with (
        pytest.raises(OSError, match=r"refused|timed out|unreachable"),
        socket.create_connection((own, server.port), timeout=5),
    ):
        pass


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:{port}",
        "localhost.evil.example:{port}",
        "127.0.0.1",
        "127.0.0.1:1",
        "192.0.2.7:{port}",
        "",
    ],
)
def test_a_foreign_name_gets_nothing(server: Server, host: str) -> None:
    """DNS rebinding: a name of somebody else's that points here."""
    for path in ("/", "/viewer.js", "/api/maps"):
        answer = server.get(path, Host=host.format(port=server.port))
        assert answer.status == 421
        assert b"sessions" not in answer.body


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "LOCALHOST"])
def test_its_own_names_are_answered(server: Server, host: str) -> None:
    assert server.get("/api/maps", Host=f"{host}:{server.port}").status == 200


@pytest.mark.parametrize("path", ["/api/maps", "/viewer.js", "/api/maps/0/tiles/density/0/0/0"])
def test_no_other_site_may_embed_anything(server: Server, path: str) -> None:
    assert server.get(path, Sec_Fetch_Site="cross-site").status == 403
    answer = server.get(path, Sec_Fetch_Site="same-origin")
    assert answer.status in (200, 204)
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"


def test_the_page_may_run_and_load_nothing_but_itself(server: Server) -> None:
    answer = server.get("/")
    policy = dict(
        part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";")
    )
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["connect-src"] == policy["style-src"] == "'self'"
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert policy["frame-ancestors"] == "'none'"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert "server" not in {name.lower() for name in answer.headers}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"X_Fieldgrid_Token": None}, 401),
        ({"X_Fieldgrid_Token": "another"}, 401),
        ({"X_Fieldgrid_Token": "é"}, 401),
        ({"Origin": None}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "https://127.0.0.1:{port}"}, 403),
        ({"Origin": "http://127.0.0.1:1"}, 403),
        ({"Sec_Fetch_Site": "cross-site"}, 403),
        ({"Content_Type": "text/plain"}, 415),
        ({"Content_Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content_Length": "9999999999"}, 413),
        ({"Content_Length": "-1"}, 400),
    ],
)
def test_a_post_of_somebody_else_changes_nothing(
    server: Server, headers: dict[str, str | None], status: int
) -> None:
    before = server.json("/api/maps")
    given = {k: v and v.format(port=server.port) for k, v in headers.items()}
    answer = server.post("/api/maps/0/sessions", {"remove": "august"}, **given)
    assert answer.status == status
    assert server.json("/api/maps") == before


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
def test_other_methods_are_not_answered(server: Server, method: str) -> None:
    """OPTIONS, too: so the preflight of a foreign page fails."""
    answer = server.ask(method, "/api/maps/0/sessions", {"Origin": "http://evil.example"})
    assert answer.status == 405
    assert "access-control-allow-origin" not in {name.lower() for name in answer.headers}


@pytest.mark.parametrize(
    "path",
    [
        "/../pyproject.toml", "/%2e%2e/%2e%2e/etc/passwd", "/static/../app.py",
        "/viewer.js/../page.py",
        "/api/maps/0/../../../etc/passwd", "/api/maps/../tracks/0", "/index.html", "/.git/config",
    ],
)  # fmt: skip
def test_no_path_of_a_request_reaches_the_disk(server: Server, path: str) -> None:
    answer = server.get(path)
    assert answer.status in (400, 404)
    assert b"root:" not in answer.body


@pytest.mark.parametrize(
    "path",
    [
        "/api/maps/1", "/api/maps/1/tracks/0", "/api/maps/-1/tracks/0", "/api/maps/x/tracks/0",
        "/api/maps/0/tracks/7", "/api/maps/0/tracks/..%2f..", "/api/maps/0/tracks/%D9%A3",
        "/api/maps/0/tiles/density/0/99999999999999999999/0", "/api/maps/0/tiles/density/1e3/0/0",
        "/api/maps/0/tiles/nothing/0/0/0", "/api/maps/0/tiles/count/25/0/0",
        "/api/maps/0/tiles/change/0/0/0", "/api/maps/0/tiles/change/0/0/0?from=1&to=0",
        "/api/maps/0/scales/fieldgrid_meta", "/api/maps/0/scales/density'--",
        "/api/maps/0/cell?east=nan&north=0", "/api/maps/0/cell?east=1e400&north=0",
        "/api/maps/0/cell",
        "/api/maps/0/frames?bounds=1,2,3", "/api/maps/0/frames?bounds=inf,0,0,0",
        "/api/maps/0/frames?bounds=" + "1," * 5000,
        "/api/maps/0/image?session=0&frame=../../etc/passwd&image=0",
        "/api/maps/0/image?session=0&frame=000000&image=9", "/api/maps/0/image",
    ],
)  # fmt: skip
def test_nonsense_is_refused_in_one_sentence(server: Server, path: str) -> None:
    answer = server.get(path)
    assert answer.status in (400, 404), answer
    assert len(answer.body) < 400
    if answer.status == 400:
        assert answer.json()["error"].endswith(".")
    assert server.get("/api/maps").status == 200


def test_an_image_with_another_hash_is_not_shown(vineyard: Path, tmp_path: Path) -> None:
    """A map may name any file: only one with the very bytes that it was made from is sent."""
    recording = tmp_path / "examples" / "two_lanes" / "left"
    recording.mkdir(parents=True)
    (recording / "000000.jpg").write_bytes(b"root:x:0:0")
    (tmp_path / "map.gpkg").write_bytes(vineyard.read_bytes())
    with serving(tmp_path / "map.gpkg") as running:
        answer = running.get("/api/maps/0/image?session=0&frame=000000&image=0")
    if answer.status == 400:
        assert "another image" in answer.json()["error"]
        assert "--recording" in answer.json()["error"]
    else:  # the working folder has the example itself
        assert answer.headers["content-type"] == "image/jpeg"
    assert b"root:" not in answer.body


@pytest.fixture(scope="module")
def network(vineyard: Path) -> Iterator[Server]:
    with serving(vineyard, network=True, writable=False) as running:
        yield running


def test_the_local_network_needs_the_token_for_everything(network: Server) -> None:
    assert network.get("/").status == 200  # the page, which holds nothing of the map
    for path in ("/api/maps", "/api/maps/0/tiles/density/0/0/0", "/api/maps/0/tracks/0"):
        assert network.get(path).status == 401
        assert network.get(path, X_Fieldgrid_Token=TOKEN).status in (200, 204)
    # Any address of the machine will do, but no foreign name.
    for host, status in (("192.0.2.7", 200), ("[2001:db8::1]", 200), ("evil.example", 421)):
        found = network.get("/api/maps", Host=f"{host}:{network.port}", X_Fieldgrid_Token=TOKEN)
        assert found.status == status


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1:8000", True), ("[::1]:8000", True),
        ("127.0.0.1:80", False), ("127.0.0.1", False),
        ("127.0.0.1:8000.evil.example", False), ("evil@127.0.0.1:8000", False),
        ("127.0.0.1:٨٠٠٠", False), (":8000", False),
        ("127.0.0.1:", False), ("2130706433:8000", False),
    ],
)  # fmt: skip
def test_hosts(host: str, expected: bool) -> None:
    assert loopback_access("t", 8000).is_host(host) is expected


def test_port_80_goes_without_saying() -> None:
    access: Access = network_access("t", 80, "field.lan")
    assert access.is_host("field.lan")
    assert access.is_origin("http://field.lan")
    assert not access.is_origin("https://field.lan")
    assert not access.is_origin("field.lan")
