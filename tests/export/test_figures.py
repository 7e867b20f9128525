"""The pictures: what is where, how dark, and which way up."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import matplotlib.colors
import numpy as np
import numpy.typing as npt
import pytest
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import PathPatch
from matplotlib.quiver import Quiver
from matplotlib.text import Text
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from fieldgrid.core import ConfigError, MapError, palette
from fieldgrid.export import figures
from fieldgrid.export.figures import relief
from fieldgrid.export.figures.page import add_scale_bar
from fieldgrid.export.figures.relief import contour_levels, hillshade
from fieldgrid.geometry import (
    Bounds,
    Datum,
    Feature,
    GridSpec,
    Lattice,
    LocalGrid,
    Pose,
    Status,
    Trajectory,
    Window,
)
from fieldgrid.maps import LAYERS, FrameRecord, MapView, Mark, MarkKind, open_map

DATUM = Datum(41.65, -4.72, 787.4)
START_NS = 1_308_133_815_000_000_000
UNSEEN_RGB = tuple(round(255 * v) for v in matplotlib.colors.to_rgb(figures.UNSEEN))

# 16 x 8 cells of 0.5 m: 4..12 m east, -1..3 m north. All free, but for an obstacle in the
# north-east, half an obstacle in the south-west, and the column in the west unseen.
WINDOW = Window(8, -2, 16, 8)
OBSTACLE, HALF = (6, 13), (1, 2)  # row, column


def view(**changes: Any) -> MapView:
    density = np.zeros(WINDOW.shape, dtype=np.uint8)
    observed = np.ones(WINDOW.shape, dtype=np.bool_)
    density[OBSTACLE], density[HALF] = 255, 128
    observed[:, 0] = False
    whole = MapView(Lattice(0.5), WINDOW, density, observed, DATUM)
    return dataclasses.replace(whole, **changes)


def pose(
    k: int, east_m: float = 6.0, north_m: float = 1.0, heading_deg: float = 0.0, reason: str = ""
) -> Pose:
    status = Status.REJECTED if reason else Status.OK
    time_ns = START_NS + k * 1_000_000_000
    return Pose(time_ns, east_m, north_m, 0.0, heading_deg, 0.02, 1.0, 1.5, status, reason)


def drive(
    name: str = "june",
    frames: Iterable[FrameRecord] = (),
    trajectory: Trajectory | None = None,
    colour: str = "#0072b2",
) -> figures.DrawnDrive:
    return figures.DrawnDrive(name, tuple(frames), trajectory, colour)


def record(at: Pose) -> FrameRecord:
    def no_grid() -> LocalGrid:
        raise AssertionError("a figure needs no local grid")

    return FrameRecord("june", f"{at.time_ns}", at, (), GridSpec(), no_grid)


def track(
    heading_deg: list[float], *, rejected: tuple[int, ...] = (), start_ns: int = START_NS
) -> Trajectory:
    n = len(heading_deg)
    status = tuple(Status.REJECTED if k in rejected else Status.OK for k in range(n))
    return Trajectory(
        datum=DATUM,
        time_ns=start_ns + np.arange(n, dtype=np.int64) * 1_000_000_000,
        east_m=np.arange(n, dtype=np.float64) * 2.0,
        north_m=np.arange(n, dtype=np.float64) * 3.0,
        up_m=np.zeros(n),
        heading_deg=np.array(heading_deg, dtype=np.float64),
        position_sigma_m=np.full(n, 0.02),
        heading_sigma_deg=np.full(n, 2.0),
        speed_mps=np.full(n, 1.5),
        gear=np.ones(n, dtype=np.int64),
        quality=np.full(n, 4, dtype=np.int64),
        status=status,
        reason=tuple("a jump" if s is Status.REJECTED else "" for s in status),
        heading_source="course",
    )


def pixels(figure: Figure, path: Path) -> npt.NDArray[np.uint8]:
    """The saved picture read back, RGB [row, column], row 0 at the top."""
    figure.savefig(path)
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert image is not None
    return image[:, :, ::-1]


def place_of(axes: Axes, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a saved picture inside the frame of the axes."""
    box = axes.get_window_extent()
    height = shape[0]
    return (
        slice(round(height - box.y1) + 2, round(height - box.y0) - 2),
        slice(round(box.x0) + 2, round(box.x1) - 2),
    )


def image_of(figure: Figure) -> AxesImage:
    image, *_ = figure.axes[0].get_images()
    return image


def lines_with_marker(axes: Axes, marker: str) -> list[tuple[list[float], list[float]]]:
    return [
        (list(line.get_xdata()), list(line.get_ydata()))
        for line in axes.get_lines()
        if line.get_marker() == marker
    ]


# --- the universal grid


