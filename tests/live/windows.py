"""A window as a session tells it, and the readers of it that the documentation has."""

from __future__ import annotations

from typing import Any

import numpy as np

from fieldgrid.geometry import Datum, FixColumns, Lattice, Pose, Status, Window
from fieldgrid.live import LiveWindow, WindowDoubt
from fieldgrid.maps import Costmap, MapView
from tests.conftest import ROOT
from tools.check_docs import parse_blocks

HEIGHT, WIDTH = 3, 5


def window(frames: int = 7, *, size: tuple[int, int] = (HEIGHT, WIDTH)) -> LiveWindow:
    height, width = size
    random = np.random.default_rng(frames)
    density = random.integers(0, 256, size, dtype=np.uint8)
    observed = random.random(size) > 0.3
    place = Window(-40, 60, width, height)
    view = MapView(
        Lattice(0.05), place, density, observed, Datum(41.65, -4.72, 787.4), is_base=True
    )
    age_s = np.where(observed, random.uniform(0.0, 900.0, size), np.nan).astype(np.float32)
    sigma_m = np.where(observed, random.uniform(0.0, 0.4, size), np.nan).astype(np.float32)
    pose = Pose(5, -1.5, 3.25, 0.0, 271.5, 0.02, 0.4, 1.25, Status.OK, "")
    return LiveWindow(
        *(1_308_133_815_469_000_000, Costmap.from_view(view), view, age_s, sigma_m, pose),
        *("no frame for 4.0 s", frames, "000007", 0.1, WindowDoubt.NO_FRAMES, 1),
        *(FixColumns.of([]), np.zeros(0, dtype=np.bool_)),
    )


def documented_readers() -> dict[str, Any]:
    """The functions of docs/live.md that read feeds, as they stand there."""
    text = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for block in parse_blocks(text):
        code = "\n".join(block.lines)
        if block.language == "python" and "def read_window" in code:
            exec(compile(code, "docs/live.md", "exec"), names)
    return names
