"""Folders that appear whole or not at all; of files, see the tests of the map."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.errors import MapExistsError
from fieldgrid.publish import DraftFolder, replacing


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


def test_a_file_of_the_name_leaves_the_drafts_of_others(tmp_path: Path) -> None:
    draft = draft_of(tmp_path / "out")
    (draft.folder / "ours").write_text("first")
    with replacing(tmp_path / "out") as file:
        file.write_text("a file")
        assert draft.folder.exists()
    draft.discard()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]
