"""Files that belong together get their names so that nobody opens one with those of another."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import MapExistsError, MapWriteError, lock, publish
from fieldgrid.export import name_set
from fieldgrid.export.name_set import held_set
from fieldgrid.export.together import write_together
from tests.export.killing import KilledAt, text, write_set


def write(folder: Path, side: str, main: str) -> None:
    write_together(
        {folder / "a.side": text(side), folder / "a.main": text(main)},
        overwrite=True,
        ours=lambda _: True,
        what="a test",
    )


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What stands in the main file and in the one beside it at each change of a name."""
    states: list[tuple[str, str]] = []

    def watched(change: Callable[..., None]) -> Callable[..., None]:
        def instead(file: Path, *arguments: object, **options: object) -> None:
            change(file, *arguments, **options)
            states.append(
                (
                    main.read_text() if (main := file.with_name("a.main")).exists() else "",
                    side.read_text() if (side := file.with_name("a.side")).exists() else "",
                )
            )

        return instead

    monkeypatch.setattr(Path, "replace", watched(Path.replace))
    monkeypatch.setattr(Path, "unlink", watched(Path.unlink))
    return states


@pytest.fixture
def no_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system such as FAT."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(os, "symlink", refuse)


@pytest.mark.usefixtures("no_links")
def test_without_links_the_main_one_goes_first(
    tmp_path: Path, named: list[tuple[str, str]]
) -> None:
    write(tmp_path, "side 1", "main 1")
    named.clear()
    write(tmp_path, "side 2", "main 2")
    assert ("", "side 1") in named
    assert ("main 1", "side 2") not in named
    assert ("main 2", "side 1") not in named
    assert named[-1] == ("main 2", "side 2")


def test_with_the_same_files_beside_it_the_main_one_is_never_missing(
    tmp_path: Path, named: list[tuple[str, str]]
) -> None:
    write(tmp_path, "side", "main 1")
    named.clear()
    write(tmp_path, "side", "main 2")
    assert all(main for main, _ in named)
    assert named[-1] == ("main 2", "side")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.main", "a.side"]


def test_with_one_other_file_beside_it_neither_is_ever_missing(
    tmp_path: Path, named: list[tuple[str, str]]
) -> None:
    """A picture that changes under the same extent: old or new, whenever the program is killed."""
    write(tmp_path, "side 1", "main")
    before = (tmp_path / "a.main").stat()
    named.clear()
    write(tmp_path, "side 2", "main")
    assert set(named) <= {("main", "side 1"), ("main", "side 2")}
    assert named[-1] == ("main", "side 2")
    assert (tmp_path / "a.main").stat().st_mtime_ns > before.st_mtime_ns
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.main", "a.side"]


