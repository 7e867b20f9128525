"""What a drive worked: areas by shapely's buffers, repeats, shares of lanes and missed strips."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import shapely

from benchmarks.planting import DATUM
from fieldgrid import find_rows
from fieldgrid.core import ConfigError, FieldgridError
from fieldgrid.field import Planting, Worked, find_worked
from fieldgrid.geometry import Bounds, Status, Trajectory
from fieldgrid.maps import open_map
from tests.field.rows.fields import straight, view_of, write_map

NO_ROWS = Planting(DATUM, Bounds(0.0, 0.0, 1.0, 1.0), 0.1, (), (), (), (), (), ())
Pose = tuple[float, float, float, int]
"""East and north, heading, gear."""


def ahead(start: Pose, length_m: float, step_m: float = 0.5, turn_deg: float = 0.0) -> list[Pose]:
    """Poses on from one, in its gear; the heading turns to the right by so much on the way."""
    east, north, heading, gear = start
    poses = []
    count = math.ceil(length_m / step_m)
    for _ in range(count):
        heading += 0.5 * turn_deg / count
        east += gear * length_m / count * math.sin(math.radians(heading))
        north += gear * length_m / count * math.cos(math.radians(heading))
        heading += 0.5 * turn_deg / count
        poses.append((east, north, heading, gear))
    return poses


def add_drive(
    path: Path,
    poses: Sequence[Pose],
    *,
    name: str = "work",
    rejected: Sequence[int] = (),
    late: Sequence[int] = (),
    sigma_m: float = 0.02,
) -> None:
    """A session without frames; after the poses `late` five seconds pass, else a fifth of one."""
    east, north, heading, gear = (np.array(column) for column in zip(*poses, strict=True))
    n = len(poses)
    waits = np.where(np.isin(np.arange(n), late), 25, 1)
    status = tuple(Status.REJECTED if k in rejected else Status.OK for k in range(n))
    track = Trajectory(
        DATUM, 10**18 + 200_000_000 * np.concatenate([[0], waits[:-1].cumsum()]), east, north,
        np.zeros(n), heading, np.full(n, sigma_m), np.full(n, 0.5), np.full(n, 1.0),
        gear.astype(np.int64), np.full(n, 4), status,
        tuple("leap" if one is Status.REJECTED else "" for one in status), "smooth",
    )  # fmt: skip
    with (
        open_map(path, datum=DATUM, cell_m=0.1) as universal,
        universal.add_session(name, trajectory=track),
    ):
        pass


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """The name of a map that only drives without frames are added to, in cells of 0.1 m."""
    return tmp_path / "bare.gpkg"


def worked(
    path: Path, width_m: float, behind_m: float = 0.0, planting: Planting = NO_ROWS
) -> Worked:
    with open_map(path) as universal:
        found = find_worked(universal, "work", planting, width_m, behind_m)
    # The outlines say what the cells say, but for a quarter of a cell along them.
    for n, area_m2 in enumerate(found.times_m2, 1):
        its = shapely.union_all([area for times, area in found.areas if times == n])
        assert its.area == pytest.approx(area_m2, abs=0.03 * its.length + 0.01)
    return found


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, -143.0])
@pytest.mark.parametrize("behind_m", [0.0, 2.0])
def test_a_straight_drive_works_a_rectangle(
    bare: Path, heading_deg: float, behind_m: float
) -> None:
    start = (3.33, -7.77, heading_deg, 1)
    add_drive(bare, [start, *ahead(start, 20.0)])
    found = worked(bare, 2.0, behind_m)
    assert found.worked_m2 == pytest.approx(40.0, rel=0.01)
    assert found.driven_m == pytest.approx(20.0)
    assert (found.again_m2, found.unknown_m) == (0.0, 0.0)
    way = np.array([start[:2], ahead(start, 20.0)[-1][:2]])
    back = behind_m * np.array(
        [math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))]
    )
    true = shapely.LineString(way - back).buffer(1.0, cap_style="flat")
    ((times, area),) = found.areas
    assert times == 1
    assert shapely.intersection(area, true).area > 0.95 * shapely.union(area, true).area


def test_passes_that_overlap_count_twice_where_they_do(bare: Path) -> None:
    """Up and down again 1.5 m aside with 2 m of width: half a metre is worked twice."""
    start, other = (0.0, 0.0, 0.0, 1), (1.5, 20.0, 180.0, 1)
    add_drive(bare, [start, *ahead(start, 20.0), other, *ahead(other, 20.0)], late=[40])
    found = worked(bare, 2.0)
    assert found.times_m2 == pytest.approx((2 * 20.0 * 1.5, 20.0 * 0.5), rel=0.03)
    assert found.unknown_m == pytest.approx(1.5)
    assert found.driven_m == pytest.approx(40.0)


def test_the_same_ground_three_times(bare: Path) -> None:
    start = (0.0, 0.0, 0.0, 1)
    add_drive(bare, 3 * [start, *ahead(start, 20.0)], late=[40, 81])
    assert worked(bare, 2.0).times_m2 == pytest.approx((0.0, 0.0, 40.0), rel=0.01)


def test_reverse_works_nothing(bare: Path) -> None:
    start = (0.0, 0.0, 0.0, 1)
    forward = [start, *ahead(start, 20.0)]
    back = (*forward[-1][:3], -1)
    add_drive(bare, [*forward, *ahead(back, 30.0)])
    found = worked(bare, 2.0)
    assert found.times_m2 == pytest.approx((40.0,), rel=0.01)
    assert found.driven_m == pytest.approx(20.0)


@pytest.mark.parametrize("radius_m", [0.4, 1.5, 4.0])
def test_a_turn_is_one_pass(bare: Path, radius_m: float) -> None:
    """Three quarters of a circle: also where its middle lies under the implement, which goes over
    the ground on its inner side twice within its width."""
    start = (0.0, 0.0, 0.0, 1)
    add_drive(bare, [start, *ahead(start, 1.5 * math.pi * radius_m, 0.1, 270.0)])
    found = worked(bare, 2.0)
    inner, outer = radius_m - 1.0, radius_m + 1.0
    ring = 0.75 * math.pi * (outer**2 - max(inner, 0.0) ** 2)
    # Beyond the middle the implement reaches over another part of the circle.
    beyond = 0.25 * math.pi * min(inner, 0.0) ** 2
    assert found.worked_m2 == pytest.approx(ring + beyond, rel=0.03)
    assert found.again_m2 < 0.03 * found.worked_m2


def test_a_jump_aside_works_nothing(bare: Path) -> None:
    """Nor does a vehicle that stands, whatever gear is told."""
    start = (0.0, 0.0, 0.0, 1)
    way = ahead(start, 20.0)
    add_drive(bare, [start, *way, way[-1], (5.0, 20.0, 0.0, 1)])
    assert worked(bare, 2.0).worked_m2 == pytest.approx(40.0, rel=0.01)


def test_rejected_poses_are_left_out_and_gaps_are_told(bare: Path) -> None:
    start = (0.0, 0.0, 0.0, 1)
    poses = [start, *ahead(start, 20.0)]
    poses[10] = (300.0, 5.0, 0.0, 1)
    add_drive(bare, poses, rejected=[10], late=[30])
    found = worked(bare, 2.0)
    assert found.worked_m2 == pytest.approx(39.0, rel=0.01)
    assert found.unknown_m == pytest.approx(0.5)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four rows of 30 m; canopies of 0.7 m leave 1.8 m free between them."""
    view = view_of(straight(4, 30.0, 2.5, 25.0))
    return write_map(tmp_path_factory.mktemp("rows") / "field.gpkg", view)


