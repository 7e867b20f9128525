"""Objects that changed between two drives, in worlds of which everything is known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import beta

from fieldgrid.core import ConfigError
from fieldgrid.field import ChangedObject, Changes, find_changes
from fieldgrid.field.changes import cells
from fieldgrid.field.changes.objects import are_alike, probability
from fieldgrid.field.changes.relative_sigmas import relative_sigmas
from fieldgrid.field.changes.result import ChangeKind
from fieldgrid.maps import (
    AlignmentRecord,
    Change,
    RelativeError,
    Transfer,
    Transform,
    open_map,
    placing,
)
from tests.field.changes.worlds import WIDE, Box, Drive, lane, pose, world_map

ROW = Box(1.2, -1.0, 1.6, 13.0)
CRATE = Box(-1.5, 4.0, -0.7, 4.6)


def changes_of(path: Path, from_: str = "first", to: str = "second", **options: float) -> Changes:
    with open_map(path) as universal:
        return find_changes(universal, from_, to, **options)


def two(
    tmp_path: Path,
    before: list[Box],
    after: list[Box],
    *,
    sigma_m: float = 0.02,
    off_m: tuple[float, float] = (0.0, 0.0),
    transfer: Transfer = Transfer.CENTRE,
) -> Path:
    """A map of the same lane, driven twice."""
    drives: dict[str, Drive] = {
        "first": (before, lane(0.0, sigma_m=sigma_m)),
        "second": (after, lane(0.04, 100, sigma_m=sigma_m)),
    }
    return world_map(tmp_path / "map.gpkg", drives, off_m={"second": off_m}, transfer=transfer)


def only(changes: Changes) -> ChangedObject:
    (found,) = changes
    assert isinstance(found, ChangedObject)
    return found


@pytest.mark.parametrize(
    ("kind", "transfer"),
    [(ChangeKind.APPEARED, Transfer.CENTRE), (ChangeKind.VANISHED, Transfer.AREA)],
)
def test_what_came_or_went_is_one_object(
    tmp_path: Path, kind: ChangeKind, transfer: Transfer
) -> None:
    worlds = [ROW], [ROW, CRATE]
    came = kind is ChangeKind.APPEARED
    found = only(changes_of(two(tmp_path, *(worlds if came else worlds[::-1]), transfer=transfer)))
    assert found.kind is kind
    assert found.confidence > 0.9
    assert math.dist((found.east_m, found.north_m), (-1.1, 4.3)) < 0.2
    assert 0.2 < found.area_m2 < 0.6
    assert 0.7 <= found.length_m <= 1.1
    assert found.width_m <= 0.8
    assert (found.stood, found.freed) == (
        (("second",), ("first",)) if came else (("first",), ("second",))
    )
    assert found.area.contains(found.area.representative_point())
    assert math.isnan(found.from_east_m)


def test_places_are_told_on_earth(tmp_path: Path) -> None:
    changes = changes_of(two(tmp_path, [], [CRATE]))
    found = only(changes)
    east_m, north_m, _ = changes.view.datum.to_enu(
        found.lat_deg, found.lon_deg, changes.view.datum.height_m
    )
    assert (float(east_m), float(north_m)) == pytest.approx((found.east_m, found.north_m), abs=1e-3)


@pytest.mark.parametrize("off_m", [(0.05, 0.0), (-0.05, 0.05), (0.0, -0.06)])
def test_drives_that_lie_apart_by_their_sigma_show_no_object(
    tmp_path: Path, off_m: tuple[float, float]
) -> None:
    path = two(tmp_path, [ROW, CRATE], [ROW, CRATE], sigma_m=0.05, off_m=off_m)
    changes = changes_of(path)
    assert list(changes) == []
    view = changes.view  # the cells alone do
    assert view.area_m2(Change.APPEARED) + view.area_m2(Change.VANISHED) > 0.0


def test_the_less_sure_the_places_the_less_sure_the_change(tmp_path: Path) -> None:
    beside = Box(0.1, 4.0, 0.5, 5.0)  # 0.7 m from the row
    path = two(tmp_path, [ROW], [ROW, beside])
    sure = [
        only(changes_of(path, position_sigma_m=sigma_m, sigmas=0.0, min_confidence=0.0)).confidence
        for sigma_m in (0.0, 0.1, 0.2, 0.4)
    ]
    assert sure == sorted(sure, reverse=True)
    assert sure[0] > 0.9
    assert sure[-1] < 0.8
    assert list(changes_of(path, position_sigma_m=0.3)) == []


def aligned(path: Path, apart_m: float, sigma_m: float = 0.4, **others: Transform) -> None:
    """As alignment leaves two drives: neither is sure of its place, the second beside the first."""
    with open_map(path, writable=True) as universal:
        driven = [frame.driven for frame in universal.frames("first") if frame.accepted]
        beside = RelativeError("first", apart_m, placing(universal.transform("first"), driven))
        found = AlignmentRecord(sigma_m, 0.1, ("first",), None, (beside,))
        universal.set_transforms({"second": Transform(aligned=found), **others})


def test_drives_that_were_aligned_are_as_sure_as_they_lie_beside_each_other(tmp_path: Path) -> None:
    beside = Box(0.1, 4.0, 0.5, 5.0)  # 0.7 m from the row
    path = two(tmp_path, [ROW], [ROW, beside], sigma_m=0.4)
    assert list(changes_of(path)) == []
    aligned(path, 0.05)
    found = only(changes_of(path))
    assert found.kind is ChangeKind.APPEARED
    # All looks err by what is between the drives, and no less.
    assert 0.05 <= found.sigma_m < 0.1
    assert list(changes_of(path, position_sigma_m=0.4)) == []
    # Other names change nothing of it.
    with open_map(path, writable=True) as universal:
        before = universal.transform("second").to_text()
        universal.rename_session("first", "earlier")
        universal.rename_session("second", "later")
        now = universal.transform("later").aligned
        assert now is not None
        assert now.to == ("earlier",)
        assert universal.verify(deep=True).problems == ()
    assert only(changes_of(path, "earlier", "later")).sigma_m == found.sigma_m
    with open_map(path, writable=True) as universal:
        universal.rename_session("earlier", "first")
        universal.rename_session("later", "second")
        assert universal.transform("second").to_text() == before
    # It is worth nothing once the other one lies elsewhere.
    aligned(path, 0.05, first=Transform(0.001))
    assert list(changes_of(path)) == []


def test_what_is_between_drives_is_shared_out_and_no_smaller(tmp_path: Path) -> None:
    for sigma_m, parts in ((0.4, (0.03 / 2**0.5, 0.03 / 2**0.5)), (0.01, (None, None))):
        folder = tmp_path / str(sigma_m)
        folder.mkdir()
        path = two(folder, [ROW], [ROW], sigma_m=sigma_m)
        aligned(path, 0.03, sigma_m)
        with open_map(path) as universal:
            found = relative_sigmas(universal, ["first"], ["second"])
        for name, part in zip(("first", "second"), parts, strict=True):
            if part is None:
                assert name not in found
                continue
            # Not of poses that state much more than the others of their drive.
            asked = [found[name].of(stated_m) for stated_m in (0.001, sigma_m, 2.5 * sigma_m)]
            assert asked == pytest.approx([0.001, part, 2.5 * sigma_m])


def test_the_far_face_of_a_row_is_not_new(tmp_path: Path) -> None:
    """The first drive sees ground beneath the row and behind it, the second its other side."""
    hedge = Box(4.0, -1.0, 4.7, 13.0)
    drives: dict[str, Drive] = {
        "first": ([hedge], lane(0.0, count=3)),
        "second": ([hedge], lane(8.7, 100, count=3)),
    }
    path = world_map(tmp_path / "map.gpkg", drives, spec=WIDE, beneath=True)
    assert list(changes_of(path, min_confidence=0.0)) == []


def test_a_thing_that_moved(tmp_path: Path) -> None:
    there = Box(-1.5, 6.0, -0.7, 6.6)
    found = only(changes_of(two(tmp_path, [ROW, CRATE], [ROW, there])))
    assert found.kind is ChangeKind.MOVED
    assert math.dist((found.east_m, found.north_m), (-1.1, 6.3)) < 0.2
    assert math.dist((found.from_east_m, found.from_north_m), (-1.1, 4.3)) < 0.2
    kinds = [o.kind for o in changes_of(tmp_path / "map.gpkg", moved_m=1.0)]
    assert sorted(kinds) == [ChangeKind.APPEARED, ChangeKind.VANISHED]


def test_a_thing_of_another_size_did_not_move(tmp_path: Path) -> None:
    larger = Box(-1.8, 6.0, -0.6, 7.5)
    found = changes_of(two(tmp_path, [ROW, CRATE], [ROW, larger]))
    assert sorted(o.kind for o in found) == [ChangeKind.APPEARED, ChangeKind.VANISHED]
    assert not are_alike(*found)


@pytest.mark.parametrize("kind", [ChangeKind.GROWN, ChangeKind.CUT_BACK])
def test_a_row_that_grew_or_was_cut_back(tmp_path: Path, kind: ChangeKind) -> None:
    row = ROW._replace(north_m=8.0)  # its end is seen
    worlds = [[row], [row._replace(west_m=0.9)]]
    path = two(tmp_path, *(worlds if kind is ChangeKind.GROWN else worlds[::-1]), sigma_m=0.005)
    found = changes_of(path, sigmas=1.0)
    assert {o.kind for o in found} == {kind}
    assert sum(o.area_m2 for o in found) > 0.5
    # What may grow by less than that appeared.
    far = changes_of(path, sigmas=1.0, growth_m=0.1)
    assert {o.kind for o in far} != {kind}


def test_what_appears_beside_a_row_that_grew_is_kept_apart(tmp_path: Path) -> None:
    after = [ROW._replace(west_m=0.9), Box(0.0, 4.0, 0.9, 4.8)]
    found = changes_of(two(tmp_path, [ROW], after, sigma_m=0.005), sigmas=1.0)
    assert {o.kind for o in found} == {ChangeKind.APPEARED, ChangeKind.GROWN}
    (came,) = [o for o in found if o.kind is ChangeKind.APPEARED]
    assert math.dist((came.east_m, came.north_m), (0.4, 4.4)) < 0.35


def test_frames_of_a_vehicle_at_rest_are_one_look(tmp_path: Path) -> None:
    still = [pose(0.0, 0.013, 0.0, time_ns=k) for k in range(20)]
    later = [pose(0.0, 0.013, 0.0, time_ns=10**12 + k) for k in range(20)]
    path = world_map(tmp_path / "map.gpkg", {"first": ([], still), "second": ([CRATE], later)})
    found = only(changes_of(path))
    assert (found.looks_stood, found.looks_freed) == pytest.approx((1.0, 1.0))
    assert found.confidence == pytest.approx(probability(1.0, 0.0) ** 2, abs=1e-6)
    assert found.confidence < 0.9


def test_of_each_side_the_latest_drive_counts(tmp_path: Path) -> None:
    drives: dict[str, Drive] = {
        "a": ([CRATE], lane(0.0)),
        "b": ([], lane(0.04, 100)),
        "c": ([CRATE], lane(0.02, 200)),
        "d": ([CRATE], lane(0.0, 300)),
    }
    path = world_map(tmp_path / "map.gpkg", drives)
    assert only(changes_of(path, "a", "b")).kind is ChangeKind.VANISHED
    found = only(changes_of(path, "b", "d"))
    assert found.kind is ChangeKind.APPEARED
    assert "d" in found.stood
    assert "a" not in found.stood
    assert found.freed == ("b",)
    assert list(changes_of(path, "a", "d")) == []


def test_cells_of_another_size(tmp_path: Path) -> None:
    path = two(tmp_path, [ROW], [ROW, CRATE])
    found = only(changes_of(path, cell_m=0.2))
    assert math.dist((found.east_m, found.north_m), (-1.1, 4.3)) < 0.2
    assert changes_of(path, cell_m=0.2).view.lattice.cell_m == 0.2


def test_objects_do_not_end_at_the_squares_that_are_worked_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = two(tmp_path, [ROW], [ROW, CRATE])
    whole = only(changes_of(path))
    monkeypatch.setattr(cells, "SQUARE_CELLS", 4)
    parts = only(changes_of(path))
    assert parts.area.equals(whole.area)
    assert (parts.confidence, parts.away_m) == pytest.approx((whole.confidence, whole.away_m))


def test_least_area_and_confidence(tmp_path: Path) -> None:
    path = two(tmp_path, [], [CRATE])
    found = only(changes_of(path))
    assert list(changes_of(path, min_area_m2=found.area_m2 + 0.011)) == []
    assert len(changes_of(path, min_area_m2=found.area_m2)) == 1
    assert list(changes_of(path, min_confidence=found.confidence + 1e-6)) == []


def test_frames_that_do_not_say_how_sure_they_are(tmp_path: Path) -> None:
    path = two(tmp_path, [], [CRATE], sigma_m=math.nan)
    with pytest.raises(ConfigError, match=r"does not say how sure its pose is.*position-sigma"):
        changes_of(path)
    assert only(changes_of(path, position_sigma_m=0.02)).kind is ChangeKind.APPEARED


@pytest.mark.parametrize(
    "options",
    [
        {"min_area_m2": -1.0},
        {"min_confidence": 1.5},
        {"sigmas": math.nan},
        {"growth_m": -0.1},
        {"moved_m": math.inf},
        {"position_sigma_m": -0.1},
    ],
)
def test_settings_that_cannot_be(tmp_path: Path, options: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="is outside 0"):
        changes_of(two(tmp_path, [], [CRATE]), **options)


@given(st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_the_probability_is_that_of_jeffreys(most: float, least: float) -> None:
    expected = float(beta.sf(0.5, most + 0.5, least + 0.5))
    assert probability(most, least) == pytest.approx(expected, abs=1e-9)
    assert probability(most, least) + probability(least, most) == pytest.approx(1.0)
    assert probability(most + 1.0, least) >= probability(most, least)


def test_a_table_for_notebooks(tmp_path: Path) -> None:
    changes = changes_of(two(tmp_path, [], [CRATE]))
    assert "appeared" in changes._repr_html_()
    assert changes[0] is changes.objects[0]
    assert np.isfinite(changes[0].heading_deg)