def test_the_saved_picture_is_the_right_way_up(tmp_path: Path) -> None:
    figure = figures.universal_grid(view())
    picture = pixels(figure, tmp_path / "m.png")
    inside = picture[place_of(figure.axes[0], picture.shape)].astype(int)
    height, width = inside.shape[:2]
    dark = np.argwhere(inside[: height // 2].max(axis=2) < 90)  # the scale bar is further down
    # The obstacle is one cell, in row 6 of 8 from the south and column 13 of 16 from the west.
    assert len(dark) == pytest.approx(height * width / (8 * 16), rel=0.1)
    row, column = dark.mean(axis=0)
    assert row / height == pytest.approx((8 - 6.5) / 8, abs=0.02)
    assert column / width == pytest.approx(13.5 / 16, abs=0.02)
    red = np.argwhere((inside[:, :, 0] > 150) & (inside[:, :, 1] < 90))  # of 128: just an obstacle
    row, column = red.mean(axis=0)
    assert row / height == pytest.approx((8 - 1.5) / 8, abs=0.02)
    assert column / width == pytest.approx(2.5 / 16, abs=0.02)


def test_unseen_is_tinted_and_free_is_pale(tmp_path: Path) -> None:
    figure = figures.universal_grid(view())
    picture = pixels(figure, tmp_path / "m.png")
    inside = picture[place_of(figure.axes[0], picture.shape)]
    width = inside.shape[1]
    west, free = inside[:, : int(0.9 * width / 16)], inside[5:20, int(0.3 * width) :]
    assert {tuple(int(v) for v in p) for p in west.reshape(-1, 3)} == {UNSEEN_RGB}
    assert {tuple(int(v) for v in p) for p in free.reshape(-1, 3)} == {
        palette.rgb(palette.DENSITY[0].colour)
    }
    assert max(UNSEEN_RGB) - min(UNSEEN_RGB) > 15  # a tint, no grey: no density looks like it


def test_marks_are_drawn_with_their_names_and_a_legend() -> None:
    corners = ((5.0, 0.0), (7.0, 0.0), (7.0, 2.0))
    marks = (
        Mark(MarkKind.KEEPOUT, corners, "pond"),
        Mark(MarkKind.PLACE, ((10.0, 1.0),), "gate"),
        Mark(MarkKind.FREE, ((40.0, 1.0), (45.0, 1.0), (45.0, 9.0)), "of another field"),
    )
    axes = figures.universal_grid(dataclasses.replace(view(), marks=marks)).axes[0]
    (outline,) = (patch for patch in axes.patches if isinstance(patch, PathPatch))
    assert outline.get_path().vertices[:3].tolist() == [list(corner) for corner in corners]
    assert outline.get_edgecolor()[:3] == matplotlib.colors.to_rgb(palette.MARKS["keepout"])
    assert {text.get_text() for text in axes.texts} >= {"pond", "gate"}
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["keep out", "place"]
    assert axes.get_xlim() == pytest.approx((4.0, 12.0))


def test_a_hole_of_a_mark_is_not_hatched() -> None:
    square = ((5.0, 0.0), (8.0, 0.0), (8.0, 3.0), (5.0, 3.0))
    hole = ((6.0, 1.0), (7.0, 1.0), (7.0, 2.0), (6.0, 2.0))
    for ring in (hole, hole[::-1]):
        marks = (Mark(MarkKind.KEEPOUT, square, holes=(ring,)),)
        axes = figures.universal_grid(dataclasses.replace(view(), marks=marks)).axes[0]
        (outline,) = (patch for patch in axes.patches if isinstance(patch, PathPatch))
        rings = [shapely.LinearRing(ring) for ring in outline.get_path().to_polygons()]
        # Where they run alike, what both enclose is hatched, too.
        assert [ring.is_ccw for ring in rings] == [True, False]


def test_the_image_lies_at_its_bounds() -> None:
    image = image_of(figures.universal_grid(view()))
    assert image.get_extent() == pytest.approx([4.0, 12.0, -1.0, 3.0])
    assert image.origin == "lower"
    assert image.axes.get_aspect() == 1.0
    assert image.get_interpolation() == "none"
    shown = image.get_array()
    assert shown.shape == WINDOW.shape
    assert shown[OBSTACLE] == 255
    assert np.ma.getmaskarray(shown)[:, 0].all()
    assert not np.ma.getmaskarray(shown)[:, 1:].any()


def test_metres_of_the_axes_are_metres_of_the_map() -> None:
    """A cell drawn at a position is the cell of the lattice that encloses it."""
    figure = figures.universal_grid(view())
    figure.canvas.draw()
    picture = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]
    lattice, shown = view().lattice, view()
    for east_m, north_m in [(10.75, 2.25), (5.25, -0.25), (7.3, 0.9), (11.9, -0.9), (10.3, 2.2)]:
        i, j = lattice.index(east_m, north_m)
        density = int(shown.density[j - WINDOW.j0, i - WINDOW.i0])
        expected = image_of(figure).cmap(density / 255.0)[0] * 255
        x, y = figure.axes[0].transData.transform((east_m, north_m))
        assert picture[int(picture.shape[0] - y), int(x), 0] == pytest.approx(expected, abs=2)


def test_the_bar_goes_from_0_to_255_whatever_is_in_the_map() -> None:
    dim = view(density=np.full(WINDOW.shape, 7, dtype=np.uint8))
    figure = figures.universal_grid(dim)
    image = image_of(figure)
    assert image.get_clim() == (0, 255)
    assert image.colorbar is not None
    bar = image.colorbar.ax
    assert bar.get_ylim() == (0, 255)
    assert "3D density" in bar.get_ylabel()
    # The denser the darker, also in grey print, and an obstacle has another hue than free ground.
    colours = np.array([image.cmap(image.norm(v))[:3] for v in range(256)])
    lightness = colours @ np.array([0.299, 0.587, 0.114])
    assert all(b < a for a, b in pairwise(lightness))
    assert lightness[100] - lightness[101] > 0.2
    assert colours[101, 1] < 0.5 < colours[100, 1]


def test_labels_and_titles() -> None:
    axes = figures.universal_grid(view()).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("east (m)", "north (m)")
    assert axes.get_title() == "universal grid, cells of 50 cm"
    assert figures.universal_grid(view(), title="June").axes[0].get_title() == "June"


def test_large_coordinates_are_written_in_full(tmp_path: Path) -> None:
    far = view(window=Window(8 + 80_000, -2, 16, 8))
    figure = figures.universal_grid(far)
    figure.savefig(tmp_path / "m.png")
    axes = figure.axes[0]
    assert axes.xaxis.get_offset_text().get_text() == ""
    assert any(label.get_text().startswith("4000") for label in axes.get_xticklabels())


def test_positions_of_used_frames_inside_are_marked() -> None:
    frames = [
        record(pose(0, 6.0, 1.0)),
        record(pose(1, 7.0, 2.0, reason="a jump")),
        record(pose(2, 20.0, 1.0)),  # outside of the view
        record(pose(3, 11.0, -0.5)),
    ]
    axes = figures.universal_grid(view(), [drive(frames=frames)]).axes[0]
    assert lines_with_marker(axes, ".") == [([6.0, 11.0], [1.0, -0.5])]
    assert image_of(axes.figure).get_extent() == pytest.approx([4.0, 12.0, -1.0, 3.0])
    assert axes.get_xlim() == pytest.approx((4.0, 12.0))


@pytest.mark.parametrize(("width", "height"), [(4000, 20), (20, 4000), (1, 1)])
def test_long_and_thin_maps_make_pictures_of_bearable_size(
    width: int, height: int, tmp_path: Path
) -> None:
    shape = (height, width)
    strip = MapView(
        Lattice(0.05), Window(0, 0, width, height),
        np.zeros(shape, np.uint8), np.ones(shape, np.bool_), DATUM,
    )  # fmt: skip
    picture = pixels(figures.universal_grid(strip), tmp_path / "m.png")
    assert 300 < max(picture.shape[:2]) < 1500
    assert min(picture.shape[:2]) > 300


def test_no_label_is_cut_off_at_the_edge(tmp_path: Path) -> None:
    shape = (76, 74)
    far = MapView(
        Lattice(0.2), Window(26_108, 11_868, shape[1], shape[0]),
        np.zeros(shape, np.uint8), np.ones(shape, np.bool_), DATUM,
    )  # fmt: skip
    for k, figure in enumerate([figures.universal_grid(far), figures.sheet(far, [])]):
        figures.save(figure, tmp_path / f"{k}.png")
        box = figure.axes[0].get_tightbbox()
        assert box is not None
        assert min(box.x0, box.y0, figure.bbox.x1 - box.x1, figure.bbox.y1 - box.y1) > 1.0


def test_what_was_found_has_a_legend_and_no_colour_of_cells(tmp_path: Path) -> None:
    line, area = shapely.LineString([(1, 1), (1, 5)]), shapely.box(4, 1, 7, 4)
    found = [
        Feature("row", line, {"id": "R1"}),
        Feature("lane", line, {"id": "L1", "driven": True}),
        Feature("lane", line, {"id": "L2", "driven": False}),
        Feature("lane", line, {"id": "L3", "driven": True}),
        Feature("headland", area, {"id": "H1"}),
    ]
    for figure in (
        figures.universal_grid(view(), found=found),
        figures.sheet(view(), [], found=found),
    ):
        (legend,) = figure.legends
        named = sorted(text.get_text() for text in legend.get_texts())
        assert named == ["headland", "lane", "lane, not driven", "row"]
        (patch,) = (one for one in figure.axes[0].patches if isinstance(one, PathPatch))
        assert not patch.get_fill()


def test_sessions_have_their_colours_and_names() -> None:
    drives = [
        drive("june", [record(pose(0, 6.0, 1.0))], colour="#0072b2"),
        drive("august", [record(pose(1, 7.0, 1.0))], colour="#d55e00"),
    ]
    figure = figures.universal_grid(view(), drives)
    dots = [line for line in figure.axes[0].get_lines() if line.get_marker() == "."]
    assert [line.get_color() for line in dots] == ["#0072b2", "#d55e00"]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["june", "august"]


def test_a_wide_map_fills_its_page(tmp_path: Path) -> None:
    shape = (400, 1600)
    wide = MapView(
        Lattice(0.05), Window(0, 0, shape[1], shape[0]),
        np.zeros(shape, np.uint8), np.ones(shape, np.bool_), DATUM,
    )  # fmt: skip
    for k, figure in enumerate([figures.universal_grid(wide), figures.sheet(wide, [])]):
        picture = pixels(figure, tmp_path / f"{k}.png")
        _, columns = place_of(figure.axes[0], picture.shape)
        assert columns.stop - columns.start > 0.8 * picture.shape[1]
        assert picture.shape[0] < 0.85 * picture.shape[1]


@pytest.mark.parametrize("width_m", [0.3, 7.0, 44.0, 1234.0, 90_000.0])
def test_the_scale_bar_is_a_round_length_that_fits(width_m: float) -> None:
    axes = figures.new_figure((5.0, 5.0)).add_subplot()
    axes.set_xlim(0.0, width_m)
    add_scale_bar(axes, width_m)
    (bar,) = (artist for artist in axes.artists if isinstance(artist, AnchoredSizeBar))
    length_m = float(bar.txt_label.get_text().removesuffix(" m"))
    assert 0.1 * width_m <= length_m <= 0.25 * width_m
    assert f"{length_m:e}"[0] in "125"
    assert bar.size_bar.get_children()[0].get_width() == length_m


def test_another_layer_has_its_own_scale_and_colours() -> None:
    heights = np.linspace(3.0, 7.0, 128, dtype=np.float32).reshape(WINDOW.shape)
    heights[2, 5] = np.nan
    figure = figures.universal_grid(view(layers={"height": heights}), layer="height")
    image = image_of(figure)
    low, high = image.get_clim()
    assert (low, high) == (float(heights[0, 1]), 7.0)  # the column in the west was not seen
    assert np.ma.getmaskarray(image.get_array())[2, 5]
    assert image.colorbar is not None
    assert image.colorbar.ax.get_ylabel() == "height (m)"


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("layer", [name for name in LAYERS if name != "density"])
def test_every_layer_is_drawn_whatever_its_values_are(layer: str, seen: bool) -> None:
    values = np.zeros(WINDOW.shape, dtype=LAYERS[layer].dtype)
    values[OBSTACLE] = 1
    observed = np.full(WINDOW.shape, seen)
    low, high = image_of(
        figures.universal_grid(view(observed=observed, layers={layer: values}), layer=layer)
    ).get_clim()
    assert low < high


@pytest.mark.parametrize(
    ("layer", "zoom"),  # more and fewer pixels than cells
    [
        ("density", 1),
        ("variance", 40),
        pytest.param("density", 40, marks=pytest.mark.long),
        pytest.param("variance", 1, marks=pytest.mark.long),
    ],
)
def test_the_picture_is_that_of_the_colours_of_the_cells(
    layer: str, zoom: int, tmp_path: Path
) -> None:
    random = np.random.default_rng(0)
    window = Window(-90, 40, 37 * zoom, 31 * zoom)
    density = random.integers(0, 256, window.shape).astype(np.uint8)
    observed = random.random(window.shape) < 0.8
    layers = {"variance": random.random(window.shape, dtype=np.float32)}
    shown = view(window=window, density=density, observed=observed, layers=layers)
    of_cells, of_colours = (figures.universal_grid(shown, layer=layer) for _ in range(2))
    image_of(of_colours).set_interpolation_stage("rgba")
    np.testing.assert_array_equal(
        pixels(of_cells, tmp_path / "cells.png"), pixels(of_colours, tmp_path / "colours.png")
    )


def test_shades_do_not_depend_on_how_many_rows_are_worked_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = np.random.default_rng(0)
    heights = random.normal(3.0, 0.1, (300, 60)).astype(np.float32)
    known = random.random(heights.shape) < 0.6
    whole_m = relief.smoothed(heights, known, 4.0)
    whole = relief._shades(whole_m, known, 0.1)
    monkeypatch.setattr(relief, "_BAND_CELLS", 60)
    cut_m = relief.smoothed(heights, known, 4.0)
    np.testing.assert_array_equal(cut_m, whole_m)
    for one, other in zip(relief._shades(cut_m, known, 0.1), whole, strict=True):
        np.testing.assert_array_equal(one, other)
    alone = hillshade(whole_m, 0.1)
    np.testing.assert_array_equal(whole[0], np.nan_to_num(alone) > 0.0)


def test_heights_have_shades_and_contours() -> None:
    """Ground that rises to the east by 0.2: the light comes from the north-west."""
    heights = np.broadcast_to(0.1 * np.arange(WINDOW.width, dtype=np.float32), WINDOW.shape)
    east_m = Lattice(0.5).centres(WINDOW)[0]
    figure = figures.universal_grid(view(layers={"ground": heights}), layer="ground")
    values, shades = figure.axes[0].get_images()
    assert shades.get_extent() == values.get_extent() == [4.0, 12.0, -1.0, 3.0]
    opacity = np.asarray(shades.get_alpha())
    assert (opacity[:, 0] == 0.0).all()  # not seen
    assert (np.asarray(shades.get_array())[:, 3:-3] == 1).all()
    assert (opacity[:, 3:-3] > 0.1).all()
    (contours,) = (c for c in figure.axes[0].collections if isinstance(c, QuadContourSet))
    assert list(contours.levels) == pytest.approx(np.arange(0.2, 1.6, 0.2))
    for level, path in zip(contours.levels[1:-1], contours.get_paths()[1:-1], strict=True):
        place = np.interp(level, heights[0], east_m)
        np.testing.assert_allclose(path.vertices[:, 0], place, atol=0.1)
    others = figures.universal_grid(view(layers={"slope": heights}), layer="slope")
    assert len(others.axes[0].get_images()) == 1


def test_slopes_to_the_light_are_lighter() -> None:
    row, column = np.mgrid[0:9, 0:9].astype(np.float64)
    level, to_light, away = (hillshade(h, 1.0)[4, 4] for h in (0 * row, column - row, row - column))
    assert level == pytest.approx(0.0)
    assert to_light > 0.1
    assert away < -0.5


@pytest.mark.parametrize(
    ("low_m", "high_m", "expected"),
    [
        (0.3, 5.4, np.arange(0.5, 5.1, 0.5)),
        (-3.0, 97.0, np.arange(0.0, 100.0, 10.0)),
        (2.0, 2.0, []),
        (7.0, 7.9, np.arange(7.0, 7.95, 0.1)),
    ],
)
def test_contours_are_at_round_heights(low_m: float, high_m: float, expected: list[float]) -> None:
    assert list(contour_levels(low_m, high_m)) == pytest.approx(list(expected))


def test_no_label_is_cut(tmp_path: Path) -> None:
    long = "a very long name of a map that was driven in the vineyard of the upper hillside"
    for k, figure in enumerate(
        [
            figures.universal_grid(view(), title=long),
            figures.sheet(view(), [drive(long), drive(f"{long} 2")], title=long),
        ]
    ):
        figure.savefig(tmp_path / f"{k}.png")
        canvas = figure.canvas.get_renderer()  # type: ignore[attr-defined]
        for axes in figure.axes:
            for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
                box = text.get_window_extent(canvas)
                assert box.x0 >= -1
                assert box.x1 <= figure.bbox.width + 1
                assert box.y0 >= -1
                assert box.y1 <= figure.bbox.height + 1


def test_a_route_is_drawn_where_it_is(tmp_path: Path) -> None:
    expected = np.array([[5.0, 0.5], [9.0, 1.5], [30.0, 2.0]])
    lat, lon, _ = DATUM.to_geodetic(expected[:, 0], expected[:, 1], 0.0)
    path = tmp_path / "route.geojson"
    line = {"type": "LineString", "coordinates": np.stack([lon, lat], axis=1).tolist()}
    path.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": line}))
    route = figures.read_route(path, DATUM)
    np.testing.assert_allclose(route, expected, atol=2e-3)
    axes = figures.universal_grid(view(), route=route).axes[0]
    (drawn,) = (one for one in axes.get_lines() if one.get_label() == "route")
    np.testing.assert_array_equal(drawn.get_xydata(), route)
    assert axes.get_xlim() == pytest.approx((4.0, 12.0))


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", '{"type": "FeatureCollection", "features": []}', "[" * 100_000,
     '{"type": "LineString", "coordinates": [[1], [2]]}', '{"type": "LineString"}'],
)  # fmt: skip
def test_what_is_no_route_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "route.geojson"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"route\.geojson (is no GeoJSON|has no line)"):
        figures.read_route(path, DATUM)
    with pytest.raises(ConfigError, match="cannot be read"):
        figures.read_route(tmp_path / "none.geojson", DATUM)