def drive_lanes(planting: Planting, which: Sequence[int], aside_m: float = 0.0) -> list[Pose]:
    """Along the middle of lanes, or to its right, from 2 m before them to 2 m behind."""
    poses: list[Pose] = []
    for k in which:
        (x, y), (to_x, to_y) = np.asarray(planting.lanes[k].line.coords)[[0, -1], :2]
        heading = math.degrees(math.atan2(to_x - x, to_y - y))
        right = np.array([math.cos(math.radians(heading)), -math.sin(math.radians(heading))])
        back = np.array([right[1], -right[0]])
        first = np.array([x, y]) + aside_m * right + 2.0 * back
        start = (float(first[0]), float(first[1]), heading, 1)
        poses += [start, *ahead(start, math.hypot(to_x - x, to_y - y) + 4.0)]
    return poses


def test_shares_of_lanes_and_what_was_missed(rows: Path, tmp_path: Path) -> None:
    planting = find_rows(rows)
    path = tmp_path / "field.gpkg"
    path.write_bytes(rows.read_bytes())
    poses = drive_lanes(planting, [0, 2])
    add_drive(path, poses, late=[len(poses) // 2 - 1])
    found = worked(path, 1.0, planting=planting)
    shares = [lane.share for lane in found.lanes]
    for k, lane in enumerate(planting.lanes):
        canopies = [row for row in planting.rows if row.id in lane.rows]
        free = lane.area.difference(
            shapely.union_all([row.line.buffer(row.half_width_m) for row in canopies])
        )
        assert found.lanes[k].ground_m2 == pytest.approx(free.area, rel=0.02)
        ends = np.asarray(lane.line.coords)[[0, -1], :2]
        beyond = 2.0 * (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        way = shapely.LineString([ends[0] - beyond, ends[1] + beyond])
        strip = way.buffer(0.5, cap_style="flat")
        true = strip.intersection(free).area / free.area if k != 1 else 0.0
        assert shares[k] == pytest.approx(true, abs=0.02)
    assert [lane.missed for lane in found.lanes] == [2, 1, 2]
    assert [lane for lane, _ in found.missed].count("B1-L2") == 1
    for lane, area in found.missed:
        (its,) = (one for one in planting.lanes if one.id == lane)
        assert its.area.buffer(0.1).covers(area)
        if lane != "B1-L2":
            assert area.intersection(its.line.buffer(0.35)).area == pytest.approx(0.0, abs=0.05)
    (block,) = found.blocks
    assert block.share == pytest.approx(
        sum(lane.worked_m2 for lane in found.lanes) / sum(lane.ground_m2 for lane in found.lanes)
    )
    assert block.missed == 5


@pytest.mark.parametrize(("sigma_m", "missed"), [(0.02, 1), (0.3, 0)])
def test_a_strip_that_the_poses_do_not_tell_is_not_missed(
    rows: Path, tmp_path: Path, sigma_m: float, missed: int
) -> None:
    """Nearly the whole lane: 0.3 m remain on its left, less than two sigma of 0.3 m."""
    planting = find_rows(rows)
    path = tmp_path / "field.gpkg"
    path.write_bytes(rows.read_bytes())
    add_drive(path, drive_lanes(planting, [1], 0.3), sigma_m=sigma_m)
    found = worked(path, 1.8, planting=planting)
    assert found.lanes[1].share > 0.75
    assert found.lanes[1].missed == missed
    assert (found.lanes[0].missed, found.lanes[2].missed) == (1, 1)


def test_what_cannot_be_asked(bare: Path) -> None:
    add_drive(bare, [(0.0, 0.0, 0.0, 0), (0.0, 0.0, 0.0, 0)])
    with open_map(bare, writable=True) as universal:
        for width_m, behind_m in ((math.nan, 0.0), (0.0, 0.0), (2.0, math.nan), (2.0, 99.0)):
            with pytest.raises(ConfigError, match="is none; give a width"):
                find_worked(universal, "work", NO_ROWS, width_m, behind_m)
        with pytest.raises(ConfigError, match="worked nothing"):
            find_worked(universal, "work", NO_ROWS, 2.0)
        with pytest.raises(ConfigError, match="no session 'june'"):
            find_worked(universal, "june", NO_ROWS, 2.0)
        with universal.add_session("frames alone"):
            pass
        with pytest.raises(FieldgridError, match="no trajectory stored"):
            find_worked(universal, "frames alone", NO_ROWS, 2.0)
        universal.remove_session("work")
        with pytest.raises(ConfigError, match="'work'"):
            find_worked(universal, "work", NO_ROWS, 2.0)
