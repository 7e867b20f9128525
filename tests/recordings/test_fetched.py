"""Recordings at URLs: copied once, brought up to date, and never taken for what they are not."""

from __future__ import annotations

import errno
import importlib
import json
import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import fsspec
import pytest
from fsspec import AbstractFileSystem
from fsspec.implementations.local import LocalFileSystem
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.core import BuildSettings, ClusterError, ConfigError, LimitError, RecordingError
from fieldgrid.core.input_limits import limited
from fieldgrid.maps import open_map
from fieldgrid.pipeline import (
    NewSession,
    PartlyBuiltError,
    build_map,
    estimate_mount,
    write_estimate,
)
from fieldgrid.pipeline.staging import remote
from fieldgrid.pipeline.staging.parts import Share
from fieldgrid.pipeline.staging.shares import DriveWork
from fieldgrid.recordings import DriveOptions, fetch, is_url, open_drive
from fieldgrid.recordings.remote import copies, fetched, remote_files
from tests.conftest import make_small_drive
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")
URL = "memory://vines/june-03"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FIELDGRID_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def memory() -> Iterator[Any]:
    """A file system of this process's memory, with a small recording in it."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    system.pseudo_dirs[:] = [""]
    for name in ("frames.csv", "gnss/rtk.nmea", "left/0.png"):
        system.pipe(f"/vines/june-03/{name}", f"content of {name}".encode())
    yield system
    system.store.clear()


def files_of(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize(
    ("path", "is_one"),
    [
        ("s3://vines/june-03", True),
        ("zip://june-03::s3://vines/2026.zip", True),
        ("june-03", False),
        ("../s3/june-03", False),
        ("C://june-03", False),
        ("june::03", False),
        (Path("s3://farm"), False),
    ],
)
def test_urls_are_told_from_paths(path: str | Path, is_one: bool) -> None:
    assert is_url(path) == is_one


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("s3://vines/2026/june-03", "s3_vines_2026_june-03.*/june-03"),
        ("s3://vines/2026/june-03/", "s3_vines_2026_june-03.*/june-03"),
        ("zip://june-03::s3://vines/2026.zip", "zip_june-03_s3_vines_2026.zip.*/june-03"),
        ("sftp://me@host/rtk.nmea", "sftp_me@host_rtk.nmea.*/rtk.nmea"),
        ("s3://vines/.fetched.json", "s3_vines_.fetched.json.*/fetched.json"),
        ("zip://::s3://vines/2026.zip", "zip_s3_vines_2026.zip.*/recording"),
        ("http://host/../../../etc/passwd", "http_host_.._.._.._etc_passwd.*/passwd"),
        ("http://host/..", "http_host_...*/recording"),
    ],
)
def test_a_copy_has_a_folder_of_its_own_in_the_cache(url: str, place: str, cache: Path) -> None:
    copy = copies.copy_of(url)
    assert copy.relative_to(cache / "recordings").match(place)
    assert ".." not in copy.parts
    assert copies.copy_of(url.replace("://", "://x")).parent != copy.parent


def test_a_recording_is_copied_once_and_brought_up_to_date(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched_names: list[str] = []
    get = memory.get

    def counted(sources: list[str], *arguments: Any) -> Any:
        fetched_names.extend(name.removeprefix("/vines/june-03/") for name in sources)
        return get(sources, *arguments)

    monkeypatch.setattr(type(memory), "get", lambda self, *arguments: counted(*arguments))
    told: list[tuple[int, int]] = []
    copy = fetch(URL, progress=lambda done, total: told.append((done, total)))
    assert files_of(copy) == {
        name: f"content of {name}" for name in ("frames.csv", "gnss/rtk.nmea", "left/0.png")
    }
    assert told == [(0, 3), (3, 3)]
    assert copies.url_of(copy) == URL
    fetched_names.clear()
    assert fetch(URL) == copy
    assert fetched_names == []

    memory.pipe("/vines/june-03/frames.csv", b"CONTENT of frames.csv")  # of the same size
    memory.rm("/vines/june-03/left/0.png")
    memory.pipe("/vines/june-03/left/1.png", b"new")
    (copy / "gnss" / "rtk.nmea").write_text("cut")
    (copy / "my_notes.txt").write_text("mine")
    fetch(URL)
    assert sorted(fetched_names) == ["frames.csv", "gnss/rtk.nmea", "left/1.png"]
    assert files_of(copy) == {
        "frames.csv": "CONTENT of frames.csv",
        "gnss/rtk.nmea": "content of gnss/rtk.nmea",
        "left/1.png": "new",
        "my_notes.txt": "mine",
    }


def test_a_single_file_is_copied_under_its_name(memory: Any) -> None:
    copy = fetch(f"{URL}/gnss/rtk.nmea")
    assert copy.name == "rtk.nmea"
    assert copy.read_text() == "content of gnss/rtk.nmea"
    assert list(copies.read_manifest(copy).files) == [""]


def test_a_fetch_that_is_interrupted_goes_on(memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetched, "_BATCH", 1)
    get, calls = type(memory).get, list[str]()

    def failing(self: Any, sources: list[str], *arguments: Any) -> Any:
        calls.extend(sources)
        if len(calls) == 2:
            raise ConnectionResetError("the line is down")
        return get(self, sources, *arguments)

    monkeypatch.setattr(type(memory), "get", failing)
    with pytest.raises(RecordingError, match=r"cannot be read \(the line is down\); check the URL"):
        fetch(URL)
    copy = fetch(URL)
    assert len(calls) == 4  # one, the one that failed, and the two that were missing
    assert len(files_of(copy)) == 3
    assert not [path for path in copy.rglob("*") if "partial" in path.name]


def test_a_file_that_arrives_cut_is_no_copy(memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(self: Any, sources: list[str], places: list[str]) -> None:
        for place in places:
            Path(place).write_bytes(b"con")

    monkeypatch.setattr(type(memory), "get", cut)
    with pytest.raises(RecordingError, match=r"frames.csv arrived with 3 of its 21 bytes; repeat"):
        fetch(URL)
    assert files_of(copies.copy_of(URL)) == {}


def test_a_damaged_manifest_costs_a_fetch_and_nothing_else(memory: Any, tmp_path: Path) -> None:
    """One that names files outside of the copy, too."""
    copy, mine = fetch(URL), tmp_path / "mine.txt"
    mine.write_text("mine")
    manifest = copy.with_name(".fetched.json")
    for outside in (str(mine), os.path.relpath(mine, copy)):
        hostile = json.dumps({"url": URL, "files": {outside: "v"}})
        for text in (hostile, "{", "[]", '{"files": 3}', "[" * 100_000):
            manifest.write_text(text)
            assert copies.read_manifest(copy).files == {}
            assert len(files_of(fetch(URL))) == 3
            assert json.loads(manifest.read_text())["url"] == URL
    assert mine.read_text() == "mine"


def test_a_manifest_of_another_copy_gives_no_url(memory: Any) -> None:
    """Workers would fetch from there."""
    copy = fetch(URL)
    manifest = copy.with_name(".fetched.json")
    assert copies.url_of(copy / ".." / copy.name) == URL
    manifest.write_text(manifest.read_text().replace("memory://vines", "memory://olives"))
    assert copies.url_of(copy) is None


def test_drafts_are_where_nobody_else_can_put_a_link(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    get, seen = type(memory).get, list[Path]()

    def noted(self: Any, sources: list[str], places: list[str]) -> None:
        seen.extend(map(Path, places))
        assert {place.parent.stat().st_mode & 0o777 for place in seen} == {0o700}
        get(self, sources, places)

    monkeypatch.setattr(type(memory), "get", noted)
    copy = fetch(URL)
    assert {place.parent.parent for place in seen} == {copy.parent}
    assert not [path for path in copy.parent.rglob("*") if "partial" in path.name]
    (copy.parent / "made here").touch()
    permissions = (copy.parent / "made here").stat().st_mode
    assert {(copy / name).stat().st_mode for name in files_of(copy)} == {permissions}


def test_drafts_of_a_killed_program_are_removed_by_the_next_that_is_alone(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = fetch(URL)
    left = copy.with_name(".abcdefgh.partial")
    left.mkdir()
    (left / "0").touch()

    def refuse(descriptor: int, *, wait: bool) -> None:
        raise OSError(errno.ENOLCK, "no locks")

    with monkeypatch.context() as patched:
        patched.setattr(copies, "lock", refuse)
        fetch(URL)
    assert left.exists()
    fetch(URL)
    assert not left.exists()


@pytest.mark.parametrize("name", ["left", "gnss"])
def test_no_link_in_a_copy_leads_a_fetch_to_other_files(
    name: str, memory: Any, tmp_path: Path
) -> None:
    """Neither to replace one, nor to remove one that is gone from the URL."""
    copy, mine = fetch(URL), tmp_path / "mine"
    shutil.move(copy / name, mine)
    (copy / name).symlink_to(mine)
    before = files_of(mine)
    memory.pipe("/vines/june-03/left/0.png", b"CONTENT of left/0.png")
    memory.rm("/vines/june-03/gnss/rtk.nmea")
    with pytest.raises(RecordingError, match=rf"{name} leads out of the copy .*; remove the link"):
        fetch(URL)
    assert files_of(mine) == before
    (copy / name).unlink()
    assert files_of(fetch(URL))["left/0.png"] == "CONTENT of left/0.png"


def test_no_link_beside_a_copy_is_followed(memory: Any, tmp_path: Path) -> None:
    mine, copy = tmp_path / "mine.txt", fetch(URL)
    mine.write_text("mine")
    for link in (copy / "frames.csv", copy.with_name(".fetched.json")):
        link.unlink()
        link.symlink_to(mine)
    assert files_of(fetch(URL))["frames.csv"] == "content of frames.csv"
    assert copies.url_of(copy) == URL
    assert mine.read_text() == "mine"
    shutil.move(copy.parent, tmp_path / "moved")
    copy.parent.symlink_to(tmp_path / "moved")
    with pytest.raises(RecordingError, match=r"cannot be written \(.*\); .* set FIELDGRID_CACHE"):
        fetch(URL)


@pytest.mark.parametrize(("before", "now"), [("a", "a/b/c.txt"), ("a/b/c.txt", "a")])
@pytest.mark.parametrize("url", ["memory://olives", "memory://olives/a"])
def test_a_folder_takes_the_place_of_a_file_and_a_file_that_of_a_folder(
    url: str, before: str, now: str, memory: Any
) -> None:
    memory.pipe(f"/olives/{before}", b"before")
    copy = fetch(url)
    memory.rm("/olives", recursive=True)
    memory.pipe(f"/olives/{now}", b"now")
    assert fetch(url) == copy
    assert [file.read_text() for file in copy.parent.rglob("[!.]*") if file.is_file()] == ["now"]


def test_a_copy_is_recommended_only_where_it_is_whole(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(at: str) -> str:
        """What the error says when a call of the file system fails."""

        def away(self: Any, *arguments: Any, **options: Any) -> Any:
            raise ConnectionError("the line is down")

        with monkeypatch.context() as patched:
            patched.setattr(type(memory), at, away)
            with pytest.raises(RecordingError, match="the line is down") as failed:
                fetch(URL)
        return str(failed.value)

    copy = copies.copy_of(URL)
    advice = f"or read the copy of before at {copy}"
    assert advice not in fails("get")
    manifest = copies.read_manifest(copy)
    fetch(URL, version=manifest.version, wanted=[copy / "frames.csv"])
    assert list(files_of(copy)) == ["frames.csv"]
    assert advice not in fails("info")
    fetch(URL)
    assert advice in fails("info")
    # A file of another version is removed before the next is there.
    memory.pipe("/vines/june-03/frames.csv", b"CONTENT of frames.csv")
    assert advice in fails("info")
    assert advice not in fails("get")
    assert list(files_of(copy)) == ["gnss/rtk.nmea", "left/0.png"]
    fetch(URL)
    assert advice in fails("info")


def test_files_that_were_killed_on_their_way_are_fetched_again(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = fetch(URL)
    memory.pipe("/vines/june-03/frames.csv", b"CONTENT of frames.csv")
    memory.pipe("/vines/june-03/left/0.png", b"CONTENT of left/0.png")
    replace = Path.replace

    def killed(self: Path, target: Path) -> Path:
        if Path(target).name == "0.png":
            raise KeyboardInterrupt
        return replace(self, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            fetch(URL)
    assert sorted(files_of(copy)) == ["frames.csv", "gnss/rtk.nmea"]
    assert files_of(fetch(URL))["left/0.png"] == "CONTENT of left/0.png"


def test_a_server_that_sends_too_slowly_is_left(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once for an answer, once for what it sends: a byte now and then."""
    ends = threading.Event()

    def info(self: Any, path: str, **_: Any) -> Any:
        ends.wait(60.0)
        raise FileNotFoundError(path)

    def get(self: Any, sources: list[str], places: list[str]) -> None:
        with Path(places[0]).open("wb", buffering=0) as file:
            while not ends.wait(0.1):
                file.write(b"x")

    monkeypatch.setattr(remote_files, "_PATIENCE_S", 1.0)
    try:
        for name, call in (("info", info), ("get", get)):
            with monkeypatch.context() as patched:
                patched.setattr(type(memory), name, call)
                with pytest.raises(RecordingError, match=r"less than 10 kB a second came"):
                    fetch(URL)
            assert not copies.copy_of(URL).exists()
    finally:
        ends.set()
    assert len(files_of(fetch(URL))) == 3


