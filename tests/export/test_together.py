"""Files that belong together get their names so that nobody opens one with those of another."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid import publish
from fieldgrid.export.together import write_together


def text(words: str) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        file.write_text(words)

    return write


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


def test_with_other_files_beside_it_the_main_one_goes_first(
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


def test_the_folder_is_synced_once_for_all_files_before_the_main_one_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is waited for, but that, while the main file is missing."""
    files = [tmp_path / name for name in ("a.one", "a.two", "a.main")]
    missing: list[str] = []
    original = publish._sync

    def watched(path: Path) -> None:
        if files[-1].with_suffix(".old").exists() and not files[-1].exists():
            missing.append(path.name)
        original(path)

    for words in ("old", "new"):
        monkeypatch.setattr(publish, "_sync", watched)
        write_together(
            {file: text(words) for file in files}, overwrite=True, ours=lambda _: True, what="it"
        )
        files[-1].with_suffix(".old").touch()
    assert missing == [tmp_path.name]
