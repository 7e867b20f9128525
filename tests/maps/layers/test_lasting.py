"""What stood in all drives, in some, in one: against the sessions read one by one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.maps import Costmap, MapFile, open_map
from tests.maps.file.maps import drive, one_cell, write_map
from tests.maps.file.test_cells import later

CLASSES = "static", "seasonal", "passing"
SEEN_M = 2.05, 3.05
"""The middle of the only cell of the small maps."""


def small(path: Path, densities: tuple[int, ...]) -> Path:
    """A map of drives over one cell, a day each, with what each found there."""
    days = [later([one_cell(*SEEN_M, density)], day) for day, density in enumerate(densities)]
    return write_map(path, days)


@pytest.mark.parametrize(
    ("densities", "one_of", "lasts"),
    [
        ((250,), "", 250),
        ((20, 30), "", 25),
        ((250, 200), "static", 225),
        ((250, 20), "passing", 0),
        ((20, 20, 250), "passing", 0),
        ((250, 20, 250), "seasonal", 173),
        ((120, 0, 120), "seasonal", 101),
        ((250, 0, 250, 0), "seasonal", 0),
        ((101, 101, 101, 101), "static", 101),
    ],
)
def test_a_cell(tmp_path: Path, densities: tuple[int, ...], one_of: str, lasts: int) -> None:
    with open_map(small(tmp_path / "map.gpkg", densities)) as universal:
        view = universal.read(layers=(*CLASSES, "lasting"))
        assert view.observed.sum() == 1
        found = [name for name in CLASSES if view.layer(name)[view.observed][0]]
        assert found == [one_of] * bool(one_of)
        assert view.layer("lasting")[view.observed][0] == lasts
        for name in (*CLASSES, "lasting"):
            assert not view.layer(name)[~view.observed].any()
            # Of any larger cell it is the same, as it is the only one that was seen.
            for cell_m in (0.2, 0.3, 0.8, 0.15):
                larger = universal.read(cell_m=cell_m, layers=[name]).layer(name)
                assert larger.max() == view.layer(name).max()


def expected(universal: MapFile, names: list[str]) -> dict[str, npt.NDArray[np.uint8]]:
    """The classes of the map's own cells, from views of the sessions one by one."""
    bounds = universal.bounds
    views = [universal.read(bounds, sessions=[name]) for name in names]
    seen = np.sum([view.observed for view in views], axis=0)
    stood = np.sum([view.density > 100 for view in views], axis=0)
    classes = {
        "static": (seen >= 2) & (stood == seen),
        "seasonal": (stood >= 2) & (stood < seen),
        "passing": (seen >= 2) & (stood == 1),
    }
    return {name: where.astype(np.uint8) for name, where in classes.items()}


def test_many_cells_of_every_size_and_of_a_season(tmp_path: Path) -> None:
    days = [later(drive(4, step_m=0.71 + 0.1 * k), k) for k in range(4)]
    path = write_map(tmp_path / "map.gpkg", days)
    with open_map(path) as universal:
        names = [info.name for info in universal.sessions()]
        for at, drives in ((None, names), (names[2], names[:3])):
            wanted = expected(universal, drives)
            assert all(where.any() for where in wanted.values())
            window = universal.read(at=at).window
            for factor in (1, 2, 3, 8):
                view = universal.read(cell_m=0.1 * factor, layers=CLASSES, at=at)
                for name in CLASSES:
                    large = np.zeros((view.window.height, view.window.width, 2), dtype=np.uint8)
                    rows, columns = np.indices(window.shape)
                    j = (rows + window.j0) // factor - view.window.j0
                    i = (columns + window.i0) // factor - view.window.i0
                    np.maximum.at(large[..., 0], (j, i), wanted[name])
                    np.testing.assert_array_equal(view.layer(name), large[..., 0])


def test_it_follows_from_the_core(tmp_path: Path) -> None:
    days = [later(drive(6, step_m=30.137 + 0.1 * k), k) for k in range(3)]
    path = write_map(tmp_path / "map.gpkg", days)
    with open_map(path, writable=True) as universal:
        assert universal.verify(deep=True).sound
        universal.repair()
        assert universal.verify(deep=True).sound
    names = (*CLASSES, "lasting")
    with open_map(path) as universal:
        for cell_m in (0.1, 0.2, 0.4, 1.2):
            stored = universal.read(cell_m=cell_m, layers=names)
            anew = universal.read(cell_m=cell_m, layers=names, frame_filter=lambda _: True)
            for name in names:
                assert stored.layer(name).any()
                np.testing.assert_array_equal(stored.layer(name), anew.layer(name))


def test_planners_get_what_lasts(tmp_path: Path) -> None:
    path = small(tmp_path / "map.gpkg", (250, 20, 20))
    with open_map(path) as universal:
        for cell_m in (None, 0.2):
            assert Costmap.from_map(universal, cell_m=cell_m, at="0").cost(*SEEN_M) == 254
            lasting = Costmap.from_map(universal, cell_m=cell_m, layer="lasting", curve=None)
            assert lasting.cost(*SEEN_M) in (0, 255)  # a larger cell was seen too little
        assert Costmap.from_map(universal, layer="lasting").cost(*SEEN_M) == 0
        with pytest.raises(ConfigError, match="'count' holds no density"):
            Costmap.from_map(universal, layer="count")
        out = tmp_path / "lasting.yaml"
        export_map(universal, out, Selection(layer="lasting"))
        assert json.loads((tmp_path / "lasting.georef.json").read_text())["layer"] == "lasting"
        export_map(universal, tmp_path / "passing.tif", Selection(layer="passing"))