def test_an_address_to_which_a_server_redirects_leaves_no_key(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def get(self: Any, *arguments: Any) -> None:
        raise ConnectionError("403, url='https://store/a?X-Amz-Signature=1234&a=b', refused")

    monkeypatch.setattr(type(memory), "get", get)
    with pytest.raises(RecordingError, match=r"url='https://store/a\?\.\.\.', refused"):
        fetch(URL)


def test_what_cannot_be_fetched_says_why(memory: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RecordingError, match=r"'memory://vines/july' does not exist; give the URL"):
        fetch("memory://vines/july")
    with pytest.raises(RecordingError, match=r"Protocol not known: nothing\); check the URL"):
        fetch("nothing://farm")
    for url in ("sftp://me:secret@host/june-03", "https://host/d.zip?X-Amz-Signature=12"):
        with pytest.raises(ConfigError, match=r"with a password or a key would leave it in logs"):
            fetch(url)
    with pytest.raises(RecordingError, match=r"is no folder whose files can be listed"):
        fetch(f"{URL}/gnss/rtk.nmea/")
    with limited(rows=2), pytest.raises(LimitError, match=r"more than 2 rows"):
        fetch(URL)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=10))
    with pytest.raises(RecordingError, match=r"room for 0.0 GB; free some, or set FIELDGRID_CACHE"):
        fetch(URL)