# --- trajectory


def test_used_and_rejected_frames_are_told_apart() -> None:
    frames = [
        record(pose(0, 1.0, 2.0)),
        record(pose(1, 3.0, 4.0, reason="a jump")),
        record(pose(2, 5.0, 7.0)),
    ]
    axes = figures.trajectory([drive("june", frames, track([0.0, 0.0, 0.0]))]).axes[0]
    assert lines_with_marker(axes, "o") == [([1.0, 5.0], [2.0, 7.0])]
    assert lines_with_marker(axes, "x") == [([3.0], [4.0])]
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["june: 2 used", "june: 1 rejected"]
    colours = {line.get_color() for line in axes.get_lines() if line.get_marker() in ("o", "x")}
    assert len(colours) == 2


def test_the_path_has_a_gap_where_fixes_were_rejected() -> None:
    axes = figures.trajectory([drive(trajectory=track([0.0] * 5, rejected=(2,)))]).axes[0]
    (path,) = axes.get_lines()
    np.testing.assert_array_equal(path.get_xdata(), [0.0, 2.0, np.nan, 6.0, 8.0])
    np.testing.assert_array_equal(path.get_ydata(), [0.0, 3.0, np.nan, 9.0, 12.0])
    assert axes.get_aspect() == 1.0
    assert axes.get_legend() is None


