"""Views of terrain that are folded anew: what a window has does not depend on what else is read."""

from __future__ import annotations

import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import MapError
from fieldgrid.geometry import GROUND_CHANNEL, Bounds, LocalGrid, Window
from fieldgrid.maps import LAYERS, Transfer, create_map, open_map
from tests.maps.file.maps import DATUM
from tests.maps.file.terrain import (
    SPEC,
    assert_parts_are_those_of_the_whole,
    frame,
    write_drives,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("terrain") / "map.gpkg"
    return write_drives(out, {"june": 0.0, "july": 37.0, "may": 100.0})


@pytest.mark.parametrize(
    ("cell_m", "how"),
    [
        (None, {}),
        (None, {"sessions": ["may", "june"]}),
        (None, {"frame_filter": lambda one: one.pose.time_ns > 0}),
        (None, {"transfer": Transfer.AREA}),
        (0.07, {}),
        (0.15, {"frame_filter": lambda one: one.pose.time_ns > 0}),
    ],
)
def test_parts_are_those_of_the_whole(
    path: Path, cell_m: float | None, how: dict[str, Any]
) -> None:
    with open_map(path) as universal:
        assert_parts_are_those_of_the_whole(universal, cell_m, **how)


@pytest.mark.parametrize("part", ["tip", "side"])
def test_a_frame_that_saw_the_rest_of_a_block_counts_in_each_of_its_cells(
    tmp_path: Path, part: str
) -> None:
    """Of a frame only the tip of a far corner lies in the block of 4 x 4 cells, or its left side,
    and in cells that are not read; another frame saw all of the block."""
    grid, pose = frame(0, 0.0)
    seen = LocalGrid(grid.spec, grid.density, np.ones(SPEC.shape, np.bool_))
    level = {GROUND_CHANNEL: np.zeros(SPEC.shape, np.int16)}
    whole = replace(pose, time_ns=1, east_m=0.1, north_m=-1.0, up_m=2.0, heading_deg=0.0)
    if part == "tip":  # due east of the vehicle, and just east of the middle of the block
        turned = 90.0 - math.degrees(math.atan2(SPEC.width_m / 2.0, SPEC.length_m))
        east_m, north_m, read = 0.12 - SPEC.reach_m, 0.1, Window(3, 3, 1, 1)
    else:
        turned, east_m, north_m, read = 0.0, 0.16 + SPEC.width_m / 2.0, -1.0, Window(0, 3, 1, 1)
    other = replace(pose, east_m=east_m, north_m=north_m, up_m=1.0, heading_deg=turned)
    with create_map(tmp_path / "map.gpkg", DATUM, cell_m=SPEC.cell_m) as universal:
        with universal.add_session("june") as session:
            for place in (other, whole):
                session.add(seen, place, frame_id=str(place.time_ns), channels=level)
        cell = universal.read().lattice.bounds(read)
        stored = universal.read(cell, layers=["height"])
        folded = universal.read(cell, layers=["height"], frame_filter=lambda _: True)
        alone = universal.read(
            cell, layers=["height"], frame_filter=lambda one: one.pose.time_ns > 0
        )
    assert folded.layer("height") == stored.layer("height") != alone.layer("height")


def test_layers_that_are_folded_read_no_more_of_frames_than_they_need(tmp_path: Path) -> None:
    path = write_drives(tmp_path / "map.gpkg", {"a": 0.0, "b": 90.0})
    layers = ["count", "variance", "max"]
    with open_map(path) as universal:
        before = universal.read(layers=layers)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE fieldgrid_grid SET data = x'00' WHERE channel = 'step_cm'")
    with open_map(path) as universal:
        after = universal.read(layers=layers)
        for name in ("density", *layers):
            np.testing.assert_array_equal(after.layer(name), before.layer(name))
        with pytest.raises(MapError, match="step_cm"):
            universal.read(layers=["step"])


@pytest.mark.parametrize("at", [None, "b"])
def test_layers_that_are_folded_beside_kept_ones_are_as_if_all_were_kept(
    at: str | None, tmp_path: Path
) -> None:
    path = write_drives(tmp_path / "map.gpkg", {"a": 0.0, "b": 90.0, "c": 17.0})
    part = Bounds(-1.03, -0.49, 1.51, 1.27)  # where four tiles meet
    with open_map(path) as universal:
        folded = universal.read(part, layers=list(LAYERS), at=at)
    with open_map(path, writable=True) as universal:
        universal.repair(layers=["all"])
        kept = universal.read(part, layers=list(LAYERS), at=at)
    for name in ("observed", *LAYERS):
        np.testing.assert_array_equal(folded.layer(name), kept.layer(name), err_msg=name)
