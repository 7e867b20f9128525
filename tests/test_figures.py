"""The pictures: what is where, how dark, and which way up."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import matplotlib.colors
import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.quiver import Quiver

from fieldgrid import figures
from fieldgrid.errors import ConfigError, MapError
from fieldgrid.geodesy import Datum
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.lattice import Bounds, Lattice, Window
from fieldgrid.mapfile import FrameRecord, MapView, open_map
from fieldgrid.trajectory import Pose, Status, Trajectory

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
    (image,) = figure.axes[0].get_images()
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
    dark = np.argwhere(inside.max(axis=2) < 20)
    # The obstacle is one cell, in row 6 of 8 from the south and column 13 of 16 from the west.
    assert len(dark) == pytest.approx(height * width / (8 * 16), rel=0.1)
    row, column = dark.mean(axis=0)
    assert row / height == pytest.approx((8 - 6.5) / 8, abs=0.02)
    assert column / width == pytest.approx(13.5 / 16, abs=0.02)
    grey = np.argwhere((inside.max(axis=2) < 140) & (inside.min(axis=2) > 115))
    row, column = grey.mean(axis=0)
    assert row / height == pytest.approx((8 - 1.5) / 8, abs=0.02)
    assert column / width == pytest.approx(2.5 / 16, abs=0.02)


def test_unseen_is_tinted_and_free_is_white(tmp_path: Path) -> None:
    figure = figures.universal_grid(view())
    picture = pixels(figure, tmp_path / "m.png")
    inside = picture[place_of(figure.axes[0], picture.shape)]
    width = inside.shape[1]
    west, free = inside[:, : int(0.9 * width / 16)], inside[5:20, int(0.3 * width) :]
    assert {tuple(int(v) for v in p) for p in west.reshape(-1, 3)} == {UNSEEN_RGB}
    assert (free == 255).all()
    assert max(UNSEEN_RGB) - min(UNSEEN_RGB) > 15  # a tint, no grey: no density looks like it


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
        expected = 255 - int(shown.density[j - WINDOW.j0, i - WINDOW.i0])
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
    assert image.cmap(image.norm(255))[:3] == (0.0, 0.0, 0.0)
    assert image.cmap(image.norm(0))[:3] == (1.0, 1.0, 1.0)
    greys = [image.cmap(image.norm(v))[0] for v in range(256)]
    assert all(b < a for a, b in pairwise(greys))


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
    axes = figures.universal_grid(view(), frames).axes[0]
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


# --- trajectory


def test_used_and_rejected_frames_are_told_apart() -> None:
    frames = [
        record(pose(0, 1.0, 2.0)),
        record(pose(1, 3.0, 4.0, reason="a jump")),
        record(pose(2, 5.0, 7.0)),
    ]
    axes = figures.trajectory([track([0.0, 0.0, 0.0])], frames).axes[0]
    assert lines_with_marker(axes, "o") == [([1.0, 5.0], [2.0, 7.0])]
    assert lines_with_marker(axes, "x") == [([3.0], [4.0])]
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["2 used", "1 rejected"]
    colours = {line.get_color() for line in axes.get_lines() if line.get_marker() in ("o", "x")}
    assert len(colours) == 2


def test_the_path_has_a_gap_where_fixes_were_rejected() -> None:
    axes = figures.trajectory([track([0.0] * 5, rejected=(2,))], []).axes[0]
    (path,) = axes.get_lines()
    np.testing.assert_array_equal(path.get_xdata(), [0.0, 2.0, np.nan, 6.0, 8.0])
    np.testing.assert_array_equal(path.get_ydata(), [0.0, 3.0, np.nan, 9.0, 12.0])
    assert axes.get_aspect() == 1.0
    assert axes.get_legend() is None


def test_each_session_has_its_own_path() -> None:
    axes = figures.trajectory([track([0.0] * 3), track([0.0] * 4)], []).axes[0]
    assert [len(line.get_xdata()) for line in axes.get_lines()] == [3, 4]


# --- heading


def heading_line(figure: Figure) -> npt.NDArray[np.float64]:
    return np.asarray(figure.axes[0].get_lines()[0].get_ydata(), dtype=np.float64)


def test_the_heading_does_not_cross_the_picture_at_180_degrees() -> None:
    values = [170.0, 179.0, -179.0, -170.0, -160.0]
    figure = figures.heading([track(values)], [])
    np.testing.assert_array_equal(heading_line(figure), values)
    # Dots that no line joins.
    assert all(line.get_linestyle() == "None" for line in figure.axes[0].lines)


def test_a_heading_that_does_not_wrap_is_drawn_in_full() -> None:
    values = [-170.0, -20.0, 120.0, 175.0]
    np.testing.assert_array_equal(heading_line(figures.heading([track(values)], [])), values)


def test_a_heading_due_south_is_drawn() -> None:
    values = [179.6, -179.7, 179.8, -179.5, 179.9, -179.9, 179.7, -179.6]
    line = heading_line(figures.heading([track(values)], []))
    np.testing.assert_array_equal(line, values)


def test_the_band_is_three_sigma() -> None:
    figure = figures.heading([track([10.0, 20.0, 30.0])], [])
    (band,) = (c for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.min() == pytest.approx(10.0 - 6.0)
    assert heights.max() == pytest.approx(30.0 + 6.0)


def test_rejected_fixes_have_no_heading() -> None:
    line = heading_line(figures.heading([track([0.0, 5.0, 99.0, 10.0], rejected=(2,))], []))
    np.testing.assert_array_equal(np.isnan(line), [False, False, True, False])


def test_frames_of_two_days_lie_on_one_axis_of_time() -> None:
    day_ns = 86_400_000_000_000
    tracks = [track([0.0] * 4), track([90.0] * 4, start_ns=START_NS + day_ns)]
    later = dataclasses.replace(
        pose(2, heading_deg=90.0), time_ns=START_NS + day_ns + 2_000_000_000
    )
    axes = figures.heading(tracks, [record(pose(1)), record(later)]).axes[0]
    assert lines_with_marker(axes, "o") == [([1.0, 2.0], [0.0, 90.0])]
    assert axes.get_ylim() == (-180.0, 180.0)


def test_a_trajectory_is_not_needed() -> None:
    axes = figures.heading([], [record(pose(3, heading_deg=7.0)), record(pose(5))]).axes[0]
    assert lines_with_marker(axes, "o") == [([0.0, 2.0], [7.0, 0.0])]


def test_nothing_to_draw_is_a_picture_too(tmp_path: Path) -> None:
    for k, figure in enumerate([figures.heading([track([])], []), figures.trajectory([], [])]):
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
        frames = list(universal.frames())
        cropped = universal.read(Bounds(-10.0, 50.0, 0.0, 60.0))
        sheet = figures.sheet(cropped, [universal.trajectory("two_lanes")], frames, title="June")
    titles = [axes.get_title() for axes in sheet.axes]
    assert titles[0] == "June"
    assert any(title.startswith("trajectory") for title in titles)
    assert any(title.startswith("heading") for title in titles)
    picture = pixels(sheet, tmp_path / "m.png")
    assert picture.shape[1] > picture.shape[0] > 800


def test_rows_of_the_example_run_from_south_west_to_north_east(
    two_lanes_map: Path, tmp_path: Path
) -> None:
    """The dark rows of the picture lean to the right, at 37 degrees from north."""
    with open_map(two_lanes_map) as universal:
        figure = figures.universal_grid(universal.read(Bounds(-12.0, 50.0, 0.0, 62.0)))
    picture = pixels(figure, tmp_path / "m.png")
    inside = picture[place_of(figure.axes[0], picture.shape)]
    rows, columns = np.nonzero(inside.max(axis=2) < 100)
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
    figure = figures.heading([], [])
    starts = {"a.png": b"\x89PNG", "b.PDF": b"%PDF", "c.svg": b"<?xml"}
    for name, start in starts.items():
        figures.save(figure, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(start)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(starts)


def test_an_earlier_figure_is_replaced_but_not_by_a_wrong_one(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    figures.save(figures.heading([], []), path)
    old = path.read_bytes()
    figures.save(figures.trajectory([], []), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.read_bytes() != old
    notes = tmp_path / "a.txt"
    notes.write_bytes(b"notes")
    with pytest.raises(ConfigError, match=r"a\.txt names no format .* \.png, \.pdf or \.svg"):
        figures.save(figures.heading([], []), notes)
    assert notes.read_bytes() == b"notes"
    assert sorted(tmp_path.iterdir()) == [path, notes]


@pytest.mark.parametrize("place", ["", "not/x.png"])
def test_a_figure_that_cannot_be_written(place: str, tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"is a folder; give the name|its folder does not exist"):
        figures.save(figures.heading([], []), tmp_path / place)
    assert list(tmp_path.iterdir()) == []


def test_no_window_system_is_touched() -> None:
    code = (
        "import sys; from fieldgrid import figures; figures.heading([], []);"
        "print([m for m in sys.modules if m in ('matplotlib.pyplot', 'tkinter')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