def test_each_session_has_its_own_path() -> None:
    drives = [
        drive("june", trajectory=track([0.0] * 3)),
        drive("august", trajectory=track([0.0] * 4), colour="#d55e00"),
    ]
    lines = figures.trajectory(drives).axes[0].get_lines()
    assert [len(line.get_xdata()) for line in lines] == [3, 4]
    assert len({line.get_color() for line in lines}) == 2


# --- heading


def heading_line(figure: Figure) -> npt.NDArray[np.float64]:
    return np.asarray(figure.axes[0].get_lines()[0].get_ydata(), dtype=np.float64)


def test_the_heading_does_not_cross_the_picture_at_180_degrees() -> None:
    values = [170.0, 179.0, -179.0, -170.0, -160.0]
    figure = figures.heading([drive(trajectory=track(values))])
    np.testing.assert_array_equal(heading_line(figure), values)
    # Dots that no line joins.
    assert all(line.get_linestyle() == "None" for line in figure.axes[0].lines)


def test_a_heading_that_does_not_wrap_is_drawn_in_full() -> None:
    values = [-170.0, -20.0, 120.0, 175.0]
    np.testing.assert_array_equal(
        heading_line(figures.heading([drive(trajectory=track(values))])), values
    )


def test_a_heading_due_south_is_drawn() -> None:
    values = [179.6, -179.7, 179.8, -179.5, 179.9, -179.9, 179.7, -179.6]
    line = heading_line(figures.heading([drive(trajectory=track(values))]))
    np.testing.assert_array_equal(line, values)


