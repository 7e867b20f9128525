"""What moved within one drive: told where it did, and of nothing that was merely hidden or far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

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
)
from fieldgrid.maps.layers import registry
from tests.field.changes.worlds import Box, lane, seen
from tests.maps.file.maps import Frame, write_map

SPEC = GridSpec(width_m=8.0, length_m=10.0, cell_m=0.1)
CRATE = Box(-0.42, 8.03, 0.43, 8.68)
ROW = Box(2.52, 2.0, 3.03, 14.0)
LAYERS = "moved", "lasting"
Worlds = Callable[[int], Sequence[Box]]


def frames_of(poses: Sequence[Pose], world: Worlds, *, beneath: bool = False) -> list[Frame]:
    """What each pose sees of the world as it is when the vehicle is there."""
    return [(seen(world(k), at, SPEC, beneath=beneath), at) for k, at in enumerate(poses)]


def goes_after(count: int) -> Worlds:
    return lambda k: [ROW, CRATE] if k < count else [ROW]


def view_of(path: Path, *drives: list[Frame], **options: object) -> MapView:
    with open_map(write_map(path, drives)) as universal:
        return universal.read(layers=LAYERS, decide="lasting", **options)  # type: ignore[arg-type]


def remaining(view: MapView) -> npt.NDArray[np.uint8]:
    return view.decision().worst


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
    assert not remaining(view)[moved].any()
    others = ~moved & ~within(view, CRATE, 0.3)
    np.testing.assert_array_equal(remaining(view)[others], view.density[others])
    np.testing.assert_array_equal(view.layer("lasting"), view.density)
    assert (remaining(view)[within(view, ROW)] > 100).any()


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
        pytest.param(at_rest(9, HALF_S), lambda k: [CRATE] * (k % 3 == 0), False, id="it flickers"),
    ],
)
def test_what_did_not_move_is_not_said_to(
    tmp_path: Path, poses: list[Pose], world: Worlds, beneath: bool
) -> None:
    view = view_of(tmp_path / "map.gpkg", frames_of(poses, world, beneath=beneath))
    assert not view.layer("moved")[view.density > 0].any()
    np.testing.assert_array_equal(remaining(view), view.density)


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
    assert (remaining(view)[within(view, step(5))] > 100).any()


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
    assert ((remaining(view)[face] > 100) == remains).all()


def test_planners_get_what_remains(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [frames_of(FORTH, goes_after(3))])
    with open_map(path) as universal:
        place = CRATE.west_m + 0.1, CRATE.south_m + 0.05
        assert universal.query(*place).density > 50  # type: ignore[operator]
        assert Costmap.from_map(universal).cost(*place) == 0
        assert Costmap.from_map(universal).cost(ROW.west_m + 0.05, 4.0) == 254
        export_map(universal, tmp_path / "moved.tif", Selection(layer="moved"))


def test_a_post_that_every_other_frame_misses_stays(tmp_path: Path) -> None:
    frames = frames_of(FORTH, lambda k: [ROW, *[CRATE] * (k % 2 == 0)])
    view = view_of(tmp_path / "map.gpkg", frames[:6])
    np.testing.assert_array_equal(remaining(view), view.layer("lasting"))


def test_what_no_frame_saw_through_goes_with_the_thing_that_it_is_part_of(tmp_path: Path) -> None:
    """A wagon is passed by: its far end was seen through when it had gone, its near end never."""
    wagon = Box(1.0, 3.0, 1.5, 9.0)
    frames = frames_of(lane(0.0, count=6, step_m=0.5), lambda k: [wagon] if k < 3 else [])
    blind = [
        (LocalGrid(SPEC, grid.density, grid.observed & (np.arange(SPEC.n_y) > 50)[:, None]), at)
        if k >= 3 else (grid, at)
        for k, (grid, at) in enumerate(frames)
    ]  # fmt: skip
    for grid, _ in blind:
        grid.density[~grid.observed] = 0
    view = view_of(tmp_path / "map.gpkg", blind)
    obstacle = within(view, wagon) & (view.layer("lasting") > 100)
    assert 0.05 < (view.layer("moved") > 0)[obstacle].mean() < 0.9
    assert not remaining(view)[obstacle].any()


def test_maps_of_before_tell_it_from_their_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = [frames_of(FORTH, goes_after(3))]
    before = read_all(write_map(tmp_path / "new.gpkg", drives))
    older = {name: one for name, one in GROUPS.items() if name != "moved"}
    with monkeypatch.context() as then:
        then.setattr(registry, "_GROUPS", older)
        then.setattr(registry, "CORE_GROUPS", ("density", "sessions"))
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
