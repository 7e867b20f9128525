from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.errors import ConfigError
from fieldgrid.lattice import Lattice
from fieldgrid.mapfile import MapFile, heights, open_map
from fieldgrid.transfer import Averaging, MeanFold, Transfer
from tests.mapfile.maps import CELL_M, Frame, drive, write_map


def hilly(frames: list[Frame]) -> list[Frame]:
    """The frames on a slope, by whole millimetres; one has no height."""
    placed = [
        (grid, replace(pose, up_m=round(-1.2 + 0.337 * k, 3)))
        for k, (grid, pose) in enumerate(frames)
    ]
    placed[2] = placed[2][0], replace(placed[2][1], up_m=math.nan)
    return placed


@pytest.fixture(params=list(Transfer))
def universal(tmp_path: Path, request: pytest.FixtureRequest) -> MapFile:
    frames = [hilly(drive(6)), hilly(drive(4, heading_deg=120.0))]
    return open_map(write_map(tmp_path / "m.gpkg", frames, transfer=request.param))


@pytest.mark.parametrize("cell_m", [CELL_M, 0.2, 0.33])
def test_it_is_the_mean_over_the_frames_that_saw_the_cell(
    universal: MapFile, cell_m: float
) -> None:
    view = universal.read(cell_m=cell_m, layers=["count", "height"])
    total, count = np.zeros(view.window.shape), np.zeros(view.window.shape)
    for frame in universal.frames(with_grid=True):
        fold = MeanFold(Lattice(cell_m), view.window, universal.transfer)
        fold.add(frame.grid(), frame.pose)
        seen = fold.sums[..., 0] > 0
        if math.isfinite(frame.pose.up_m):
            total[seen] += frame.pose.up_m
            count[seen] += 1
    with np.errstate(invalid="ignore"):
        expected = total / count
    height = view.layer("height")
    assert height.dtype == np.float32
    np.testing.assert_allclose(height, expected, atol=1e-6)
    # Cells that only the frame without a height saw have none.
    assert np.isnan(height[~view.observed]).all()
    assert 0 < np.isnan(height[view.observed]).mean() < 0.3
    np.testing.assert_array_equal(view.layer("count") >= count, True)


def test_it_leaves_the_other_layers_as_they_are(universal: MapFile) -> None:
    with_height = universal.read(layers=["variance", "height"], at="0")
    without = universal.read(layers=["variance"], at="0")
    np.testing.assert_array_equal(with_height.density, without.density)
    np.testing.assert_array_equal(with_height.layer("variance"), without.layer("variance"))
    assert set(with_height.layers) == {"variance", "height"}


def test_it_depends_neither_on_the_order_nor_on_the_blocks(
    universal: MapFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = universal.read()
    frames = [frame for frame in universal.frames(with_grid=True) if frame.accepted]
    one = heights.with_heights(view, frames, universal.transfer).layer("height")
    monkeypatch.setattr(heights, "BLOCK_CELLS", 37)
    two = heights.with_heights(view, frames[::-1], universal.transfer).layer("height")
    assert one.tobytes() == two.tobytes()


def test_the_papers_averaging_has_none(universal: MapFile) -> None:
    if universal.transfer is Transfer.CENTRE:
        with pytest.raises(ConfigError, match="gives a density only"):
            universal.read(layers=["height"], averaging=Averaging.PAPER)