def test_the_band_is_three_sigma() -> None:
    figure = figures.heading([drive(trajectory=track([10.0, 20.0, 30.0]))])
    (band,) = (c for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.min() == pytest.approx(10.0 - 6.0)
    assert heights.max() == pytest.approx(30.0 + 6.0)


def test_rejected_fixes_have_no_heading() -> None:
    line = heading_line(
        figures.heading([drive(trajectory=track([0.0, 5.0, 99.0, 10.0], rejected=(2,)))])
    )
    np.testing.assert_array_equal(np.isnan(line), [False, False, True, False])


def test_each_session_has_an_axis_of_time_of_its_own() -> None:
    day_ns = 86_400_000_000_000
    later = dataclasses.replace(
        pose(2, heading_deg=90.0), time_ns=START_NS + day_ns + 2_000_000_000
    )
    figure = figures.heading(
        [
            drive("june", [record(pose(1))], track([0.0] * 4)),
            drive("august", [record(later)], track([90.0] * 4, start_ns=START_NS + day_ns)),
        ]
    )
    first, second = figure.axes
    assert lines_with_marker(first, "o") == [([1.0], [0.0])]
    assert lines_with_marker(second, "o") == [([2.0], [90.0])]
    assert first.get_xlabel() == "time (s) since 2011-06-15T10:30:15Z"
    assert second.get_xlabel() == "time (s) since 2011-06-16T10:30:15Z"
    assert first.get_title() == "june: heading, with 3 sigma"
    assert first.get_ylim() == second.get_ylim() == (-180.0, 180.0)


def test_of_many_sessions_the_latest_are_drawn() -> None:
    figure = figures.heading([drive(f"{k}", trajectory=track([0.0] * 3)) for k in range(30)])
    assert len(figure.axes) == 8
    assert figure.axes[-1].get_title().startswith("29: ")
    assert figure.get_suptitle() == "the latest 8 of 30 sessions"


def test_a_trajectory_is_not_needed() -> None:
    frames = [record(pose(3, heading_deg=7.0)), record(pose(5))]
    axes = figures.heading([drive(frames=frames)]).axes[0]
    assert lines_with_marker(axes, "o") == [([0.0, 2.0], [7.0, 0.0])]


def test_nothing_to_draw_is_a_picture_too(tmp_path: Path) -> None:
    for k, figure in enumerate(
        [figures.heading([drive(trajectory=track([]))]), figures.trajectory([])]
    ):
        assert min(pixels(figure, tmp_path / f"{k}.png").shape[:2]) > 300


# --- the track: gears, verdicts, speed, sigma


def worked(
    gear: list[int], heading_deg: list[float] | None = None, rejected: tuple[int, ...] = ()
) -> Trajectory:
    """A track of a row a second with a gear each."""
    one = track(heading_deg or [30.0] * len(gear), rejected=rejected)
    signs = np.array(gear, dtype=np.int64)
    return dataclasses.replace(one, gear=signs, speed_mps=1.5 * signs)


def labelled(axes: Axes, label: str) -> npt.NDArray[np.float64]:
    """x and y of the one line of a label, [n, 2]."""
    (line,) = (line for line in axes.get_lines() if line.get_label() == label)
    return np.stack([np.asarray(line.get_xdata()), np.asarray(line.get_ydata())], axis=1)


def test_gears_are_drawn_apart() -> None:
    place, nose, speed, sigma = figures.track_figure(worked([1, 1, 0, -1, -1])).axes
    for axes in (place, nose, speed, sigma):
        names = {str(line.get_label()) for line in axes.get_lines()}
        assert {"forward", "reverse", "at rest"} <= names
        assert "rejected" not in names
    # A line goes on to its neighbours, so that none is missing between two gears.
    assert np.isfinite(labelled(place, "forward")).all(axis=1).tolist() == [True] * 3 + [False] * 2
    assert np.isfinite(labelled(place, "reverse")).all(axis=1).tolist() == [False] * 2 + [True] * 3
    assert np.flatnonzero(np.isfinite(labelled(place, "at rest")[:, 0])).tolist() == [2]
    assert labelled(speed, "reverse")[3, 1] == -1.5
    assert place.get_aspect() == 1.0
    assert sigma.get_yscale() == "log"
    assert [axes.get_ylabel() for axes in (place, nose, speed, sigma)] == [
        "north (m)", "heading (° from north)", "speed (m/s)", "heading sigma (°)",
    ]  # fmt: skip
    assert sigma.get_xlabel() == "time (s) since 2011-06-15T10:30:15Z"


def test_gears_differ_without_colour() -> None:
    """In grey print: by the lightness and the width of their lines."""
    axes = figures.track_figure(worked([1, 1, 0, -1, -1])).axes[0]
    looks = {str(line.get_label()): line for line in axes.get_lines()}
    weights = np.array([0.299, 0.587, 0.114])
    forward, reverse = (
        float(weights @ matplotlib.colors.to_rgb(looks[name].get_color()))
        for name in ("forward", "reverse")
    )
    assert reverse - forward > 0.25
    assert looks["reverse"].get_linewidth() > 2 * looks["forward"].get_linewidth()


def test_no_line_of_a_heading_crosses_the_plot() -> None:
    values = [170.0, 178.0, -176.0, -170.0, 175.0]
    place, nose, *_ = figures.track_figure(worked([1] * 5, values)).axes
    line = labelled(nose, "forward")
    assert np.nanmax(np.abs(np.diff(line[:, 1]))) < 180.0
    assert np.isnan(line[:, 1]).sum() == 2
    assert np.isfinite(labelled(place, "forward")).all()  # the way itself has no hole there


def test_the_band_of_a_heading_goes_on_at_the_other_edge() -> None:
    nose = figures.track_figure(worked([1] * 3, [179.0, 179.5, 179.0])).axes[1]
    bands = [c for c in nose.collections if isinstance(c, PolyCollection)]
    lows = sorted(float(np.nanmin(band.get_paths()[0].vertices[:, 1])) for band in bands)
    assert lows == pytest.approx([-183.0, 177.0])
    assert nose.get_ylim() == (-180.0, 180.0)


def test_rejected_poses_are_crossed_and_keep_their_gear() -> None:
    axes = figures.track_figure(worked([1] * 6, rejected=(2, 3))).axes[0]
    np.testing.assert_array_equal(labelled(axes, "rejected"), [[4.0, 6.0], [6.0, 9.0]])
    assert np.isfinite(labelled(axes, "forward")).all()


def test_repeats_of_a_fast_receiver_are_not_crossed() -> None:
    """Every other fix rejected, 0.1 s apart: that is how the receiver works."""
    one = worked([1] * 8, rejected=(1, 3, 5, 7))
    fast = dataclasses.replace(one, time_ns=START_NS + np.arange(8, dtype=np.int64) * 100_000_000)
    # The last one only: no accepted fix follows it.
    crossed = labelled(figures.track_figure(fast).axes[0], "rejected")
    np.testing.assert_array_equal(crossed, [[14.0, 21.0]])


def test_a_hole_in_time_is_crossed_by_no_line() -> None:
    one = worked([1] * 6)
    time_ns = one.time_ns + np.array([0, 0, 0, 1, 1, 1]) * 20_000_000_000
    axes = figures.track_figure(dataclasses.replace(one, time_ns=time_ns)).axes[0]
    assert np.flatnonzero(np.isnan(labelled(axes, "forward")[:, 0])).tolist() == [3]


def test_poses_without_a_heading_are_left_out() -> None:
    axes = figures.track_figure(worked([1] * 4, [0.0, np.nan, 0.0, 0.0], rejected=(1,))).axes[0]
    assert labelled(axes, "forward")[:, 0].tolist() == [0.0, 4.0, 6.0]


def test_the_limit_of_sigma_is_a_line_inside_the_plot() -> None:
    sigma = figures.track_figure(worked([1] * 4), max_sigma_deg=3.0).axes[3]
    dashed = [line for line in sigma.get_lines() if line.get_linestyle() == "--"]
    assert [list(line.get_ydata()) for line in dashed] == [[3.0, 3.0]]
    low, high = sigma.get_ylim()
    assert low < 2.0 < 3.0 < high
    assert [text.get_text() for text in sigma.texts] == ["limit 3°"]


def test_ticks_point_where_the_nose_points() -> None:
    figure = figures.track_figure(worked([-1] * 5, [90.0] * 5))
    (ticks,) = (c for c in figure.axes[0].collections if isinstance(c, Quiver))
    assert (np.asarray(ticks.U) > 0.1).all()
    np.testing.assert_allclose(np.asarray(ticks.V), 0.0, atol=1e-9)


def test_a_long_track_is_thinned_and_keeps_its_changes() -> None:
    n = 40_000
    gear = np.ones(n, dtype=np.int64)
    gear[20_001:20_003] = -1
    figure = figures.track_figure(worked(gear.tolist(), [10.0] * n))
    line = labelled(figure.axes[0], "reverse")
    assert len(line) < 1.1 * figures.MOST_POINTS
    assert np.isfinite(line[:, 0]).sum() == 4  # both, and a neighbour on either side
    assert figure.axes[3].get_xlabel().startswith("time (h)")


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_track_of_hardly_a_row_is_a_picture(count: int, tmp_path: Path) -> None:
    figure = figures.track_figure(worked([1] * count), title="short")
    assert min(pixels(figure, tmp_path / "m.png").shape[:2]) > 300


def test_the_colours_of_a_track_are_in_the_picture(tmp_path: Path) -> None:
    figure = figures.track_figure(worked([1] * 10 + [0] * 3 + [-1] * 10), title="June")
    picture = pixels(figure, tmp_path / "m.png")
    inside = picture[place_of(figure.axes[0], picture.shape)].astype(int)
    red, blue = inside[:, :, 0], inside[:, :, 2]
    assert ((red - blue) > 100).sum() > 200  # reverse, wide and orange
    assert ((blue - red) > 60).sum() > 100  # forward
    assert "June" in figure.get_suptitle()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "forward", "reverse", "at rest", "nose",
    ]  # fmt: skip


