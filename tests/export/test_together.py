"""Files that belong together get their names so that nobody opens one with those of another."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

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
