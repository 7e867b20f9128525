"""The layer `height`: where the vehicle stood when it saw a cell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.maps import create_map, open_map
from tests.maps.file.maps import DATUM, one_cell

NAN = float("nan")


def test_it_is_the_mean_over_the_sessions_of_their_frames(tmp_path: Path) -> None:
    """To the centimetre, of those that observed a block of 20 cm; frames whose pose has no height
    do not count."""
    seen = {
        "a": [(2.05, 1.2346), (2.15, -0.5), (2.05, NAN), (2.25, 3.0), (2.65, NAN)],
        "b": [(2.05, 2.0), (2.25, -7.0)],
    }
    path = tmp_path / "map.gpkg"
    with create_map(path, DATUM, cell_m=0.1) as universal:
        for name, frames in seen.items():
            with universal.add_session(name) as session:
                for east_m, up_m in frames:
                    grid, pose = one_cell(east_m, 3.05, 9)
                    session.add(grid, replace(pose, up_m=up_m))

    def heights(cell_m: float, sessions: list[str] | None = None) -> list[float]:
        view = universal.read(cell_m=cell_m, layers=["height"], sessions=sessions)
        assert np.isnan(view.layer("height")[~view.observed]).all()
        return [float(value) for value in view.layer("height")[view.observed]]

    with open_map(path, writable=True) as universal:
        means = [(0.37 + 2.0) / 2, (0.37 + 2.0) / 2, -2.0]
        assert heights(0.1) == pytest.approx([*means, NAN], abs=1e-6, nan_ok=True)
        # A larger cell: over all sessions of the blocks in it.
        assert heights(0.4) == pytest.approx([(0.37 + 2.0 + 3.0 - 7.0) / 4, NAN], nan_ok=True)
        assert heights(0.1, ["b"]) == pytest.approx([2.0, -7.0], abs=1e-6)
        universal.remove_session("a")
        assert heights(0.1) == pytest.approx([2.0, -7.0], abs=1e-6)