# --- the sheet


def test_a_sheet_has_all_three(two_lanes_map: Path, tmp_path: Path) -> None:
    with open_map(two_lanes_map) as universal:
        cropped = universal.read(Bounds(-10.0, 50.0, 0.0, 60.0))
        sheet = figures.sheet(cropped, figures.drives_of(universal), title="June")
    titles = [axes.get_title() for axes in sheet.axes]
    assert titles[0] == "June"
    assert any(title.startswith("trajectory") for title in titles)
    assert any("heading" in title for title in titles)
    picture = pixels(sheet, tmp_path / "m.png")
    assert picture.shape[1] > picture.shape[0] > 800


def test_driven_ground_is_tinted_where_it_does_not_look_free(
    two_lanes_map: Path, tmp_path: Path
) -> None:
    """About the first frame, which nobody saw; a view that was not read to decide says nothing."""
    with open_map(two_lanes_map) as universal:
        first = next(iter(universal.frames())).pose
        east, north = round(first.east_m), round(first.north_m)
        place = Bounds(east - 3.0, north - 3.0, east + 3.0, north + 3.0)
        told, plain = universal.read(place, decide="density"), universal.read(place)
    driven = ~told.observed & (told.decision().seen > 0)
    assert driven.sum() > 500
    images = [figures.universal_grid(one).axes[0].get_images() for one in (told, plain)]
    assert [len(of) for of in images] == [2, 1]
    tint = np.ma.getmaskarray(images[0][1].get_array())
    np.testing.assert_array_equal(~tint & ~told.observed, driven)
    assert not (~tint & told.observed & (told.density <= 50)).any()


