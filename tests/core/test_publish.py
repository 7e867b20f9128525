"""Folders that appear whole or not at all; of files, see the tests of the map."""

from __future__ import annotations

import ctypes
import fcntl
import gc
import subprocess
import sys
from pathlib import Path

import pytest

from fieldgrid.core import Draft, DraftFolder, MapExistsError, publish, replacing


def draft_of(target: Path, *, overwrite: bool = False) -> DraftFolder:
    return DraftFolder(
        target, overwrite=overwrite, ours=lambda f: (f / "ours").exists(), what="ours"
    )


def test_a_folder_appears_at_once(tmp_path: Path) -> None:
    target = tmp_path / "out"
    draft = draft_of(target)
    (draft.folder / "ours").write_text("new")
    assert not target.exists()
    draft.publish()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (target / "ours").read_text() == "new"


def test_a_folder_is_replaced_only_if_it_is_ours(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "thesis").write_text("mine")
    with pytest.raises(MapExistsError, match="--overwrite"):
        draft_of(target)
    with pytest.raises(MapExistsError, match="holds other things than ours"):
        draft_of(target, overwrite=True)
    (target / "ours").write_text("old")
    draft = draft_of(target, overwrite=True)
    (draft.folder / "ours").write_text("new")
    draft.publish()
    assert {path.name: path.read_text() for path in target.iterdir()} == {"ours": "new"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_a_killed_program_left_is_swept_and_what_is_held_is_not(tmp_path: Path) -> None:
    left = tmp_path / ".out.0123abcd.partial"
    left.mkdir()
    (left / "half").write_text("x")
    other = tmp_path / ".other.0123abcd.partial"
    other.mkdir()
    held = draft_of(tmp_path / "out")
    (held.folder / "ours").write_text("first")
    assert not left.exists()
    second = draft_of(tmp_path / "out")
    assert held.folder.exists()
    assert other.exists()
    second.discard()
    held.publish()
    assert (tmp_path / "out" / "ours").read_text() == "first"


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_draft_that_was_killed_before_anything_was_in_it_is_swept(
    kind: str, tmp_path: Path
) -> None:
    target = tmp_path / "out.gpkg"
    if kind == "folder":
        (tmp_path / ".out.gpkg.0123abcd.partial").mkdir()
        draft_of(target).discard()
    else:
        (tmp_path / ".out.gpkg.0123abcd.partial.gpkg").touch()
        Draft(target, overwrite=False).discard()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_draft_that_another_program_swept_before_it_was_held_is_made_again(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, swept = fcntl.flock, list[str]()

    def late(descriptor: int, how: int) -> None:
        if not swept:
            swept.append("")
            publish._remove_orphans(target)
            assert list(tmp_path.iterdir()) == []
        real(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", late)
    target = tmp_path / "out.gpkg"
    draft = draft_of(target) if kind == "folder" else Draft(target, overwrite=False)
    (made,) = tmp_path.iterdir()
    assert made == (draft.folder if isinstance(draft, DraftFolder) else draft.file)
    draft.discard()


def test_a_file_of_the_name_leaves_the_drafts_of_others(tmp_path: Path) -> None:
    draft = draft_of(tmp_path / "out")
    (draft.folder / "ours").write_text("first")
    with replacing(tmp_path / "out") as file:
        file.write_text("a file")
        assert draft.folder.exists()
    draft.discard()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_signal_in_the_first_moment_leaves_nothing(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(descriptor: int, draft: Path) -> None:
        assert len(list(tmp_path.iterdir())) == 1
        raise SystemExit(143)

    monkeypatch.setattr(publish, "hold", interrupted)
    target = tmp_path / "out.gpkg"
    with pytest.raises(SystemExit):
        draft_of(target) if kind == "folder" else Draft(target, overwrite=False)
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_a_draft_that_nobody_published_is_gone_at_the_exit(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from fieldgrid.core import Draft\n"
        "draft = Draft(Path(sys.argv[1]), overwrite=False)\n"
        "child = os.fork()\n"
        "if child == 0: sys.exit(0)\n"
        "os.waitpid(child, 0)\n"
        "print(draft.file.exists())"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "out.gpkg")],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert ended.stdout == "True\n"  # the exit of the child left it
    assert list(tmp_path.iterdir()) == []


def test_a_folder_changes_places_with_the_one_that_it_replaces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither is missing at any moment."""
    if not hasattr(ctypes.CDLL(None), "renameat2"):
        pytest.skip("this system cannot exchange names")
    target = tmp_path / "out"
    target.mkdir()
    (target / "old").touch()

    def refuse(*_: object) -> None:
        raise AssertionError("there was a moment without a folder")

    draft = DraftFolder(target, overwrite=True, ours=lambda _: True, what="ours")
    (draft.folder / "new").touch()
    monkeypatch.setattr(Path, "rename", refuse)
    draft.publish()
    assert [path.name for path in target.iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_a_killed_program_made_on_the_way_is_swept(tmp_path: Path) -> None:
    target = tmp_path / "map.dxf"
    killed = (
        "import os, signal, sys; from pathlib import Path\n"
        "from fieldgrid.core import replacing, working_beside\n"
        "with replacing(Path(sys.argv[1])) as file, working_beside(file) as folder:\n"
        "    (folder / 'half').touch()\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", killed, str(target)], check=False)
    assert len(list(tmp_path.iterdir())) == 2
    with replacing(target) as file:
        file.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == [target.name]


def test_a_system_without_file_locks_says_what_helps() -> None:
    code = "import sys; sys.modules['fcntl'] = None; import fieldgrid.core.publish"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "needs the file locks of Linux; on Windows use WSL 2." in done.stderr
