"""The paths through the code that the architecture describes are those that the values take."""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

import fieldgrid
from fieldgrid.cli import app
from tests.conftest import make_small_drive

PAGE = Path(__file__).parents[1] / "docs" / "architecture.md"

SOURCE = os.path.join(os.path.dirname(fieldgrid.__file__), "")

STEPS = {"build": 18, "track": 20, "export": 8}
"""So many functions the page names for each command."""

FILES = {"build": 17, "track": 20, "export": 8}
"""So many files these are in, as the page says."""


def described(command: str) -> list[str]:
    """The functions that the page names for a command, in its order."""
    text = PAGE.read_text(encoding="utf-8")
    table = text.split(f"(`fieldgrid {command}`):\n\n", 1)[1].split("\n\n", 1)[0]
    return re.findall(r"^\| `([\w.]+)` \|", table, re.MULTILINE)


@contextmanager
def first_calls() -> Iterator[list[str]]:
    """Functions of fieldgrid, on any thread, in the order in which each is called first."""
    called: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        # Compiled kernels report a frame with their code, but without the module's globals.
        if event == "call" and frame.f_code.co_filename.startswith(SOURCE):
            module = frame.f_code.co_filename[len(SOURCE) : -len(".py")].replace(os.sep, ".")
            called[f"{module}.{frame.f_code.co_qualname}"] = None

    order: list[str] = []
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield order
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        order.extend(called)


@pytest.fixture(scope="module")
def called(two_lanes_map: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """What each of the three commands calls.

    A map was built before: a compiler whose every call is noted takes twice as long.
    """
    folder = tmp_path_factory.mktemp("paths")
    drive = make_small_drive(folder / "drive", range(3, 5))
    commands: dict[str, list[object]] = {
        "build": [drive, "-o", folder / "map.gpkg", "--gnss", "gnss_rtk.nmea", "--jobs", "1"],
        "track": [drive / "gnss" / "gnss_rtk.nmea", "-o", folder / "poses.csv"],
        "export": [two_lanes_map, folder / "map.tif"],
    }
    found: dict[str, list[str]] = {}
    for command, arguments in commands.items():
        words = [command, *(str(one) for one in arguments)]
        with first_calls() as found[command]:
            app(words, standalone_mode=False)
    return found


@pytest.mark.parametrize("command", STEPS)
def test_values_take_the_path_of_the_page(command: str, called: dict[str, list[str]]) -> None:
    page = described(command)
    assert [one for one in called[command] if one in page] == page
    assert len(page) == STEPS[command]


def test_the_page_says_how_many_files_that_are() -> None:
    files = {
        command: len({re.sub(r"(\.[A-Z_]\w*)?\.\w+$", "", one) for one in described(command)})
        for command in STEPS
    }
    assert files == FILES
    said = "The functions are in {build}, {track} and {export} files.".format(**FILES)
    assert said in PAGE.read_text(encoding="utf-8")
