"""Goodness of the ground for a vehicle, by the worst under it; and layers that look around."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import (
    GROUND_CHANNEL,
    NO_GROUND_CM,
    STEP_CHANNEL,
    Bounds,
    GridSpec,
    LocalGrid,
    Pose,
)
from fieldgrid.maps import (
    Mobility,
    Selection,
    create_map,
    open_map,
    register_layer,
    traversability,
    unregister,
)
from fieldgrid.maps.layers.built_in.traversability import worst_under
from tests.maps.file.maps import DATUM

SPEC = GridSpec(width_m=8.0, length_m=8.0, cell_m=0.1)
_Float = npt.NDArray[np.float64]

EAST_M, NORTH_M = 102.4, 4.0
"""The middle of the frame: where a map of cells of 0.1 m is cut when it is read."""


def write(path: Path, obstacles: npt.NDArray[np.bool_], rise: float = 0.0) -> Path:
    """A map of one frame that looks north over ground that rises to the north."""
    density = np.where(obstacles, 200, 0).astype(np.uint8)
    heights = np.rint(100.0 * rise * SPEC.centres_m()[1])[:, None]
    channels = {
        GROUND_CHANNEL: np.broadcast_to(heights, SPEC.shape).astype(np.int16),
        STEP_CHANNEL: np.zeros(SPEC.shape, np.uint8),
    }
    channels[GROUND_CHANNEL][:, :8] = NO_GROUND_CM
    pose = Pose(10**9, EAST_M, 0.0, 0.0, 0.0, 0.02, 0.3, 1.0)
    with create_map(path, DATUM, cell_m=0.1) as universal, universal.add_session("a") as session:
        session.add(LocalGrid(SPEC, density, np.ones(SPEC.shape, bool)), pose, channels=channels)
    return path


def brute(goodness: _Float, reach: float) -> _Float:
    """The rule, cell by cell."""
    out = np.full(goodness.shape, np.nan)
    rows, columns = np.indices(goodness.shape)
    side = np.arange(-math.floor(reach), math.floor(reach) + 1)
    whole = (np.hypot(side, side[:, None]) <= reach).sum()
    for j, i in np.argwhere(np.isfinite(goodness)):
        disc = goodness[np.hypot(rows - j, columns - i) <= reach]
        known = disc[np.isfinite(disc)]
        if known.min() <= 0.0 or known.size >= 0.5 * whole:
            out[j, i] = known.min()
    return out


@pytest.mark.parametrize("reach", [0.4, 1.0, 2.9, 5.0])
def test_the_worst_under_a_disc(reach: float) -> None:
    random = np.random.default_rng(int(10 * reach))
    goodness = random.random((31, 23))
    goodness[random.random(goodness.shape) < 0.4] = np.nan
    goodness[random.random(goodness.shape) < 0.01] = 0.0
    found = worst_under(goodness, reach)
    np.testing.assert_allclose(found, brute(goodness, reach), rtol=1e-6)
    assert np.isnan(found).any()


def test_a_vehicle_stands_as_well_as_the_worst_under_it(tmp_path: Path) -> None:
    obstacles = np.zeros(SPEC.shape, bool)
    obstacles[40, 40] = True  # just east of where the map is cut
    path = write(tmp_path / "map.gpkg", obstacles, rise=math.tan(math.radians(5.0)))
    with open_map(path) as universal:
        view = universal.read(layers=["traversability"])
        found = view.layer("traversability")
        rows, columns = (
            (first + np.arange(n) + 0.5) * 0.1
            for first, n in zip(view.window[1::-1], view.window.shape, strict=True)
        )
        away = np.hypot(columns - EAST_M - 0.05, (rows - NORTH_M - 0.05)[:, None])
        assert (found[away <= 0.749] == 0.0).all()
        assert (columns[(found == 0.0).any(axis=0)] < EAST_M).sum() == 7
        free = (away > 0.76) & np.isfinite(found)
        assert free.sum() > 2000
        # Whole centimetres of height over 1 m make 5° a little more or less.
        np.testing.assert_allclose(found[free], 1.0 - 5.0 / 20.0, atol=0.03)
        # Where the slope is not known, nor half of what is under it, nothing is said.
        assert np.isnan(found[:, columns < EAST_M - 2.7]).all()
        for bounds in (Bounds(101.0, 3.0, 102.9, 4.3), Bounds(102.5, 4.0, 102.6, 4.1)):
            part = universal.read(bounds, layers=["traversability"])
            inside = view.window.slices_of(part.window)
            np.testing.assert_array_equal(part.layer("traversability"), found[inside])
        anew = universal.read(layers=["traversability"], frame_filter=lambda _: True)
        np.testing.assert_array_equal(anew.layer("traversability"), found)


def test_overviews_look_around_as_larger_cells_do(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    path = write(tmp_path / "map.gpkg", random.random(SPEC.shape) < 0.003)
    bounds = Bounds(96.0, 0.0, 108.8, 9.6)  # whole cells of 3.2 m
    with open_map(path) as universal:
        with Selection(bounds, layer="traversability").blocks(universal, (), 4) as blocks:
            found = list(blocks.views)
        assert [round(one.lattice.cell_m, 6) for one in found] == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2]
        for one in found:
            view = universal.read(bounds, cell_m=one.lattice.cell_m, layers=["traversability"])
            expected = view.layer("traversability")
            assert np.isfinite(expected).any()
            np.testing.assert_array_equal(one.layer("traversability"), expected)


@pytest.fixture
def narrow() -> Iterator[str]:
    register_layer(traversability(Mobility(half_width_m=0.15, slope_deg=8.0), "for_a_robot"))
    yield "for_a_robot"
    unregister("for_a_robot")


def test_another_vehicle_is_another_layer(tmp_path: Path, narrow: str) -> None:
    obstacles = np.zeros(SPEC.shape, bool)
    obstacles[:, 36] = obstacles[:, 46] = True  # a gap of 0.9 m
    path = write(tmp_path / "map.gpkg", obstacles, rise=math.tan(math.radians(4.0)))
    with open_map(path) as universal:
        view = universal.read(layers=["traversability", narrow])
    east_m = (view.window.i0 + np.arange(view.window.width) + 0.5) * 0.1
    between = np.abs(east_m - EAST_M - 0.15) < 0.1
    rows = slice(15, -15)
    assert (view.layer("traversability")[rows, between] == 0.0).all()
    np.testing.assert_allclose(view.layer(narrow)[rows, between], 0.5, atol=0.07)