@pytest.mark.usefixtures("no_links")
def test_without_links_the_folder_is_synced_once_before_the_main_one_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is waited for, but that, while the main file is missing."""
    files = [tmp_path / name for name in ("a.one", "a.two", "a.main")]
    missing: list[str] = []
    original = publish.sync

    def watched(path: Path) -> None:
        if files[-1].with_suffix(".old").exists() and not files[-1].exists():
            missing.append(path.name)
        original(path)

    for words in ("old", "new"):
        monkeypatch.setattr(publish, "sync", watched)
        write_together(
            {file: text(words) for file in files}, overwrite=True, ours=lambda _: True, what="it"
        )
        files[-1].with_suffix(".old").touch()
    assert missing == [tmp_path.name]


def seen(folder: Path) -> dict[str, str]:
    """What programs can open in a folder."""
    return {
        path.name: path.read_text()
        for path in folder.iterdir()
        if path.is_file() and not path.name.startswith(".")
    }


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("a.side", "a.world"), ("a.side", "a.world")),
        (("a.side", "a.mask"), ("a.side",)),
        (("a.side",), ("a.side", "a.mask")),
    ],
)
def test_a_kill_at_any_change_leaves_all_old_or_all_new(
    before: tuple[str, ...], after: tuple[str, ...], tmp_path: Path, killed_at: KilledAt
) -> None:
    found: list[str] = []
    while True:
        folder = tmp_path / str(len(found))
        folder.mkdir()
        write_set(folder, "old", before)
        old = seen(folder)
        if not killed_at(len(found), folder, "new", after):
            break
        new = {name: f"new {name}" for name in (*after, "a.main")}
        assert seen(folder) in (old, new)
        found.append("old" if seen(folder) == old else "new")
        # A second program is killed while it tidies up after the first.
        if killed_at(len(found) % 7, folder, "third", after):
            assert seen(folder) in (old, new)
        write_set(folder, "third", after)
        assert seen(folder) == {name: f"third {name}" for name in (*after, "a.main")}
        assert not any(path.is_symlink() for path in folder.iterdir())
        assert len(list(folder.iterdir())) == len(after) + 1, list(folder.iterdir())
    assert found == sorted(found, reverse=True)
    assert min(found.count("old"), found.count("new")) > 5, found


def test_what_another_program_makes_meanwhile_is_not_replaced_unasked(tmp_path: Path) -> None:
    def late(file: Path) -> None:
        (tmp_path / "a.main").write_text("theirs")
        file.write_text("ours")

    with pytest.raises(MapExistsError, match="exists already"):
        write_together(
            {tmp_path / "a.side": text("ours"), tmp_path / "a.main": late},
            overwrite=False,
            ours=lambda _: True,
            what="a test",
        )
    assert seen(tmp_path) == {"a.main": "theirs"}


@pytest.mark.parametrize("name", ["link", "symlink", "replace"])
def test_a_disk_that_fails_leaves_the_old_ones_and_nothing_else(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_set(tmp_path, "old", ("a.side",))
    old, change, left = seen(tmp_path), getattr(os, name), 2

    def fail(*arguments: Any, **options: Any) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        change(*arguments, **options)

    monkeypatch.setattr(os, name, fail)
    with pytest.raises(MapWriteError, match="No space left on device"):
        write_set(tmp_path, "new", ("a.side",))
    assert seen(tmp_path) == old
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.main", "a.side"]
    assert not any(path.is_symlink() for path in tmp_path.iterdir())


def test_the_disk_has_each_step_before_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a power cut could leave one name of the old files beside the new ones."""
    write_set(tmp_path, "old", ("a.side",))
    steps: list[str] = []

    def noted(what: str, change: Callable[..., None]) -> Callable[..., None]:
        def instead(*arguments: Any, **options: Any) -> None:
            change(*arguments, **options)
            place = Path(arguments[-1])
            if place.parent == Path("/proc/self/fd"):  # a folder by its descriptor
                place = place.resolve()
            if not place.name.endswith(".partial"):
                steps.append(f"{what} {place.name}")

        return instead

    monkeypatch.setattr(os, "replace", noted("name", os.replace))
    monkeypatch.setattr(name_set, "sync", noted("sync", name_set.sync))
    write_set(tmp_path, "new", ("a.side",))
    here = f"sync {tmp_path.name}"
    made, changed, settled = steps[:3], steps[3:8], steps[8:]
    assert made == ["sync old", "sync new", "sync .a.main.set"]
    assert changed == ["name a.side", "name a.main", here, "name now", "sync .a.main.set"]
    assert sorted(settled) == ["name a.main", "name a.side", here]
    assert settled[-1] == here


def test_a_second_writer_of_the_same_set_waits(tmp_path: Path) -> None:
    with held_set(tmp_path / "a.main") as held:
        assert held
        descriptor = os.open(held.name, os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            lock(descriptor, wait=False)
        os.close(descriptor)
    assert list(tmp_path.iterdir()) == []


def test_a_set_whose_folder_is_gone_when_its_turn_comes_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The writer that it waited for has removed the folder."""
    real, waited = name_set.hold, list[Path]()

    def late(descriptor: int, folder: Path) -> bool:
        if not waited:
            folder.rmdir()
        waited.append(folder)
        return real(descriptor, folder)

    monkeypatch.setattr(name_set, "hold", late)
    with held_set(tmp_path / "a.main") as held:
        assert held
        assert held.name.is_dir()
    assert len(waited) == 2


def test_links_of_the_user_stay(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "a.mask").symlink_to(tmp_path / "deep" / "mask")
    (tmp_path / "deep" / "mask").write_text("mine")
    (tmp_path / "a.main").symlink_to("real.main")
    (tmp_path / "here").symlink_to(".")
    write_set(tmp_path, "old", ("a.side",))
    write_set(tmp_path, "new", ("a.side",))
    assert (tmp_path / "a.mask").read_text() == "mine"
    assert (tmp_path / "a.main").readlink() == Path("real.main")
    assert (tmp_path / "real.main").read_text() == "new a.main"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.main",
        "a.mask",
        "a.side",
        "deep",
        "here",
        "real.main",
    ]
