"""The hidden folder by which names change all at once is used only where it is this program's."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid.core import MapExistsError, MapWriteError
from fieldgrid.export import name_set, together
from fieldgrid.export.name_set import held_set, show
from fieldgrid.export.together import write_together
from tests.export.killing import KilledAt, text, write_set
from tests.export.test_together import seen, write


def written(folder: Path) -> dict[str, str]:
    """What is in a folder, with all that is hidden."""
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


NOTES = {
    ".a.main.set/notes.txt": "mine",
    ".a.main.set/old/deep/photo": "mine",
    ".a.main.set/new/deep/photo": "mine",
    ".a.main.set/now": "mine",
}


@pytest.mark.parametrize("place", NOTES)
def test_a_folder_with_other_things_is_left_alone(tmp_path: Path, place: str) -> None:
    """Each of them, beside an older set."""
    write(tmp_path, "side 1", "main 1")
    (tmp_path / place).parent.mkdir(parents=True)
    (tmp_path / place).write_text(NOTES[place])
    write(tmp_path, "side 2", "main 2")
    assert written(tmp_path) == {"a.side": "side 2", "a.main": "main 2", place: "mine"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_elsewhere_that_a_link_leads_to_is_left_alone(
    tmp_path: Path, overwrite: bool
) -> None:
    """Anybody can make such a link in a folder that several users share."""
    victim, shared = tmp_path / "victim", tmp_path / "shared"
    (victim / "old").mkdir(parents=True)
    (victim / "old" / "plan").write_text("mine")
    (victim / "spare").write_text("mine")
    shared.mkdir()
    (shared / ".a.main.set").symlink_to("../victim")
    write_together(
        {shared / name: text(name) for name in ("a.side", "a.main")},
        overwrite=overwrite,
        ours=lambda _: True,
        what="a test",
    )
    assert written(victim) == {"old/plan": "mine", "spare": "mine"}
    assert seen(shared) == {"a.side": "a.side", "a.main": "a.main"}


def test_an_export_that_is_refused_makes_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, "side", "main")
    monkeypatch.setattr(Path, "mkdir", lambda *_: pytest.fail("a folder"))
    with pytest.raises(MapExistsError):
        write_together(
            {tmp_path / "a.main": text("new")}, overwrite=False, ours=lambda _: True, what="a test"
        )


def test_what_comes_into_the_folder_meanwhile_stays(tmp_path: Path) -> None:
    with held_set(tmp_path / "a.main") as held:
        assert held
        (held.name / "notes.txt").write_text("mine")
    assert written(tmp_path) == {".a.main.set/notes.txt": "mine"}


Leave = Callable[[Path], None]


@pytest.fixture
def crashed(killed_at: KilledAt) -> Leave:
    """Leaves a set whose names are links, as a program that was killed does."""

    def leave(folder: Path) -> None:
        for number in range(200):
            write_set(folder, "old", ("a.side",))
            assert killed_at(number, folder, "new", ("a.side",))
            if (folder / "a.main").is_symlink():
                return

    return leave


@pytest.mark.parametrize("overwrite", [False, True])
def test_names_whose_set_somebody_has_deleted_are_free(
    tmp_path: Path, crashed: Leave, overwrite: bool
) -> None:
    crashed(tmp_path)
    shutil.rmtree(tmp_path / ".a.main.set")
    assert (tmp_path / "a.main").is_symlink()
    write_together(
        {tmp_path / name: text(f"third {name}") for name in ("a.side", "a.main")},
        overwrite=overwrite,
        ours=lambda _: True,
        what="a test",
    )
    assert written(tmp_path) == {"a.side": "third a.side", "a.main": "third a.main"}
    assert not any(path.is_symlink() for path in tmp_path.iterdir())


def test_a_set_that_another_user_left_is_named(
    tmp_path: Path, crashed: Leave, monkeypatch: pytest.MonkeyPatch
) -> None:
    crashed(tmp_path)
    old, user = seen(tmp_path), os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    left = re.escape(str(tmp_path / ".a.main.set"))
    with pytest.raises(MapWriteError, match=f"another user has left.*remove {left}"):
        write_set(tmp_path, "new", ("a.side",))
    assert seen(tmp_path) == old


def test_a_set_that_may_not_be_settled_is_named(
    tmp_path: Path, crashed: Leave, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its links are another user's, in a folder whose files only their owners may replace."""
    crashed(tmp_path)
    old = seen(tmp_path)

    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(MapWriteError, match="another user has left"):
        write_set(tmp_path, "new", ("a.side",))
    assert seen(tmp_path) == old