def test_a_server_that_refuses_or_is_not_there_is_not_a_file_that_does_not_exist(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file system of the web says of all of them that the file does not exist."""

    class Refused(Exception):  # noqa: N818 - as the library calls it
        def __init__(self, status: int) -> None:
            super().__init__(f"{status}, says the server")
            self.status = status

    cases = (
        (ConnectionRefusedError(111, "refused"), r"cannot be read \(.*refused\); check the URL"),
        (Refused(403), r"cannot be read \(403, says the server\); check the URL, the connection"),
        (Refused(404), r"does not exist; give the URL of a recording"),
        (FileNotFoundError(), r"does not exist; give the URL of a recording"),
        (ValueError("NoSuchBucket"), r"does not exist; give the URL of a recording"),
    )
    for cause, said in cases:

        def info(self: Any, path: str, cause: Exception = cause) -> Any:
            raise FileNotFoundError(path) from cause

        monkeypatch.setattr(type(memory), "info", info)
        with pytest.raises(RecordingError, match=said):
            fetch(URL)


def test_an_archive_is_copied_whole_where_the_server_gives_no_parts(
    drive: Path, zipped: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive, url_to_fs = tmp_path / "2026.zip", fsspec.core.url_to_fs
    asked: list[str] = []

    def without_parts(url: str, **_: Any) -> Any:
        asked.append(url)
        if url == "zip://june-03::http://host/2026.zip":
            raise ValueError("The HTTP server doesn't appear to support range requests.")
        return url_to_fs(url.replace("http://host/", f"memory://{tmp_path}/"))

    fsspec.filesystem("memory").pipe(str(archive), archive.read_bytes())
    monkeypatch.setattr(fsspec.core, "url_to_fs", without_parts)
    copy = fetch("zip://june-03::http://host/2026.zip")
    assert copy == copies.copy_of("zip://june-03::http://host/2026.zip")
    assert (copy / "frames.csv").read_bytes() == (drive / "frames.csv").read_bytes()
    assert copies.copy_of("http://host/2026.zip").read_bytes() == archive.read_bytes()
    assert asked.count("zip://june-03::http://host/2026.zip") == 1
    with pytest.raises(RecordingError, match=r"is an archive; .* as in zip://FOLDER::http://host"):
        fetch("http://host/2026.zip")
    monkeypatch.setattr(fsspec.core, "url_to_fs", lambda url, **_: int("x"))
    with pytest.raises(RecordingError, match=r"cannot be read \(invalid literal for int"):
        fetch("zip://june-03::s3://vines/2026.zip")


def test_a_name_that_leads_out_of_the_recording_is_refused(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hostile(self: Any, root: str, detail: bool) -> list[dict[str, Any]]:
        return [{"name": f"{root}/../../evil", "size": 1, "type": "file"}]

    monkeypatch.setattr(type(memory), "ls", hostile)
    with pytest.raises(RecordingError, match=r"leads out of it, .*; put the file itself"):
        fetch(URL)


def test_an_empty_object_that_stands_for_a_folder_is_no_file(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    ls = type(memory).ls

    def like_s3(self: Any, root: str, detail: bool) -> list[dict[str, Any]]:
        made = [{"name": name, "size": 0, "type": "file"} for name in (root, f"{root}/")]
        return [*made, *ls(self, root, detail=detail)]

    monkeypatch.setattr(type(memory), "ls", like_s3)
    assert len(files_of(fetch(URL))) == 3


@pytest.mark.parametrize("error", [OSError(errno.ENOLCK, "no locks"), PermissionError()])
def test_without_locks_a_fetch_goes_on(
    error: OSError, memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(descriptor: int, *, wait: bool) -> None:
        raise error

    monkeypatch.setattr(copies, "lock", refuse)
    assert len(files_of(fetch(URL))) == 3


def test_another_process_that_fetches_is_waited_for(
    memory: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    waited: list[bool] = []

    def held(descriptor: int, *, wait: bool) -> None:
        waited.append(wait)
        if not wait:
            raise BlockingIOError

    monkeypatch.setattr(copies, "lock", held)
    fetch(URL)
    assert waited == [False, True]
    assert "waiting for another process that fetches" in caplog.text


def test_a_process_that_is_forked_while_fetching_does_not_keep_the_lock(
    memory: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has a copy of the descriptor, as `os.dup` makes one."""
    lock, kept = copies.lock, list[int]()

    def forking(descriptor: int, *, wait: bool) -> None:
        lock(descriptor, wait=wait)
        kept.append(os.dup(descriptor))

    monkeypatch.setattr(copies, "lock", forking)
    copy = fetch(URL)
    try:
        another = os.open(copy.parent, os.O_RDONLY)
        lock(another, wait=False)
    finally:
        os.close(kept[0])
        os.close(another)


def test_a_cache_that_cannot_be_written_is_named(
    memory: Any, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Any, *arguments: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(type(memory), "get", full)
        with pytest.raises(RecordingError, match=r"No space left on device\); free some space"):
            fetch(URL)
    (cache / "recordings").mkdir(parents=True, exist_ok=True)
    shutil.rmtree(cache / "recordings")
    (cache / "recordings").write_text("a file in the way")
    with pytest.raises(RecordingError, match=r"cannot be written \(.*\); .* set FIELDGRID_CACHE"):
        fetch(URL)


def test_a_relative_cache_folder_is_that_of_now(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FIELDGRID_CACHE", "here")
    assert copies.cache_folder() == Path.cwd() / "here"


# --- drives


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small_drive(tmp_path_factory.mktemp("drives") / "june-03", range(3, 9))


@pytest.fixture
def zipped(drive: Path, tmp_path: Path) -> str:
    """The URL of the drive in an archive, which every process can read."""
    with ZipFile(tmp_path / "2026.zip", "w") as archive:
        for file in sorted(drive.rglob("*")):
            if file.is_file():
                archive.write(file, f"june-03/{file.relative_to(drive)}")
    return f"zip://june-03::{tmp_path / '2026.zip'}"


def test_an_archive_that_unfolds_to_too_much_is_not_fetched(cache: Path, tmp_path: Path) -> None:
    with ZipFile(tmp_path / "2026.zip", "w", ZIP_DEFLATED) as archive:
        for k in range(5):
            archive.writestr(f"june-03/{k}.png", bytes(20 << 20))
    with pytest.raises(LimitError, match=r"unfolds to more than 64 MiB.*LIMIT_FACTOR=800"):
        fetch(f"zip://june-03::{tmp_path / '2026.zip'}")
    assert not [file for file in cache.rglob("*") if file.is_file()]
    with limited(factor=2000):
        assert len(list(fetch(f"zip://june-03::{tmp_path / '2026.zip'}").iterdir())) == 5


def test_a_drive_at_a_url_gives_the_map_of_the_drive(
    zipped: str, drive: Path, tmp_path: Path
) -> None:
    """But for the names of its images, which are those of the copy."""
    build_map([drive], tmp_path / "here.gpkg", BuildSettings())
    result = CliRunner().invoke(app, ["build", zipped, "-o", str(tmp_path / "there.gpkg")])
    assert result.exit_code == 0, result.output
    with open_map(tmp_path / "here.gpkg") as one, open_map(tmp_path / "there.gpkg") as other:
        (own,), (found,) = one.sessions(), other.sessions()
        assert (found.name, found.frames) == (own.name, own.frames)
        assert (one.read().density == other.read().density).all()
    copy = str(copies.copy_of(zipped))
    tables = content(tmp_path / "here.gpkg"), content(tmp_path / "there.gpkg")
    assert tables[0]["fieldgrid_tile"] == tables[1]["fieldgrid_tile"]
    assert copy in str(tables[1]["fieldgrid_frame"])


def test_of_several_drives_one_that_is_not_there_is_left_out(
    zipped: str, drive: Path, tmp_path: Path
) -> None:
    gone = zipped.replace("june-03", "july")
    with pytest.raises(PartlyBuiltError) as told:
        build_map([gone, zipped], tmp_path / "m.gpkg", BuildSettings())
    ((name, reason),) = told.value.failed
    assert name == gone
    assert "does not exist" in reason
    result = CliRunner().invoke(app, ["build", gone, zipped, "-o", str(tmp_path / "n.gpkg")])
    assert result.exit_code == 1
    assert "does not exist; give the URL" in str(result.exception)
    assert content(tmp_path / "m.gpkg") == content(tmp_path / "n.gpkg")


def test_the_mounting_of_a_copy_is_not_written(zipped: str) -> None:
    estimate = estimate_mount(zipped)
    for place in (zipped, fetch(zipped)):
        with pytest.raises(ConfigError, match=r"is only read, so its mounting was not written;"):
            write_estimate(estimate, place)


def work_on(here: Path) -> DriveWork:
    with open_drive(here, DriveOptions()) as opened:
        recording = opened.recording()
        return NewSession(recording, BuildSettings(), None, "june").work


def test_a_worker_fetches_the_files_of_its_frames_only(
    memory: Any, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And of the one before them, from which the camera's step leads; where frames may be passed
    over, it fetches all."""
    for file in drive.rglob("*"):
        if file.is_file():
            memory.pipe(f"/vines/june-10/{file.relative_to(drive)}", file.read_bytes())
    here = fetch("memory://vines/june-10")
    work = work_on(here)
    place = remote.place_of(here)
    packed = remote.packed(work, place)
    passing_over = remote.packed(work._replace(skips_bad=True), place)
    parts = [remote.stage_share(packed, Share(k, k + 2), place) for k in (0, 2)]
    monkeypatch.setenv("FIELDGRID_CACHE", str(tmp_path / "of the worker"))
    remote._unpacked.cache_clear()
    fetched._listed_lately.cache_clear()
    listed: list[str] = []
    ls = type(memory).ls
    monkeypatch.setattr(
        type(memory),
        "ls",
        lambda self, path, **how: listed.append(path) or ls(self, path, **how),
    )
    copy = copies.copy_of("memory://vines/june-10")
    for start, there in ((0, 2), (2, 4)):
        made = remote.stage_share(packed, Share(start, start + 2), place)
        assert made.frames[1].staged == parts[start // 2].frames[1].staged
        files = {path.relative_to(copy).parts[0] for path in copy.rglob("*") if path.is_file()}
        assert files == {"left", "right"}
        assert len([path for path in copy.rglob("*") if path.is_file()]) == 2 * there
    assert len(listed) == len(set(listed))
    # The next build that needs all of it fetches the rest.
    remote.stage_share(passing_over, Share(0, 2), place)
    assert files_in(copy) == files_in(here)
    # Of another version nothing is mixed with what was read of it before.
    shutil.rmtree(tmp_path / "of the worker")
    fetched._listed_lately.cache_clear()
    memory.pipe("/vines/june-10/left/000004.jpg", b"new")
    with pytest.raises(ClusterError, match=r"has changed since this build began; build it again"):
        remote.stage_share(packed, Share(0, 2), place)


def files_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


class Linked(LocalFileSystem):  # type: ignore[misc]
    """The files of this machine, listed as by SSH: a link as such, without where it leads."""

    protocol = "linked"

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(path).removeprefix("linked://").rstrip("/") or "/"

    def ls(self, path: str, detail: bool = False, **_: Any) -> list[Any]:
        entries = [self.about(f"{path.rstrip('/')}/{name}") for name in os.listdir(path)]
        return entries if detail else [entry["name"] for entry in entries]

    def about(self, path: str) -> dict[str, Any]:
        status = os.lstat(path)
        kind = "link" if Path(path).is_symlink() else "directory" if Path(path).is_dir() else "file"
        return {"name": path, "type": kind, "size": status.st_size, "mtime": status.st_mtime}

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        return {**self.about(os.path.realpath(path)), "name": path}

    @classmethod
    def fails_at(cls, name: str, error: OSError, monkeypatch: pytest.MonkeyPatch) -> None:
        """Folders of this name cannot be listed either."""
        list_folder = cls.ls

        def failing(self: Linked, path: str, detail: bool = False, **how: Any) -> list[Any]:
            if path.endswith(f"/{name}"):
                raise error
            return list_folder(self, path, detail, **how)

        monkeypatch.setattr(cls, "ls", failing)


_LINKED_LS = Linked.ls
_DENIED = PermissionError(errno.EACCES, "Permission denied")


@pytest.fixture
def linked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(importlib.import_module("fsspec.registry")._registry, "linked", Linked)


@pytest.mark.usefixtures("linked")
@pytest.mark.parametrize("target", ["../june-02/right", "0.png", "gone.png", "/"])
def test_a_link_at_a_url_is_refused(target: str, tmp_path: Path) -> None:
    """It could lead to anything that the server has."""
    for name in ("june-03/left/0.png", "june-02/right/0.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"content of {name}")
    (tmp_path / "june-03" / "left" / "1.png").symlink_to(target)
    url = f"linked://{tmp_path}/june-03"
    with pytest.raises(
        RecordingError, match=r"has a link, .* 'left/1.png', which is not followed; put"
    ):
        fetch(url)
    assert not copies.copy_of(url).exists()


def june(tmp_path: Path, *names: str) -> str:
    """The URL of a folder with these files."""
    for name in names:
        (tmp_path / "june" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "june" / name).write_text(f"content of {name}")
    return f"linked://{tmp_path}/june"


@pytest.mark.usefixtures("linked")
@pytest.mark.parametrize("chain", ["linked://{}/june", "dir://june::linked://{}"])
def test_what_a_disk_keeps_for_itself_is_no_part_of_a_recording(
    chain: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    june(tmp_path, "a.txt", "left/0.png", "lost+found/#1")
    Linked.fails_at("lost+found", _DENIED, monkeypatch)
    copy = fetch(chain.format(tmp_path))
    assert sorted(files_of(copy)) == ["a.txt", "left/0.png"]
    assert copies.read_manifest(copy).is_here(copy)


def unreachable() -> FileNotFoundError:
    """As fsspec says of a server that is not there."""
    error = FileNotFoundError("right")
    error.__cause__ = ConnectionRefusedError("nobody listens")
    return error


@pytest.mark.usefixtures("linked")
@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            ConnectionResetError(errno.ECONNRESET, "reset by peer"),
            "june' cannot be read .*reset by",
        ),
        (TimeoutError("timed out"), "june' cannot be read .*timed out"),
        (OSError(errno.EIO, "a bad disk"), "june' cannot be read .*a bad disk"),
        (unreachable(), "june' cannot be read .*nobody listens"),
        (_DENIED, "june' cannot be read .*Permission denied.* your credentials"),
    ],
)
def test_a_listing_that_breaks_off_is_no_recording_without_the_rest(
    error: OSError, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = june(tmp_path, "a.txt", "left/0.png", "right/0.png")
    Linked.fails_at("right", error, monkeypatch)
    with pytest.raises(RecordingError, match=told):
        fetch(url)
    assert not copies.copy_of(url).exists()


class Circle(AbstractFileSystem):  # type: ignore[misc]
    """Each folder has `loops` that lead back to it, shown as folders."""

    def __init__(self, loops: int) -> None:
        super().__init__(skip_instance_cache=True)
        self.loops, self.listed = loops, 0

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        return {"name": path, "type": "directory", "size": 0}

    def ls(self, path: str, detail: bool = True, **_: Any) -> list[Any]:
        self.listed += 1
        assert self.listed < 1000, "there is no end"
        loops = [self.info(f"{path}/{k}") for k in range(self.loops)]
        return [*loops, {"name": f"{path}/a.txt", "type": "file", "size": 1}]


def test_folders_that_go_round_in_a_circle_have_an_end() -> None:
    with pytest.raises(RecordingError, match=r"100 deep in each other.* is a link to a folder"):
        remote_files.listed_files(Circle(loops=1), "farm/june", "circle://farm/june")
    with limited(rows=500), pytest.raises(LimitError, match="june has more than 500 rows"):
        remote_files.listed_files(Circle(loops=2), "farm/june", "circle://farm/june")


@pytest.mark.usefixtures("linked")
def test_a_recording_that_cannot_be_listed_is_refused_and_its_copy_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = june(tmp_path, "a.txt")
    copy = fetch(url)
    Linked.fails_at("june", _DENIED, monkeypatch)
    with pytest.raises(RecordingError, match="Permission denied"):
        fetch(url)
    assert files_of(copy) == {"a.txt": "content of a.txt"}


def test_a_worker_makes_its_own_copy_and_names_images_as_here(
    zipped: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = fetch(zipped)
    place = remote.place_of(here)
    work = remote.packed(work_on(here), place)
    assert place.url == zipped
    at_home = remote.stage_share(work, Share(0, 2), place)
    monkeypatch.setenv("FIELDGRID_CACHE", str(tmp_path / "of the worker"))
    remote._unpacked.cache_clear()
    far_away = remote.stage_share(work, Share(0, 2), place)
    assert (copies.copy_of(zipped) / "left" / "000003.jpg").exists()
    (far, _), (home, _) = ((one.staged for one in made.frames) for made in (far_away, at_home))
    assert far == home
    assert far is not None
    assert far.images[0].startswith(str(here))
    # A recording that changes in between is not mixed with what was read of it before.
    with pytest.raises(ClusterError, match=r"has changed since this build began; build it again"):
        remote.stage_share(work, Share(0, 2), place._replace(version="of before"))
    shutil.rmtree(tmp_path / "of the worker")
    (tmp_path / "2026.zip").unlink()
    fetched._listed_lately.cache_clear()
    with pytest.raises(ClusterError, match=r"The worker on .* has no copy: .*; "):
        remote.stage_share(work, Share(0, 2), place)
