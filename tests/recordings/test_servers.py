"""Recordings on real servers of this machine: S3, SSH and the web, as fsspec reaches them.

Their libraries are none of the project's; each test needs those that it names, and skips without:
pip install 'moto[server]' s3fs asyncssh paramiko aiohttp requests
"""

from __future__ import annotations

import asyncio
import importlib
import shutil
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import fsspec
import pytest
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.core import RecordingError
from fieldgrid.maps import open_map
from fieldgrid.recordings import fetch
from tests.conftest import make_small_drive

# Sockets and loops of the libraries' own, which they close in their own time.
pytestmark = [pytest.mark.filterwarnings("ignore")]


@pytest.fixture(scope="module")
def farm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a drive, and an archive of it."""
    folder = tmp_path_factory.mktemp("farm")
    made = make_small_drive(folder / "made", range(3, 9))
    drive = shutil.copytree(made, folder / "june-03")  # without links, which SSH shows as such
    with ZipFile(folder / "2026.zip", "w") as archive:
        for file in sorted(drive.rglob("*")):
            archive.write(file, file.relative_to(folder))
    return folder


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FIELDGRID_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def configured(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Sets what fsspec's configuration says of a protocol."""
    from fsspec.config import conf

    def configure(protocol: str, **values: Any) -> None:
        monkeypatch.setitem(conf, protocol, values)
        fsspec.get_filesystem_class(protocol).clear_instance_cache()

    return configure


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
    return port


def built(url: str, out: Path) -> Any:
    """The density of the map that the command makes of a recording."""
    result = CliRunner().invoke(app, ["build", url, "-o", str(out)])
    assert result.exit_code == 0, (result.output, result.exception)
    with open_map(out) as universal:
        return universal.read().density