def test_an_empty_folder_of_another_user_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_set(tmp_path, "old", ("a.side",))
    (tmp_path / ".a.main.set").mkdir()
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    write_set(tmp_path, "new", ("a.side",))
    assert seen(tmp_path) == {"a.side": "new a.side", "a.main": "new a.main"}
    assert (tmp_path / ".a.main.set").is_dir()


def test_files_of_another_user_that_may_not_be_replaced_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a folder such as /tmp; the system lets nobody link such files, either."""
    write_set(tmp_path, "old", ("a.side",))
    old, remove = seen(tmp_path), os.unlink

    def refuse(place: Path, *arguments: object) -> None:
        if "partial" not in Path(place).name:
            raise PermissionError(1, "Operation not permitted")
        remove(place)

    monkeypatch.setattr(os, "unlink", refuse)
    monkeypatch.setattr(together, "show", lambda *_: False)
    with pytest.raises(MapWriteError, match=r"a\.main could not be removed .*permissions"):
        write_set(tmp_path, "new", ("a.side",))
    assert seen(tmp_path) == old


def test_a_file_system_that_gives_all_files_to_one_user_keeps_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    write_set(tmp_path, "new", ("a.side",))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.main", "a.side"]


def test_a_program_that_hangs_is_not_waited_for_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(name_set, "WAIT_S", 0.1)
    in_use = re.escape(f"{tmp_path / '.a.main.set'} is in use")
    with (
        held_set(tmp_path / "a.main"),
        pytest.raises(MapWriteError, match=in_use),
        held_set(tmp_path / "a.main"),
    ):
        pass


def test_links_by_another_case_of_the_name_are_settled(
    tmp_path: Path, crashed: Leave, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a folder where `A.main` and `a.main` are one file."""
    crashed(tmp_path)
    old = seen(tmp_path)
    for name in ("a.side", "a.main"):
        (tmp_path / name).unlink()
        (tmp_path / name).symlink_to(f".A.main.set/now/{name}")
    real = Path.lstat
    monkeypatch.setattr(
        Path, "lstat", lambda path: real(path.with_name(path.name.replace(".A.", ".a.")))
    )
    with held_set(tmp_path / "a.main") as held:
        assert held
    assert seen(tmp_path) == old
    assert not any(path.is_symlink() for path in tmp_path.iterdir())


def test_no_other_user_can_change_a_set(tmp_path: Path) -> None:
    (tmp_path / "a.new").write_text("new")
    usual = os.umask(0)
    try:
        with held_set(tmp_path / "a.main") as held:
            assert held
            assert show(held, {"a.main": tmp_path / "a.new"}, [])
            modes = {path.stat().st_mode & 0o777 for path in (held.name, *held.name.iterdir())}
    finally:
        os.umask(usual)
    assert modes == {0o755}


def test_a_link_of_the_user_into_the_folder_stays(tmp_path: Path) -> None:
    write_set(tmp_path, "old", ("a.side",))
    (tmp_path / "mine").symlink_to(".a.main.set/now/a.side")
    with held_set(tmp_path / "a.main") as held:
        assert held
        for name in ("a.side", "a.main"):
            (tmp_path / f"{name}.new").write_text("new")
        assert show(held, {n: tmp_path / f"{n}.new" for n in ("a.side", "a.main")}, [])
    assert (tmp_path / "mine").is_symlink()


def test_a_folder_that_takes_the_place_of_the_set_meanwhile_is_left_alone(tmp_path: Path) -> None:
    """Who may rename things in a folder that several users share can do that."""
    write_set(tmp_path, "old", ("a.side",))
    victim = tmp_path / "victim"
    for part in ("old", "new"):
        (victim / part).mkdir(parents=True)
        (victim / part / "a.side").write_text("mine")
    new = {name: tmp_path / f"{name}.new" for name in ("a.side", "a.main")}
    for file in new.values():
        file.write_text("new")
    with held_set(tmp_path / "a.main") as held:
        assert held
        held.name.rename(tmp_path / "aside")
        held.name.symlink_to("victim")
        assert show(held, new, [])
    assert [(victim / part / "a.side").read_text() for part in ("old", "new")] == ["mine", "mine"]
    assert [(tmp_path / name).read_text() for name in new] == ["new", "new"]
    assert not any((tmp_path / name).is_symlink() for name in new)
    assert list((tmp_path / "aside").iterdir()) == []


def test_a_program_that_was_forked_meanwhile_does_not_keep_the_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(name_set, "WAIT_S", 0.05)
    copies: list[int] = []
    with held_set(tmp_path / "a") as held:
        assert held is not None
        copies += [os.dup(int(held.inside.name))]  # as fork() makes it in the other process
        (held.name / "note").write_text("of somebody else, so that the folder stays")
    try:
        with held_set(tmp_path / "a") as again:  # not "is in use"
            assert again is None
    finally:
        os.close(copies[0])
