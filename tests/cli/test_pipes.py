"""A pipe or a device where a file belongs is refused at once: it may never end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Run

MakeDrive = Callable[..., Path]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("sessions PIPE", "is a folder, a pipe or a device"),
        ("verify PIPE", "is a folder, a pipe or a device"),
        ("merge MAP PIPE -o out.gpkg", "is a folder, a pipe or a device"),
        ("track PIPE -o out.csv", "is neither a file nor a folder"),
        ("build DRIVE --config PIPE -o out.gpkg", "it is a pipe or a device"),
        ("mark MAP --add PIPE --kind keepout", "it is a pipe or a device"),
        ("rows MAP --truth PIPE", "it is a pipe or a device"),
        ("evaluate MAP PIPE.csv", "it is a pipe or a device"),
        ("show MAP -o out.png --route PIPE", "it is a pipe or a device"),
        ("show MAP -o out.png --route PIPE.csv", "it is a pipe or a device"),
        ("export MAP out.yaml --slow-percent 40 --slow-turns PIPE", "it is a pipe or a device"),
        ("route MAP --cover --tracks --boundary PIPE -o out.csv", "it is a pipe or a device"),
        ("route MAP --cover --tracks --along PIPE -o out.csv", "it is a pipe or a device"),
        ("route MAP --cover --vehicle PIPE -o out.csv", "There is no vehicle file"),
    ],
)
def test_no_command_reads_a_device(
    arguments: str,
    message: str,
    fieldgrid: Run,
    make_drive: MakeDrive,
    two_lanes_map: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that ends at once, so that a command that reads it does not hang."""
    monkeypatch.chdir(tmp_path)
    for name in ("PIPE", "PIPE.csv"):
        Path(name).symlink_to("/dev/null")
    drive = make_drive("june")
    given = {"MAP": two_lanes_map, "DRIVE": drive}
    assert message in fieldgrid(*(given.get(word, word) for word in arguments.split())).sentence()
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("name", ["loop.gpkg", "loop.csv", "loop.yaml"])
def test_a_link_to_itself_is_replaced_when_that_is_asked(
    name: str, fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / name
    out.symlink_to(name)
    assert "exists already" in fieldgrid("export", two_lanes_map, out).sentence()
    result = fieldgrid("export", two_lanes_map, out, "--overwrite")
    assert result.status == 0, result.err
    assert out.is_file()
    assert not out.is_symlink()