def test_rows_of_the_example_run_from_south_west_to_north_east(
    two_lanes_map: Path, tmp_path: Path
) -> None:
    """The dark rows of the picture lean to the right, at 37 degrees from north."""
    with open_map(two_lanes_map) as universal:
        figure = figures.universal_grid(universal.read(Bounds(-12.0, 50.0, 0.0, 62.0)))
    picture = pixels(figure, tmp_path / "m.png")
    inside = picture[place_of(figure.axes[0], picture.shape)]
    rows, columns = np.nonzero(inside[:, :, 1] < 100)
    x, y = columns - columns.mean(), -(rows - rows.mean())
    along = np.radians(37.0)

    def spread(angle: float) -> float:
        """How much of the dark lies in bands along a direction (clockwise from up)."""
        across = x * np.cos(angle) - y * np.sin(angle)
        counts = np.histogram(across, bins=80)[0]
        return float(np.std(counts))

    assert spread(along) > 1.5 * spread(-along)
    assert spread(along) > 1.5 * spread(along + np.pi / 2)


# --- saving


def test_a_figure_is_saved_in_the_format_of_its_name(tmp_path: Path) -> None:
    figure = figures.heading([])
    starts = {"a.png": b"\x89PNG", "b.PDF": b"%PDF", "c.svg": b"<?xml"}
    for name, start in starts.items():
        figures.save(figure, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(start)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(starts)


@pytest.mark.parametrize(
    "name", ["price $5 \\frac{$9", "n" * 255, "漢字", "under_row\x1b[31m\n]]>&b"]
)
@pytest.mark.filterwarnings("error")
def test_names_are_drawn_as_they_are(tmp_path: Path, name: str) -> None:
    shown = drive(name, frames=[record(pose(0)), record(pose(1))], trajectory=track([0.0, 5.0]))
    for kind, figure in enumerate((figures.trajectory([shown]), figures.heading([shown]))):
        figure.axes[0].set_title(name, wrap=True)
        path = tmp_path / f"{kind}.svg"
        figures.save(figure, path)
        ElementTree.parse(path)
        written = [text.get_text() for text in figure.findobj(Text)]
        assert all(line.isprintable() for text in written for line in text.split("\n"))
        assert any((name[:60] + "..." if len(name) > 60 else name[:6]) in text for text in written)


def test_an_earlier_figure_is_replaced_but_not_by_a_wrong_one(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    figures.save(figures.heading([]), path)
    old = path.read_bytes()
    figures.save(figures.trajectory([]), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.read_bytes() != old
    notes = tmp_path / "a.txt"
    notes.write_bytes(b"notes")
    with pytest.raises(ConfigError, match=r"a\.txt names no format .* \.png, \.pdf or \.svg"):
        figures.save(figures.heading([]), notes)
    assert notes.read_bytes() == b"notes"
    with pytest.raises(ConfigError, match=r"a\.jpg names no format"):  # matplotlib could write it
        figures.save(figures.heading([]), tmp_path / "a.jpg")
    assert sorted(tmp_path.iterdir()) == [path, notes]


@pytest.mark.parametrize("place", ["folder.png", "not/x.png"])
def test_a_figure_that_cannot_be_written(place: str, tmp_path: Path) -> None:
    folder = tmp_path / "folder.png"
    folder.mkdir()
    with pytest.raises(MapError, match=r"is a folder; give the name|its folder does not exist"):
        figures.save(figures.heading([]), tmp_path / place)
    assert list(tmp_path.rglob("*")) == [folder]


def test_no_window_system_is_touched() -> None:
    code = (
        "import sys; from fieldgrid.export import figures; figures.heading([]);"
        "print([m for m in sys.modules if m in ('matplotlib.pyplot', 'tkinter')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
