"""Builds of small drives, and what is done to them first."""

from __future__ import annotations

import json
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import pytest

from fieldgrid.core import BuildSettings, resolve
from fieldgrid.pipeline import SessionReport, build_map, read_journal, work_folder
from fieldgrid.pipeline.staging import parts
from fieldgrid.pipeline.staging.shares import DriveWork
from fieldgrid.recordings import Frame, StereoFrame
from tests.maps.file.content import unpacked

MakeDrive = Callable[..., Path]
SharedData = Callable[[str], Path]

DEFAULTS = BuildSettings()
COURSE = resolve(None, {"pose": {"heading": "course"}})
SMALL_SHARES = (
    "import fieldgrid.pipeline.drives as d, fieldgrid.pipeline.staging.parts as p\n"
    "d.WORTH_FRAMES, p.SHARE_FRAMES = 1, 2"
)
"""Python to run first in a process of its own: a small drive then has shares, for processes."""
WITHOUT_CAMERA = resolve(None, {"pose": {"visual_odometry": False}})


def build(paths: list[Path], out: Path, **options: Any) -> list[SessionReport]:
    return build_map(paths, out, options.pop("settings", DEFAULTS), **options)


def frames_left(out: Path) -> int:
    """How many frames an ended build of a map has staged, or found to be bad."""
    left = (read_journal(path) for path in work_folder(out).glob("*.build"))
    return sum(record.kind in ("frame", "bad") for records in left for record in records)


def content(path: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Every row of every table of a map, but for the times at which they were written, and what
    covers those: the root digest, and the sums of the rows."""
    written = {"created", "last_change", "description", "update_time"}
    connection = sqlite3.connect(path)
    try:
        names = connection.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name <> 'fieldgrid_sum'"
        )
        rows = {}
        for (name,) in names.fetchall():
            info = connection.execute(f"PRAGMA table_info('{name}')").fetchall()
            columns = ", ".join(f'"{column[1]}"' for column in info if column[1] not in written)
            selected = connection.execute(f'SELECT {columns} FROM "{name}"')
            # ISA-L does not make the same bytes of the same cells each time.
            rows[name] = [tuple(map(unpacked, row)) for row in selected]
        rows["fieldgrid_meta"] = [r for r in rows["fieldgrid_meta"] if r[0] != "root_sha256"]
        return rows
    finally:
        connection.close()


def count_staged(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many frames each run of shares has that this process stages from now on."""
    runs: list[int] = []
    original = parts.stage_frames

    def counted(work: DriveWork, first: int, last: int, jobs: int) -> Any:
        runs.append(last - first)
        return original(work, first, last, jobs)

    monkeypatch.setattr(parts, "stage_frames", counted)
    return runs


def damage(image: Path) -> None:
    """Cut an image of a small drive off in the middle."""
    data = image.read_bytes()
    image.unlink()
    image.write_bytes(data[: len(data) // 2])


def pipeline_threads() -> list[str]:
    return [t.name for t in threading.enumerate() if t.name.startswith("fieldgrid")]


def no_image_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Frame) -> NoReturn:
        raise AssertionError(f"the images of frame {self.frame_id} were read")

    monkeypatch.setattr(StereoFrame, "images", refuse)


def edit_mounting(drive: Path, change: dict[str, float]) -> None:
    path = drive / "calibration" / "mounting.json"
    mounting = json.loads(path.read_text())
    assert change.keys() <= mounting.keys()
    path.write_text(json.dumps({**mounting, **change}))


def fog(drive: Path, *frames: str) -> None:
    """Pairs of a small drive in which there is nothing to see."""
    for frame_id in frames:
        for side in ("left", "right"):
            path = drive / side / f"{frame_id}.jpg"
            path.unlink()
            cv2.imwrite(str(path), np.full((480, 640), 128, dtype=np.uint8))
