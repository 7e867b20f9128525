"""`fieldgrid convert` at the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Run

MakeDrive = Callable[..., Path]


def test_a_drive_becomes_an_mcap(fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive("june"), tmp_path / "june.mcap"
    text = fieldgrid("convert", drive, out).output()
    assert text.startswith("convert june")
    assert text.endswith(f"mcap {out}\n")
    rows = dict(line.split() for line in text.splitlines()[2:-1])
    assert rows["/stereo/left/image_rect/compressed"] == "3"
    assert rows["/tf_static"] == "1"
    fixes = (drive / "gnss" / "gnss_rtk.nmea").read_text().count("GPGGA")
    assert int(rows["/gnss/fix"]) == fixes > 150

    assert "exists already" in fieldgrid("convert", drive, out).sentence()
    document = json.loads(
        fieldgrid("convert", drive, out, "--overwrite", "--images", "none", "--json").output()
    )
    assert document["mcap"] == str(out)
    assert document["topics"]["/gnss/fix"] == int(rows["/gnss/fix"])
    assert not any(topic.startswith("/stereo") for topic in document["topics"])
    assert document["start_ns"] < document["stop_ns"]


@pytest.mark.parametrize("bad", [("out.bag",), ("out.mcap", "--images", "jpeg")])
def test_what_is_used_wrongly(fieldgrid: Run, make_drive: MakeDrive, bad: tuple[str, ...]) -> None:
    drive = make_drive()
    assert fieldgrid("convert", drive, *bad).usage()
    assert not list(drive.parent.glob("out*"))


def test_a_failure_leaves_nothing(fieldgrid: Run, make_drive: MakeDrive, tmp_path: Path) -> None:
    drive = make_drive("june")
    image = sorted((drive / "left").iterdir())[-1]
    image.unlink()
    image.write_bytes(b"\xff\xd8\xff broken")
    folder = tmp_path / "out"
    folder.mkdir()
    assert image.name in fieldgrid("convert", drive, folder / "june.mcap").sentence()
    assert list(folder.iterdir()) == []