def test_s3(farm: Path, tmp_path: Path, configured: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("s3fs")
    moto = pytest.importorskip("moto.server")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=free_port(), verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        account = {"endpoint_url": f"http://{host}:{port}", "key": "robot", "secret": "secret"}
        configured("s3", **account)
        system = fsspec.filesystem("s3")
        system.mkdir("vines")
        system.put(str(farm / "june-03"), "vines/june-03", recursive=True)
        here = built(str(farm / "june-03"), tmp_path / "here.gpkg")
        assert (built("s3://vines/june-03", tmp_path / "there.gpkg") == here).all()
        for gone in ("s3://vines/july", "s3://no-such-bucket/june-03"):
            with pytest.raises(RecordingError, match=r"does not exist; give the URL"):
                fetch(gone)
    finally:
        server.stop()
    configured("s3", **{**account, "endpoint_url": f"http://127.0.0.1:{free_port()}"})
    with pytest.raises(RecordingError, match=r"Could not connect .*read the copy of before at"):
        fetch("s3://vines/june-03")


@contextmanager
def ssh_server(folder: Path) -> Iterator[int]:
    """A server of SSH on this machine that lets robot in by a password; its port."""
    asyncssh = pytest.importorskip("asyncssh")

    class Server(asyncssh.SSHServer):  # type: ignore[misc, name-defined]
        def validate_password(self, username: str, password: str) -> bool:
            return (username, password) == ("robot", "secret")

        def password_auth_supported(self) -> bool:
            return True

    async def serve() -> Any:
        return await asyncssh.listen(
            "127.0.0.1",
            0,
            server_factory=Server,
            server_host_keys=[asyncssh.generate_private_key("ssh-ed25519")],
            sftp_factory=lambda channel: asyncssh.SFTPServer(channel, chroot=str(folder).encode()),
        )

    loop = asyncio.new_event_loop()
    server = loop.run_until_complete(serve())
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield server.get_port()
    finally:
        loop.call_soon_threadsafe(server.close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


@pytest.mark.parametrize(
    "library", ["fsspec.implementations.sftp.SFTPFileSystem", "sshfs.SSHFileSystem"]
)
def test_ssh(
    library: str, farm: Path, tmp_path: Path, configured: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By paramiko, which fsspec takes by itself, and by sshfs, where that is installed."""
    pytest.importorskip("sshfs" if library.startswith("sshfs") else "paramiko")
    module, _, name = library.rpartition(".")
    system = getattr(importlib.import_module(module), name)
    monkeypatch.setitem(importlib.import_module("fsspec.registry")._registry, "sftp", system)
    with ssh_server(farm) as port:
        configured("sftp", username="robot", password="secret")
        url = f"sftp://127.0.0.1:{port}/june-03"
        here = built(str(farm / "june-03"), tmp_path / "here.gpkg")
        assert (built(url, tmp_path / "there.gpkg") == here).all()
        (farm / "june-03" / "gnss" / "back").symlink_to("../..")
        try:
            with pytest.raises(RecordingError, match=r"has a link, .*'gnss/back'"):
                fetch(url)
        finally:
            (farm / "june-03" / "gnss" / "back").unlink()
        archived = f"zip://june-03::sftp://127.0.0.1:{port}/2026.zip"
        assert (built(archived, tmp_path / "archived.gpkg") == here).all()
        with pytest.raises(RecordingError, match=r"does not exist; give the URL"):
            fetch(f"sftp://127.0.0.1:{port}/july")
        configured("sftp", username="robot", password="wrong")
        with pytest.raises(RecordingError, match=r"check the URL, the connection and your cred"):
            fetch(url)
    with pytest.raises(RecordingError, match=r"check the URL, the connection and your credent"):
        fetch(f"sftp://127.0.0.1:{free_port()}/june-03")


class _Files(SimpleHTTPRequestHandler):
    """Files of a folder, as wholes only; /secret/ is refused."""

    def do_GET(self) -> None:
        if self.path.startswith("/secret/"):
            self.send_error(403)
        elif self.path.startswith("/away/"):
            self.send_response(302)
            self.send_header("Location", self.path.removeprefix("/away/"))
            self.end_headers()
        else:
            super().do_GET()

    do_HEAD = do_GET  # noqa: N815 - the name that the server calls

    def log_message(self, *arguments: object) -> None:
        """Say nothing."""

    def copyfile(self, source: Any, outputfile: Any) -> None:
        """Send a file, also to one who hangs up."""
        try:
            super().copyfile(source, outputfile)
        except ConnectionError:
            self.close_connection = True


def test_the_web(farm: Path, tmp_path: Path) -> None:
    for library in ("aiohttp", "requests"):
        pytest.importorskip(library)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Files, directory=farm)) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            web = f"http://127.0.0.1:{server.server_port}"
            here = built(str(farm / "june-03"), tmp_path / "here.gpkg")
            assert (built(f"zip://june-03::{web}/2026.zip", tmp_path / "m.gpkg") == here).all()
            log = next((farm / "june-03" / "gnss").iterdir())
            found = fetch(f"{web}/june-03/gnss/{log.name}")
            assert found.read_bytes() == log.read_bytes()
            for gone in (f"zip://july::{web}/2026.zip", f"zip://june-03::{web}/x.zip", f"{web}/x"):
                with pytest.raises(RecordingError, match=r"does not exist; give the URL"):
                    fetch(gone)
            assert fetch(f"{web}/away//2026.zip?").read_bytes() == (farm / "2026.zip").read_bytes()
            for target in (f"file://{log}", f"ftp://127.0.0.1/{log.name}"):
                with pytest.raises(RecordingError, match=r"cannot be read \(.*redirect"):
                    fetch(f"{web}/away/{target}")
            with pytest.raises(RecordingError, match=r"403.*check the URL, the connection and"):
                fetch(f"{web}/secret/rtk.nmea")
        finally:
            server.shutdown()
            thread.join()
    with pytest.raises(RecordingError, match=r"cannot be read \(Cannot connect to host"):
        fetch(f"{web}/june-03.bag")
