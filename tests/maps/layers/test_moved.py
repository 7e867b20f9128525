"""What moved within one drive: told where it did, and of nothing that was merely hidden or far."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

from fieldgrid.export import Selection, export_map
from fieldgrid.geometry import GridSpec, Lattice, LocalGrid, Pose, Window
from fieldgrid.maps import (
    GROUPS,
    Costmap,
    FrameCells,
    MapView,
    Transfer,
    WindowFold,
    open_map,
    to_local,
)
from fieldgrid.maps.layers import registry
from tests.field.changes.worlds import Box, lane, seen
from tests.maps.file.maps import Frame, write_map

SPEC = GridSpec(width_m=8.0, length_m=10.0, cell_m=0.1)
CRATE = Box(-0.42, 8.03, 0.43, 8.68)
ROW = Box(2.52, 2.0, 3.03, 14.0)
LAYERS = "moved", "lasting", "remaining"
Worlds = Callable[[int], Sequence[Box]]


def frames_of(poses: Sequence[Pose], world: Worlds, *, beneath: bool = False) -> list[Frame]:
    """What each pose sees of the world as it is when the vehicle is there."""
    return [(seen(world(k), at, SPEC, beneath=beneath), at) for k, at in enumerate(poses)]


def goes_after(count: int) -> Worlds:
    return lambda k: [ROW, CRATE] if k < count else [ROW]


def view_of(path: Path, *drives: list[Frame], **options: object) -> MapView:
    with open_map(write_map(path, drives)) as universal:
        return universal.read(layers=LAYERS, **options)  # type: ignore[arg-type]


def within(view: MapView, box: Box, more_m: float = 0.0) -> npt.NDArray[np.bool_]:
    """The cells of a view whose middle is in a box, which grows by so much on each side."""
    rows, columns = np.indices(view.density.shape)
    larger = Box(
        box.west_m - more_m, box.south_m - more_m, box.east_m + more_m, box.north_m + more_m
    )
    return larger.holds(
        (columns + view.window.i0 + 0.5) * view.lattice.cell_m,
        (rows + view.window.j0 + 0.5) * view.lattice.cell_m,
    )


def test_what_stood_in_the_first_frames_and_went_is_left_out(tmp_path: Path) -> None:
    view = view_of(tmp_path / "map.gpkg", frames_of(lane(0.0, count=7), goes_after(3)))
    moved = view.layer("moved") > 0
    face = within(view, CRATE, -0.1) & (view.layer("lasting") > 50)
    assert face.sum() > 20
    assert moved[face].all()
    assert not moved[~within(view, CRATE, 0.1)].any()
    assert not view.layer("remaining")[moved].any()
    np.testing.assert_array_equal(view.layer("remaining")[~moved], view.density[~moved])
    np.testing.assert_array_equal(view.layer("lasting"), view.density)
    assert (view.layer("remaining")[within(view, ROW)] > 100).any()


AFAR = Box(CRATE.west_m, CRATE.south_m + 0.4, CRATE.east_m, CRATE.north_m + 0.4)
SCREEN = Box(-2.02, 7.23, 2.03, 7.43)
FORTH = lane(0.0, count=7)
HALF_S = 500_000_000


def back_up() -> list[Pose]:
    """Past the same places in the other order, the vehicle looking ahead."""
    return [
        replace(at, time_ns=k * 10**9) for k, at in enumerate([*FORTH[3:6], *reversed(FORTH[:3])])
    ]


def at_rest(count: int, apart_ns: int) -> list[Pose]:
    return [replace(FORTH[3], time_ns=k * apart_ns) for k in range(count)]


@pytest.mark.parametrize(
    ("poses", "world", "beneath"),
    [
        pytest.param(FORTH, lambda _: [ROW, CRATE], False, id="it stays"),
        pytest.param(FORTH[:4], goes_after(3), False, id="one clear look"),
        pytest.param(
            FORTH, lambda k: [ROW, CRATE, *[SCREEN] * (k >= 3)], False, id="behind another"
        ),
        pytest.param(
            FORTH, lambda k: [ROW, *([CRATE] if k < 3 else [SCREEN])], True, id="rays below another"
        ),
        pytest.param(FORTH, lambda k: [ROW, AFAR if k < 3 else CRATE], False, id="off from afar"),
        pytest.param(FORTH, lambda k: [CRATE, *[AFAR] * (k < 3)], False, id="longer from afar"),
        pytest.param(back_up(), goes_after(3), False, id="free from farther"),
        pytest.param(
            FORTH, lambda k: [CRATE] if k not in (2, 3) else [], False, id="it comes back"
        ),
        pytest.param(at_rest(8, 10**8), goes_after(4), False, id="images of one moment"),
        pytest.param(at_rest(9, HALF_S), lambda k: [CRATE] * (k % 3 == 0), False, id="it flickers"),
    ],
)
def test_what_did_not_move_is_not_said_to(
    tmp_path: Path, poses: list[Pose], world: Worlds, beneath: bool
) -> None:
    view = view_of(tmp_path / "map.gpkg", frames_of(poses, world, beneath=beneath))
    assert (view.density > 0).any()
    assert not view.layer("moved").any()
    np.testing.assert_array_equal(view.layer("remaining"), view.density)


def test_ground_around_that_was_not_seen_may_hold_it(tmp_path: Path) -> None:
    frames = frames_of(FORTH, goes_after(3))
    blind = []
    for k, (grid, at) in enumerate(frames):
        rows = np.arange(SPEC.n_y) * SPEC.cell_m + at.north_m
        unseen = np.zeros(SPEC.shape, dtype=np.bool_)
        if k >= 3:
            unseen[rows > CRATE.south_m - 0.2] = True
        observed = grid.observed & ~unseen
        blind.append((LocalGrid(SPEC, grid.density * observed, observed), at))
    assert not view_of(tmp_path / "map.gpkg", blind).layer("moved").any()


def test_who_walks_leaves_no_trail(tmp_path: Path) -> None:
    """A person crosses before a vehicle at rest, a step a second, and stands still at the end."""

    def step(k: int) -> Box:
        west_m = -3.0 + 0.9 * min(k, 5)
        return Box(west_m, 6.03, west_m + 0.4, 6.43)

    poses = [replace(FORTH[1], time_ns=k * 10**9) for k in range(12)]
    view = view_of(tmp_path / "map.gpkg", frames_of(poses, lambda k: [step(k)]))
    moved = view.layer("moved") > 0
    for k in range(4):  # the step before the last is too near to where the person stands
        assert moved[within(view, step(k), -0.1)].sum() >= 4
    assert not moved[within(view, step(5), 0.1)].any()
    assert (view.layer("remaining")[within(view, step(5))] > 100).any()


@pytest.mark.parametrize("transfer", Transfer)
def test_it_depends_on_no_order_and_leaves_without_a_trace(
    tmp_path: Path, transfer: Transfer
) -> None:
    one = frames_of(FORTH, goes_after(3))
    other = frames_of([replace(at, time_ns=at.time_ns + 10**12) for at in FORTH], goes_after(0))
    path = write_map(tmp_path / "map.gpkg", [one, other], transfer=transfer)
    shuffled = [[one[k] for k in (4, 0, 6, 2, 5, 1, 3)], other[::-1]]
    again = write_map(tmp_path / "again.gpkg", shuffled[::-1], transfer=transfer)

    def views(at: Path) -> list[npt.NDArray[np.uint8]]:
        with open_map(at) as universal:
            sizes = [universal.read(cell_m=cell_m, layers=LAYERS) for cell_m in (0.1, 0.4, 0.25)]
        return [view.layer(name) for view in sizes for name in LAYERS]

    before = views(path)
    assert all(layer.any() for layer in before)
    for mine, theirs in zip(before, views(again), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    with open_map(path, writable=True) as universal:
        root = universal.root_sha256
        assert universal.verify(deep=True).sound
        universal.remove_session("0")
        assert universal.verify(deep=True).sound
        assert not universal.read(layers=["moved"]).layer("moved").any()
        universal.restore_session("0")
        assert universal.verify(deep=True).sound
        assert universal.root_sha256 == root
        universal.repair()
        assert universal.root_sha256 == root
    for mine, theirs in zip(before, views(path), strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_frames_of_one_moment_come_in_any_order() -> None:
    frames = [
        (grid, replace(at, time_ns=at.time_ns // 2 // 10**9 * 10**9))
        for grid, at in frames_of(lane(0.0, count=8, step_m=0.63), goes_after(3))
    ]

    def channels(chosen: Sequence[Frame]) -> npt.NDArray[np.uint64]:
        fold = WindowFold(Lattice(0.1), WINDOW, Transfer.CENTRE, FOLDED)
        for grid, at in chosen:
            fold.add(FrameCells(grid, {}), at)
        return np.asarray(fold.cells()["moved_drives"])

    found = channels(frames)
    assert found.any()
    swapped = [frames[k ^ 1] for k in range(len(frames))]
    np.testing.assert_array_equal(found, channels(swapped))


WINDOW = Window(-60, -20, 120, 200)
FOLDED = GROUPS["density"], GROUPS["moved"]


@pytest.mark.parametrize(("transfer", "cell_m"), [(Transfer.CENTRE, 0.1), (Transfer.AREA, 0.25)])
def test_the_rule_cell_by_cell(transfer: Transfer, cell_m: float) -> None:
    """Frames with things that come and go anywhere, against the rule in plain words."""
    random = np.random.default_rng(5)
    things = [Box(x, y, x + 0.5, y + 0.5) for x, y in random.uniform((-3, 3), (3, 9), (9, 2))]
    until = random.integers(0, 16, len(things))
    there = (np.arange(16)[:, None] < until) | (random.random((16, len(things))) < 0.05)
    poses = [
        replace(at, time_ns=int(k * 0.4e9), heading_deg=3.0 * (k % 3))
        for k, at in enumerate(lane(0.013, count=16, step_m=0.11))
    ]
    frames = frames_of(
        poses,
        lambda k: [thing for thing, is_there in zip(things, there[k], strict=True) if is_there],
    )
    fold, lattice = WindowFold(Lattice(cell_m), WINDOW, transfer, FOLDED), Lattice(cell_m)
    told = [Told() for _ in range(WINDOW.width * WINDOW.height)]
    for grid, at in frames:
        fold.add(FrameCells(grid, {}), at)
        tell(told, grid, at, lattice)
    seen = fold.cells().observed.ravel()
    expected = seen & [one.clear >= 2 and one.clear + one.stood >= 4 for one in told]
    assert expected.sum() > 20
    np.testing.assert_array_equal(fold.cells()["moved_drives"].ravel(), expected)


@pytest.mark.parametrize("heading_deg", [50.0, 200.0])
def test_the_rule_whichever_way_a_frame_looks_and_up_to_its_edges(heading_deg: float) -> None:
    """Blots anywhere in the frame, most of them in the first frames only."""
    random = np.random.default_rng(8)
    spec, lattice = GridSpec(10.0, 15.0, 0.05), Lattice(0.1)
    corners = random.integers(0, (spec.n_y - 3, spec.n_x - 3), (60, 2))
    corners[:8, 1], corners[8:16, 1] = 0, spec.n_x - 4
    fold = WindowFold(lattice, WINDOW, Transfer.CENTRE, FOLDED)
    told = [Told() for _ in range(WINDOW.width * WINDOW.height)]
    for k, at in enumerate(lane(0.0, count=7, step_m=0.07)):
        grid = LocalGrid(spec, np.zeros(spec.shape, np.uint8), random.random(spec.shape) < 0.8)
        for j, i in corners[: 60 if k < 3 else 3]:
            grid.density[j : j + 4, i : i + 4] = random.choice([60, 200])
            grid.observed[j : j + 4, i : i + 4] = True
        grid.density[~grid.observed] = 0
        pose = replace(at, north_m=8.0, time_ns=int(k * 0.6e9), heading_deg=heading_deg + k)
        fold.add(FrameCells(grid, {}), pose)
        tell(told, grid, pose, lattice)
    seen = fold.cells().observed.ravel()
    expected = seen & [one.clear >= 2 and one.clear + one.stood >= 4 for one in told]
    assert expected.sum() > 20
    np.testing.assert_array_equal(fold.cells()["moved_drives"].ravel(), expected)


class Told:
    """What is known of one cell."""

    def __init__(self) -> None:
        self.stood = self.clear = 0
        self.near_m = math.inf
        self.stood_ns = self.clear_ns = -(10**12)


def tell(told: list[Told], grid: LocalGrid, at: Pose, lattice: Lattice) -> None:
    """Add a frame by the rule: what lies at the middle of each cell."""
    rows, columns = np.indices(WINDOW.shape)
    east_m, north_m = (
        (columns + WINDOW.i0 + 0.5) * lattice.cell_m, (rows + WINDOW.j0 + 0.5) * lattice.cell_m
    )  # fmt: skip
    x, y = to_local(east_m.ravel(), north_m.ravel(), at)
    spec = grid.spec
    around = int(0.71 * lattice.cell_m / spec.cell_m + 0.5)
    square = np.ones((2 * around + 1, 2 * around + 1), dtype=np.int64)
    stands, hits = (
        ndimage.convolve(
            (grid.observed & (grid.density > above)).astype(np.int64), square, mode="constant"
        )
        for above in (50, 100)
    )
    for k, one in enumerate(told):
        r, c = math.floor(y[k] / spec.cell_m), math.floor(x[k] / spec.cell_m + spec.n_x / 2)
        if not (0 <= r < spec.n_y and 0 <= c < spec.n_x):
            continue
        away_m = math.hypot(x[k], y[k])
        if stands[r, c]:
            if one.clear:
                one.stood, one.near_m = 0, math.inf
                one.stood_ns = -(10**12)
            one.clear = 0
            if hits[r, c] >= 3:
                one.near_m = min(one.near_m, away_m)
                if at.time_ns - one.stood_ns >= HALF_S:
                    one.stood, one.stood_ns = one.stood + 1, at.time_ns
        elif (
            one.stood
            and (one.clear == 0 or at.time_ns - one.clear_ns >= HALF_S)
            and 2.0 <= away_m <= 1.1 * np.float32(one.near_m)
            and is_clear(grid, (r, c), float(x[k]), float(y[k]))
        ):
            one.clear, one.clear_ns = one.clear + 1, at.time_ns


def is_clear(grid: LocalGrid, place: tuple[int, int], x_m: float, y_m: float) -> bool:
    """Whether nothing stands within the margin or in the line of sight, and half was seen."""
    spec, away_m = grid.spec, math.hypot(x_m, y_m)
    margin = (0.3 + 0.05 * away_m) / spec.cell_m
    reach = int(margin) + 1
    j, i = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = j**2 + i**2 <= margin**2
    j, i = j[disc] + place[0], i[disc] + place[1]
    inside = (j >= 0) & (j < spec.n_y) & (i >= 0) & (i < spec.n_x)
    seen = grid.observed[j[inside], i[inside]]
    if (grid.density[j[inside], i[inside]][seen] > 50).any() or seen.sum() < 0.5 * disc.sum():
        return False
    steps = int(0.4 * away_m / spec.cell_m) + 1
    shares = 1.0 - 0.2 * np.arange(1, steps + 1) / steps
    j = (y_m * shares / spec.cell_m).astype(int)
    i = np.floor(x_m * shares / spec.cell_m + spec.n_x / 2).astype(int)
    return not (grid.observed[j, i] & (grid.density[j, i] > 100)).any()


@pytest.mark.parametrize(
    ("others", "remains"),
    [((), False), (("free",), False), (("stands",), False), (("stands", "stands"), True),
     (("stands", "free", "stands", "free"), False)],
)  # fmt: skip
def test_other_drives_may_say_that_it_remains(
    tmp_path: Path, others: tuple[str, ...], remains: bool
) -> None:
    drives = [frames_of(FORTH, goes_after(3))]
    for n, one in enumerate(others, 1):
        poses = [replace(at, time_ns=at.time_ns + n * 10**12) for at in FORTH]
        drives.append(frames_of(poses, goes_after(99 if one == "stands" else 0)))
    view = view_of(tmp_path / "map.gpkg", *drives)
    face = (view.layer("moved") > 0) & within(view, CRATE, -0.1) & (view.density > 30)
    assert face.sum() > 10
    assert ((view.layer("remaining")[face] > 100) == remains).all()


def test_planners_get_what_remains(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [frames_of(FORTH, goes_after(4))])
    place = 0.05, 8.15
    with open_map(path) as universal:
        assert Costmap.from_map(universal).cost(*place) == 254
        assert Costmap.from_map(universal, layer="remaining").cost(*place) == 0
        out = tmp_path / "remaining.yaml"
        export_map(universal, out, Selection(layer="remaining"))
        assert json.loads((tmp_path / "remaining.georef.json").read_text())["layer"] == "remaining"
        export_map(universal, tmp_path / "moved.tif", Selection(layer="moved"))


def test_maps_of_before_tell_it_from_their_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = [frames_of(FORTH, goes_after(3))]
    before = read_all(write_map(tmp_path / "new.gpkg", drives))
    older = {name: one for name, one in GROUPS.items() if name not in ("moved", "remaining")}
    with monkeypatch.context() as then:
        then.setattr(registry, "_GROUPS", older)
        path = write_map(tmp_path / "old.gpkg", drives)
    for repaired in (False, True):
        for mine, theirs in zip(before, read_all(path), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        with open_map(path, writable=True) as universal:
            assert universal.verify(deep=True).sound
            if not repaired:
                universal.repair()


def read_all(path: Path) -> list[npt.NDArray[np.uint8]]:
    with open_map(path) as universal:
        sizes = [universal.read(cell_m=cell_m, layers=LAYERS) for cell_m in (0.1, 0.2, 1.2)]
    return [view.layer(name) for view in sizes for name in LAYERS]
