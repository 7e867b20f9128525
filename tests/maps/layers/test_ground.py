"""The terrain that frames see: heights and slopes of the ground, by whole sums."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import Float64
from fieldgrid.geometry import GROUND_CHANNEL, HEIGHT_SHARE, NO_GROUND_CM, GridSpec, LocalGrid, Pose
from fieldgrid.maps import (
    AlignmentRecord,
    Cells,
    MapView,
    Transfer,
    Transform,
    create_map,
    open_map,
)
from fieldgrid.maps.layers.blocks import COLUMN_BITS
from fieldgrid.maps.layers.built_in import ground
from fieldgrid.maps.layers.built_in.ground import (
    GROUND,
    GROUP,
    SIGMA,
    _agreeing,
    _from_bins,
    add_terrain,
    halvings,
)
from fieldgrid.maps.layers.built_in.robust import (
    BIN_CM,
    BINS,
    MOST_HEIGHTS,
    WIDEST_SIGMA_M,
    Heights,
)
from fieldgrid.maps.layers.window import with_overviews
from tests.maps.file.maps import DATUM

SPEC = GridSpec(width_m=6.0, length_m=8.0, cell_m=0.1)
LAYERS = ("ground", "ground_sigma", "slope", "aspect")
_Centimetres = npt.NDArray[np.int16]
Frame = tuple[Pose, _Centimetres | None]


def seen_from(
    heading_deg: float, east_m: float = 0.0, up_m: float = 12.34, sigma_m: float = 0.02
) -> Pose:
    return Pose(1_000_000_000, east_m, 2.0, up_m, heading_deg, sigma_m, 0.3, 1.0)


def hillside(pose: Pose, rise_east: float, rise_north: float) -> _Centimetres:
    """Heights that a frame sees of a plane through the datum, above the ground of its pose."""
    x, y = SPEC.centres_m()
    phi = math.radians(pose.heading_deg)
    east = pose.east_m + x * math.cos(phi) + y[:, None] * math.sin(phi)
    north = pose.north_m - x * math.sin(phi) + y[:, None] * math.cos(phi)
    above = rise_east * east + rise_north * north - pose.up_m
    return np.rint(100.0 * above).astype(np.int16)


def grid() -> LocalGrid:
    return LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), np.ones(SPEC.shape, np.bool_))


def read(
    path: Path, sessions: Sequence[Sequence[Frame]], *, cell_m: float = 0.2, without: str = ""
) -> MapView:
    with create_map(path, DATUM, cell_m=0.2, transfer=Transfer.AREA) as universal:
        for number, frames in enumerate(sessions):
            with universal.add_session(str(number)) as session:
                for k, (pose, heights) in enumerate(frames):
                    channels = {} if heights is None else {GROUND_CHANNEL: heights}
                    session.add(grid(), pose, frame_id=str(k), channels=channels)
        if without:
            universal.remove_session(without)
    with open_map(path) as universal:
        return universal.read(cell_m=cell_m, layers=LAYERS)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, -143.0])
def test_a_hillside_has_its_height_and_slope(tmp_path: Path, heading_deg: float) -> None:
    pose = seen_from(heading_deg)
    rise = 0.12, -0.09  # 15 percent: 8.5°
    view = read(tmp_path / "map.gpkg", [[(pose, hillside(pose, *rise))]])
    ground, slope = view.layer("ground"), view.layer("slope")
    rows, columns = (np.arange(n) + 0.5 for n in view.window.shape)
    east, north = (view.window.i0 + columns) * 0.2, (view.window.j0 + rows) * 0.2
    expected = rise[0] * east + rise[1] * north[:, None]
    inside = np.isfinite(ground)
    assert inside.sum() > 0.9 * SPEC.width_m * SPEC.length_m / 0.04
    np.testing.assert_allclose(ground[inside], expected[inside], atol=0.025)
    known = np.isfinite(slope)
    assert known.sum() > 0.6 * inside.sum()
    np.testing.assert_allclose(slope[known], math.degrees(math.atan(0.15)), atol=0.8)
    falls_deg = math.degrees(math.atan2(-rise[0], -rise[1]))
    np.testing.assert_allclose(view.layer("aspect")[known], falls_deg, atol=6.0)


def test_a_surer_frame_counts_for_more(tmp_path: Path) -> None:
    sure, unsure = seen_from(0.0, sigma_m=0.02), seen_from(0.0, sigma_m=1.0)
    flat = np.zeros(SPEC.shape, np.int16)
    view = read(tmp_path / "map.gpkg", [[(sure, flat), (unsure, flat + 100)]])
    ground, sigma = view.layer("ground"), view.layer("ground_sigma")
    assert np.nanmax(np.abs(ground - 12.34)) < 0.01
    # Each frame's own sigma, of which the surer one has the greater share.
    assert np.nanmax(sigma) < 0.1
    alone = read(tmp_path / "alone.gpkg", [[(unsure, flat)]]).layer("ground_sigma")
    assert np.nanmin(alone) == pytest.approx(2.0, rel=0.2)


def test_heights_are_the_same_in_any_order_and_without_a_session(tmp_path: Path) -> None:
    poses = [seen_from(10.0 * k, 0.3 * k, 12.0 + 0.1 * k, 0.02 * (k + 1)) for k in range(6)]
    frames = [(pose, hillside(pose, 0.05, 0.1)) for pose in poses]
    other = [(seen_from(77.0, 1.0, 3.0), hillside(seen_from(77.0, 1.0, 3.0), -0.2, 0.3))]
    order = [frames[k] for k in (3, 0, 5, 1, 4, 2)]
    pairs = (
        ([frames], [order], ""),
        ([frames[:2], frames[2:]], [frames[2:], frames[1::-1]], ""),
        ([frames[:2], frames[2:]], [frames[:2], other, frames[2:]], "1"),
    )
    for number, (one, two, without) in enumerate(pairs):
        view = read(tmp_path / f"{number}.gpkg", one)
        same = read(tmp_path / f"{number}_again.gpkg", two, without=without)
        assert np.isfinite(view.layer("slope")).any()
        for name in LAYERS:
            np.testing.assert_array_equal(view.layer(name), same.layer(name))


def level(up_m: float, sigma_m: float = 0.02, cm: int = 0) -> Frame:
    return seen_from(0.0, up_m=up_m, sigma_m=sigma_m), np.full(SPEC.shape, cm, np.int16)


@pytest.mark.parametrize("wrong_m", [0.3, 1.6, -2.5, 50.2])
def test_frames_that_are_wrong_do_not_move_the_ground(tmp_path: Path, wrong_m: float) -> None:
    """Canopy that is taken for ground, or a pose: two of five frames, in one drive."""
    right = [level(10.0 + up_m) for up_m in (-0.01, 0.0, 0.02)]
    wrong = [level(10.0, cm=round(100.0 * wrong_m)), level(10.0 + wrong_m)]
    view = read(tmp_path / "map.gpkg", [[*right, *wrong]])
    ground, sigma = view.layer("ground"), view.layer("ground_sigma")
    assert np.nanmax(np.abs(ground - 10.0)) < 0.021
    # What the frames are apart is in the sigma.
    assert np.nanmin(sigma) > min(0.2 * abs(wrong_m), 3.9)  # 4 m is the widest


@pytest.mark.parametrize("wrong_m", [0.4, 1.7, -3.1, 7.3, 101.8])
def test_a_drive_that_is_wrong_does_not_move_the_ground(tmp_path: Path, wrong_m: float) -> None:
    """However many frames it has, and however sure it is."""
    drives = [[level(10.0 + up_m)] for up_m in (-0.03, 0.01, 0.02)]
    wrong = [level(10.0 + wrong_m, 0.01)] * 5
    view = read(tmp_path / "map.gpkg", [*drives, wrong])
    assert np.nanmax(np.abs(view.layer("ground") - 10.0)) < 0.08
    for cell_m in (0.6, 0.8):  # three and four base cells
        larger = open_map(tmp_path / "map.gpkg").read(cell_m=cell_m, layers=LAYERS)
        assert np.nanmax(np.abs(larger.layer("ground") - 10.0)) < 0.08


def test_drives_that_are_apart_say_so_and_meet_smoothly(tmp_path: Path) -> None:
    """Two of a decimetre receiver: their weighted mean, and a sigma that holds both."""
    view = read(tmp_path / "map.gpkg", [[level(10.0, 0.15)], [level(10.5, 0.15)]])
    ground, sigma = view.layer("ground"), view.layer("ground_sigma")
    known = np.isfinite(ground)
    np.testing.assert_allclose(ground[known], 10.25, atol=0.006)
    assert np.nanmin(sigma) > 0.25
    alone = read(tmp_path / "alone.gpkg", [[level(10.0, 0.15)]]).layer("ground_sigma")
    assert np.nanmin(alone) == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize(
    "heights_m", [(10.1, 14.1, 14.1), (1.0, 9.0), (1.0, 1.0, 1.0, 17.0), (0.0, 0.0, 48.0, 48.0)]
)
def test_what_lies_a_turn_of_the_histogram_apart_is_no_height(
    tmp_path: Path, heights_m: Sequence[float]
) -> None:
    """Drives a multiple of 4 m apart fall into one bin, whose mean may even belong to it."""
    view = read(tmp_path / "map.gpkg", [[level(up_m)] for up_m in heights_m])
    assert np.isnan(view.layer("ground")).all()
    assert np.isnan(view.layer("ground_sigma")).all()


SURE, UNSURE = 1 << 14, 1 << 8  # 3 cm and 25 cm


@pytest.mark.parametrize(
    ("said", "height_m", "sigma_m"),
    [
        ([(0, SURE), (24, SURE)], 0.12, 0.12),  # in one bin
        ([(1, SURE), (25, SURE)], 0.13, 0.178),  # in two
        ([(0, SURE), (0, SURE), (24, SURE)], 0.08, 0.113),
        ([(0, SURE), (0, SURE), (0, SURE), (20, SURE)], 0.05, 0.087),
        ([(10, SURE), (10, SURE), (10, SURE), (30, SURE)], 0.1, 0.1),
        ([(0, SURE), (200, UNSURE)], 0.0, 0.248),  # two are no majority
        ([(0, SURE)] * 3 + [(180, SURE)], 0.0, 0.031),
        ([(-5, SURE)] * 3, -0.05, 0.031),
        ([(100, SURE)] * 3 + [(500, 4)], 1.0, 0.036),  # too little weight to tell, or to matter
        ([(0, UNSURE), (800, UNSURE)], math.nan, math.nan),
        ([(0, SURE)] * 2 + [(1600, SURE), (50, SURE)], math.nan, math.nan),
        ([(0, SURE)] * 4 + [(60, SURE), (460, SURE)], 0.0, 0.031),  # the mixed bin is left out
    ],
)
def test_the_sigma_holds_what_sessions_are_apart(
    said: list[tuple[int, int]], height_m: float, sigma_m: float
) -> None:
    one, other = (_read_of(order) for order in (said, said[::-1]))
    np.testing.assert_array_equal(one, other)
    assert one == pytest.approx((height_m, sigma_m), abs=0.002, nan_ok=True)


def _read_of(said: list[tuple[int, int]]) -> tuple[float, float]:
    """The height and the sigma of sessions that say a height in centimetres, with a weight."""
    cells = {one.name: np.zeros((1, 1), np.int64) for one in GROUP.channels}
    for height_cm, weight in said:
        k = height_cm // BIN_CM % BINS
        for power, name in enumerate(("ground_weight", "ground_cm", "ground_squares")):
            cells[f"{name}_{k}"] += weight * height_cm**power
        cells["ground_sessions"] += 1
    made = with_overviews([GROUP], Cells({n: v.view(np.uint64) for n, v in cells.items()}))
    return GROUND.values(made).item(), SIGMA.values(made).item()


def test_larger_cells_take_one_look_at_the_bins(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = list[Cells]()

    def look(cells: Cells) -> tuple[Float64, Float64]:
        looks.append(cells)
        return _from_bins(cells)

    monkeypatch.setattr(ground, "_from_bins", look)
    assert _read_of([(120, SURE)])[0] == 1.2
    assert len(looks) == 1


def test_squares_of_heights_cost_nothing_where_sessions_agree() -> None:
    """They are stored as what they differ from those of the mean."""
    heights = np.random.default_rng(1).integers(-300, 300, (4, 64, 64))
    weight = np.full((64, 64), 3 * SURE)
    for cm in heights:
        guess = _agreeing(weight.view(np.uint64), (weight * cm).view(np.uint64))
        np.testing.assert_array_equal(guess.view(np.int64), weight * cm * cm)


def test_heights_below_the_datum_keep_their_sign(tmp_path: Path) -> None:
    view = read(tmp_path / "map.gpkg", [[level(-33.27)], [level(-33.31)]], cell_m=0.8)
    ground = view.layer("ground")
    np.testing.assert_allclose(ground[np.isfinite(ground)], -33.29, atol=0.011)


def _heights(found: npt.NDArray[np.int64]) -> Heights:
    heights = Heights(4)
    for part in np.array_split(found, 7):
        heights.add(part)
    return heights


@pytest.mark.parametrize("noise_cm", [3.0, 50.0, 2000.0])
def test_any_number_of_heights_takes_the_same_memory_in_any_order(noise_cm: float) -> None:
    random = np.random.default_rng(0)
    cm = np.rint(random.normal(-120.0, noise_cm, 4000))
    found = np.stack([random.integers(0, 3, 4000), cm, random.integers(8, 15, 4000)], 1)
    heights, again = (_heights(one.astype(np.int64)) for one in (found, random.permutation(found)))
    assert set(vars(heights)) == set(vars(again))
    for name, values in vars(heights).items():
        assert values.size <= 4 * MOST_HEIGHTS, name
    for one, other in zip(heights.settled(), again.settled(), strict=True):
        np.testing.assert_array_equal(one, other)
    seen, weight, height_cm = heights.settled()
    assert seen.tolist() == [1, 1, 1, 0]
    np.testing.assert_allclose(height_cm[:3], -120.0, atol=1.0 + 0.15 * noise_cm)
    sigma_m = WIDEST_SIGMA_M / np.sqrt(weight[:3])
    expected = min(max(0.01 * noise_cm, 0.09), WIDEST_SIGMA_M)
    np.testing.assert_allclose(sigma_m, expected, rtol=0.5)
    steps = 1 << heights._level
    assert np.all(steps[:3] <= max(1.0, noise_cm / 1.5)), steps


def test_few_heights_are_kept_to_the_centimetre() -> None:
    cm = np.array([-700, 1, 2, 2, 3, 10_000])
    heights = _heights(np.stack([np.full(6, 1), cm, np.full(6, 10)], 1))
    assert heights.settled()[2].tolist() == [0, 2, 0, 0]
    assert heights._level[1] == 0


def test_a_large_cell_is_as_sure_as_the_least_sure_part_of_it() -> None:
    """Not as the part that comes last."""
    heights = np.zeros(SPEC.shape, np.int16)
    found = np.empty((1, 3), np.int64)
    block, rises = np.zeros(1, np.int32), np.zeros((1, 3), np.int64)
    places = [(60, 1), (5, 2)]  # far, near
    for order in (places, places[::-1]):
        cell = np.array([[(row << COLUMN_BITS) | column for row, column in order]], np.int32)
        rows = np.repeat(np.arange(13, 9, -1), 20)
        add_terrain(heights, block, cell, rows, 0, 5, 1.0, 0.0, found, rises)
        assert found.tolist() == [[0, 0, rows[60]]]


def test_what_a_frame_lacks_is_not_a_number(tmp_path: Path) -> None:
    pose = seen_from(0.0)
    holed = np.zeros(SPEC.shape, np.int16)
    holed[:40] = NO_GROUND_CM
    view = read(tmp_path / "holed.gpkg", [[(pose, holed)]])
    rows = (view.window.j0 + np.arange(view.window.shape[0]) + 0.5) * 0.2
    ground = view.layer("ground")
    assert np.isnan(ground[rows < 5.9]).all()
    assert np.isfinite(ground[(rows > 6.1) & (rows < 9.9)]).any(axis=1).all()
    old = read(tmp_path / "old.gpkg", [[(pose, None)]])
    assert all(np.isnan(old.layer(name)).all() for name in LAYERS)
    nowhere = read(tmp_path / "nowhere.gpkg", [[(seen_from(0.0, up_m=math.nan), holed * 0)]])
    assert np.isnan(nowhere.layer("ground")).all()


def test_larger_cells_are_the_mean_of_their_base_cells(tmp_path: Path) -> None:
    pose = seen_from(0.0)
    view = read(tmp_path / "map.gpkg", [[(pose, hillside(pose, 0.0, 0.1))]], cell_m=0.8)
    north = (view.window.j0 + np.arange(view.window.shape[0]) + 0.5) * 0.8
    ground = view.layer("ground")
    whole = np.isfinite(ground).sum(axis=1) > 4
    middle = np.nanmedian(ground, axis=1)
    np.testing.assert_allclose(middle[whole][1:-1], 0.1 * north[whole][1:-1], atol=0.02)


@pytest.mark.parametrize("sigma_m", [0.01, 0.02, 0.3, 1.0, 7.0, math.inf])
def test_weights_say_how_sure_a_height_is(sigma_m: float) -> None:
    found = WIDEST_SIGMA_M / np.sqrt(2.0 ** halvings(SPEC, HEIGHT_SHARE * sigma_m))
    y = SPEC.centres_m()[1]
    true = np.sqrt((2.0 * sigma_m) ** 2 + 0.02**2 + (0.004 * y) ** 2)
    np.testing.assert_array_less(np.abs(np.log2(found / np.clip(true, 0.032, 4.0))), 0.51)
    assert np.all(np.diff(found) >= 0.0)


def test_the_height_of_an_aligned_drive_is_no_surer_than_before(tmp_path: Path) -> None:
    pose = seen_from(0.0, sigma_m=0.3)
    path = tmp_path / "map.gpkg"
    before = read(path, [[(pose, hillside(pose, 0.0, 0.0))]]).layer("ground_sigma")
    with open_map(path, writable=True) as universal:
        aligned = AlignmentRecord(0.02, 0.1, ("other",))
        universal.set_transforms({"0": Transform(0.2, aligned=aligned)})
        assert next(iter(universal.frames())).pose.position_sigma_m == 0.02
        after = universal.read(cell_m=0.2, layers=LAYERS).layer("ground_sigma")
    assert np.nanmin(before) > 0.5
    assert np.nanmin(after) == pytest.approx(np.nanmin(before))
