"""Copies, and several maps as one."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest

from fieldgrid.core import ConfigError, DatumError, MapError, MapExistsError
from fieldgrid.geometry import Datum
from fieldgrid.maps import (
    AlignmentRecord,
    HeightCorrection,
    Mark,
    MarkKind,
    RelativeError,
    Transfer,
    Transform,
    Wander,
    create_map,
    merge_maps,
    open_map,
    placing,
)
from fieldgrid.maps.writing.redatum import Redatum
from tests.maps.file.content import content
from tests.maps.file.maps import DATUM, drive, track, write_map, write_session

FAR = Datum(DATUM.lat_deg + 0.02, DATUM.lon_deg - 0.05, DATUM.height_m - 31.0)
"""Some kilometres from `DATUM`."""


@pytest.fixture
def north(tmp_path: Path) -> Path:
    return write_map(
        tmp_path / "north.gpkg", [drive(5), drive(3, heading_deg=99.0)], trajectory=track(5)
    )


def test_a_copy_is_the_map(north: Path, tmp_path: Path) -> None:
    merged = merge_maps([north], tmp_path / "copy.gpkg")
    assert [(one.was, one.name, one.twin) for one in merged] == [("0", "0", None), ("1", "1", None)]
    assert content(tmp_path / "copy.gpkg") == content(north)
    with open_map(north) as a, open_map(tmp_path / "copy.gpkg") as b:
        assert a.sessions() == b.sessions()
        assert list(a.frames()) == list(b.frames())
        assert b.verify(deep=True).sound


def test_a_copy_leaves_removed_sessions_behind(north: Path, tmp_path: Path) -> None:
    with open_map(north, writable=True) as universal:
        universal.remove_session("0")
    merge_maps([north], tmp_path / "copy.gpkg")
    assert content(tmp_path / "copy.gpkg") == content(north)
    with open_map(tmp_path / "copy.gpkg") as copy:
        assert [info.name for info in copy.sessions()] == ["1"]
    with open_map(north, writable=True) as universal:
        universal.remove_session("1")
    with pytest.raises(ConfigError, match="no session to copy"):
        merge_maps([north], tmp_path / "none.gpkg")
    assert not (tmp_path / "none.gpkg").exists()


def test_two_maps_together_are_the_map_of_all_their_sessions(north: Path, tmp_path: Path) -> None:
    with create_map(tmp_path / "south.gpkg", DATUM, cell_m=0.1) as universal:
        write_session(universal, "x", drive(4, heading_deg=-150.0))
        write_session(universal, "0", drive(2, heading_deg=11.0))
        write_session(universal, "same", drive(3, heading_deg=99.0), track(5))
    merged = merge_maps([north, tmp_path / "south.gpkg"], tmp_path / "farm.gpkg")
    assert [(one.was, one.name, one.twin) for one in merged] == [
        ("0", "0", None),
        ("1", "1", None),
        ("x", "x", None),
        ("0", "0 (south)", None),
        ("same", "1", "1"),
    ]
    with create_map(tmp_path / "at_once.gpkg", DATUM, cell_m=0.1) as universal:
        write_session(universal, "0", drive(5), track(5))
        write_session(universal, "1", drive(3, heading_deg=99.0), track(5))
        write_session(universal, "x", drive(4, heading_deg=-150.0))
        write_session(universal, "0 (south)", drive(2, heading_deg=11.0))
    assert content(tmp_path / "farm.gpkg") == content(tmp_path / "at_once.gpkg")


def test_a_merged_map_can_have_other_cells_and_another_rule(north: Path, tmp_path: Path) -> None:
    out = tmp_path / "coarse.gpkg"
    merge_maps([north], out, cell_m=0.37, transfer=Transfer.AREA)
    with open_map(north) as fine, open_map(out) as coarse:
        assert (coarse.cell_m, coarse.transfer) == (0.37, Transfer.AREA)
        bounds = coarse.bounds
        expected = fine.read(bounds, 0.37, transfer=Transfer.AREA)
        view = coarse.read(bounds)
        np.testing.assert_array_equal(view.density, expected.density)
        np.testing.assert_array_equal(view.observed, expected.observed)
    with pytest.raises(ConfigError, match="smaller than the local cells"):
        merge_maps([north], tmp_path / "fine.gpkg", cell_m=0.05)
    assert not (tmp_path / "fine.gpkg").exists()


def test_maps_of_two_datums_do_not_merge(north: Path, tmp_path: Path) -> None:
    elsewhere = Datum(DATUM.lat_deg + 1e-5, DATUM.lon_deg, DATUM.height_m)
    with create_map(tmp_path / "south.gpkg", elsewhere, cell_m=0.1) as universal:
        write_session(universal, "0", drive(2))
    with pytest.raises(DatumError, match=r"south\.gpkg has the datum .*--datum-from .*north"):
        merge_maps([north, tmp_path / "south.gpkg"], tmp_path / "farm.gpkg")
    assert not (tmp_path / "farm.gpkg").exists()


def test_what_is_not_there_or_in_the_way_is_said(north: Path, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="There is no map"):
        merge_maps([north, tmp_path / "none.gpkg"], tmp_path / "farm.gpkg")
    with pytest.raises(ConfigError, match="no map to merge"):
        merge_maps([], tmp_path / "farm.gpkg")
    with pytest.raises(MapExistsError):
        merge_maps([north], north)
    before = north.read_bytes()
    with pytest.raises(MapExistsError, match="is read here and never replaced"):
        merge_maps([north], north, overwrite=True)
    assert north.read_bytes() == before


def test_one_drive_in_two_places_is_not_merged(north: Path, tmp_path: Path) -> None:
    shutil.copy(north, tmp_path / "south.gpkg")
    with open_map(tmp_path / "south.gpkg", writable=True) as universal:
        universal.set_transform("1", 0.5, 0.0)
    maps = [north, tmp_path / "south.gpkg"]
    with pytest.raises(ConfigError, match=r"'1' of .*south.*is the same drive as '1'.*--shift"):
        merge_maps(maps, tmp_path / "farm.gpkg")
    assert not (tmp_path / "farm.gpkg").exists()
    with open_map(north, writable=True) as universal:
        universal.set_transform("1", 0.5, 0.0)
    assert [one.twin for one in merge_maps(maps, tmp_path / "farm.gpkg")] == [None, None, "0", "1"]


HEIGHTS = {"higher": HeightCorrection((0,), (0.3,)), "as high": HeightCorrection((0,), (0.01,))}

BENT = Wander((10**9, 2 * 10**9), (0.0, 0.2), (0.0, 0.0))


@pytest.mark.parametrize("far", [False, True], ids=["one datum", "another datum"])
@pytest.mark.parametrize(
    ("elsewhere", "why"),
    [
        (Transform(heights=HEIGHTS["higher"]), r"lies up to 0\.30 m higher or lower"),
        (Transform(wander=BENT), r"lies up to 0\.20 m aside"),
        (Transform(heights=HEIGHTS["as high"]), None),
    ],
    ids=["height", "wander", "a centimetre"],
)
def test_one_drive_aligned_in_one_map_only(
    north: Path, tmp_path: Path, elsewhere: Transform, why: str | None, far: bool
) -> None:
    merge_maps([north], tmp_path / "south.gpkg", datum=FAR if far else None)
    with open_map(tmp_path / "south.gpkg", writable=True) as universal:
        universal.set_transforms({"1": elsewhere})
    maps, out = [north, tmp_path / "south.gpkg"], tmp_path / "farm.gpkg"
    if why is None:
        assert [one.twin for one in merge_maps(maps, out, datum=DATUM)] == [None, None, "0", "1"]
        return
    with pytest.raises(ConfigError, match=rf"'1' of .*south.* '1'.*{why}.*align --undo"):
        merge_maps(maps, out, datum=DATUM)


@pytest.mark.parametrize("more_m", [0.0, 0.06])
def test_a_drive_that_was_shifted_before_it_came_into_a_leaning_plane_is_the_same_drive(
    north: Path, tmp_path: Path, more_m: float
) -> None:
    """A shift stays level: 5 km apart it rises by 0.8 mm a metre, and so may differ by 5 cm."""
    with open_map(north, writable=True) as universal:
        universal.set_transform("1", -27.0, 14.0)
    merge_maps([north], tmp_path / "far.gpkg", datum=FAR)
    maps, out = [north, tmp_path / "far.gpkg"], tmp_path / "both.gpkg"
    if not more_m:
        for k, order in enumerate((maps, maps[::-1])):
            merged = merge_maps(order, tmp_path / f"{k}.gpkg", datum=DATUM)
            assert [one.twin for one in merged] == [None, None, "0", "1"]
        return
    with open_map(north, writable=True) as universal:
        universal.set_transform("1", -27.0, 14.0 + more_m)
    with pytest.raises(ConfigError, match=r"'1' .* lies up to 0\.06 m aside"):
        merge_maps(maps, out, datum=DATUM)


def test_a_drive_without_heights_is_the_same_drive_in_two_planes(tmp_path: Path) -> None:
    """Its poses are level with the datum of each map, which are some metres apart."""
    frames = [(grid, replace(pose, up_m=0.0)) for grid, pose in drive(5)]
    far = [(grid, replace(Redatum(DATUM, FAR).pose(pose), up_m=0.0)) for grid, pose in frames]
    write_map(tmp_path / "north.gpkg", [frames])
    with create_map(tmp_path / "far.gpkg", FAR, cell_m=0.1) as universal:
        write_session(universal, "0", far)
    maps = [tmp_path / "north.gpkg", tmp_path / "far.gpkg"]
    assert [one.twin for one in merge_maps(maps, tmp_path / "both.gpkg", datum=DATUM)] == [
        None,
        "0",
    ]


def lie_beside(path: Path, sigma_m: float) -> None:
    """As alignment leaves two sessions, each sure beside the other."""
    with open_map(path, writable=True) as universal:
        names = [info.name for info in universal.sessions()]
        rigid = {name: Transform(0.1, -0.2 * k, 0.5) for k, name in enumerate(names)}
        placings = {
            name: placing(to, (f.driven for f in universal.frames(name) if f.accepted))
            for name, to in rigid.items()
        }
        for name, other in (names, names[::-1]):
            found = AlignmentRecord(
                0.4, 0.1, (other,), None, (RelativeError(other, sigma_m, placings[other]),)
            )
            rigid[name] = replace(rigid[name], aligned=found)
        universal.set_transforms(rigid)


def told_beside(path: Path) -> dict[str, tuple[tuple[str, ...], list[tuple[str, float, bool]]]]:
    """Of each session those that it was aligned to, and how sure it lies beside others: their
    names, sigmas, and whether they lie where they lay."""
    found = {}
    with open_map(path) as universal:
        now = {
            info.name: placing(
                info.transform, (f.driven for f in universal.frames(info.name) if f.accepted)
            )
            for info in universal.sessions()
        }
        for info in universal.sessions():
            aligned = info.transform.aligned
            assert aligned is not None
            beside = [(b.name, b.sigma_m, now[b.name] == b.placing) for b in aligned.beside]
            found[info.name] = (aligned.to, beside)
    return found


@pytest.mark.parametrize("moved", [False, True], ids=["one datum", "another datum"])
def test_sessions_stay_sure_beside_others_under_new_names(
    north: Path, tmp_path: Path, moved: bool
) -> None:
    with create_map(tmp_path / "south.gpkg", DATUM, cell_m=0.1) as universal:
        write_session(universal, "1", drive(4, heading_deg=-150.0))
        write_session(universal, "0", drive(2, heading_deg=11.0))
    lie_beside(north, 0.03)
    lie_beside(tmp_path / "south.gpkg", 0.05)
    out, datum = tmp_path / "farm.gpkg", FAR if moved else None
    merge_maps([north, tmp_path / "south.gpkg"], out, datum=datum)
    assert told_beside(out) == {
        "0": (("1",), [("1", 0.03, True)]),
        "1": (("0",), [("0", 0.03, True)]),
        "1 (south)": (("0 (south)",), [("0 (south)", 0.05, True)]),
        "0 (south)": (("1 (south)",), [("1 (south)", 0.05, True)]),
    }


def test_a_drive_that_was_aligned_again_is_the_same_drive_where_it_lies_alike(
    north: Path, tmp_path: Path
) -> None:
    lie_beside(north, 0.03)
    shutil.copy(north, tmp_path / "south.gpkg")
    with open_map(tmp_path / "south.gpkg", writable=True) as universal:
        universal.rename_session("0", "june")
    lie_beside(tmp_path / "south.gpkg", 0.05)
    merged = merge_maps([north, tmp_path / "south.gpkg"], tmp_path / "farm.gpkg")
    assert [one.twin for one in merged] == [None, None, "0", "1"]
    assert told_beside(tmp_path / "farm.gpkg") == told_beside(north)


def test_a_map_in_the_plane_of_another_datum(north: Path, tmp_path: Path) -> None:
    with open_map(north, writable=True) as universal:
        universal.set_transform("1", 0.5, -0.25, turn_deg=1.0)
    out = tmp_path / "far.gpkg"
    merge_maps([north], out, datum=FAR)
    with open_map(north) as old, open_map(out) as new:
        assert new.datum == FAR
        pairs = list(zip(old.frames(), new.frames(), strict=True))
        assert pairs
        for was, now in pairs:
            assert was.cells_sha256 == now.cells_sha256  # the evidence keeps its bits
            # By PROJ, the same point on Earth, and the same direction.
            for ahead_m in (0.0, 10.0):
                places = [
                    geodetic(
                        datum,
                        record.pose.east_m
                        + ahead_m * math.sin(math.radians(record.pose.heading_deg)),
                        record.pose.north_m
                        + ahead_m * math.cos(math.radians(record.pose.heading_deg)),
                        record.pose.up_m,
                    )
                    for record, datum in ((was, DATUM), (now, FAR))
                ]
                metres = np.subtract(*places) * (111_000.0, 85_000.0, 1.0)
                level = 1e-4 if ahead_m == 0.0 else 0.001
                np.testing.assert_allclose(metres[:2], 0.0, atol=level)
                # The planes lean to each other by 1 mrad: 1 cm in 10 m.
                np.testing.assert_allclose(metres[2], 0.0, atol=1e-3 + 0.0012 * ahead_m)
        track_was, track_now = old.trajectory("0"), new.trajectory("0")
        assert track_now.datum == FAR
        assert track_now.heading_deg[2] != pytest.approx(track_was.heading_deg[2], abs=0.01)
        assert new.verify(deep=True).sound
    # And back again.
    merge_maps([out], tmp_path / "back.gpkg", datum=DATUM)
    with open_map(north) as old, open_map(tmp_path / "back.gpkg") as back:
        for was, now in zip(old.frames(), back.frames(), strict=True):
            assert (now.pose.east_m, now.pose.north_m, now.pose.heading_deg) == pytest.approx(
                (was.pose.east_m, was.pose.north_m, was.pose.heading_deg), abs=1e-4
            )


def test_maps_of_two_datums_merge_in_one_plane_and_a_drive_once(
    north: Path, tmp_path: Path
) -> None:
    with open_map(north, writable=True) as universal:
        universal.add_marks([Mark(MarkKind.KEEPOUT, ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0)))])
    merge_maps([north], tmp_path / "far.gpkg", datum=FAR)
    with open_map(tmp_path / "far.gpkg") as far:
        (mark,) = far.marks()
        for (east, north_m), (far_east, far_north) in zip(
            ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0)), mark.corners, strict=True
        ):
            here = geodetic(DATUM, east, north_m, 0.7)
            there = geodetic(FAR, far_east, far_north, far.datum.to_enu(*here)[2])
            np.testing.assert_allclose(there[:2], here[:2], atol=1e-9)
    for maps in ([north, tmp_path / "far.gpkg"], [tmp_path / "far.gpkg", north]):
        merged = merge_maps(maps, tmp_path / "both.gpkg", datum=DATUM, overwrite=True)
        assert [one.twin for one in merged] == [None, None, "0", "1"]
        with open_map(tmp_path / "both.gpkg") as both:
            assert len(both.marks()) == 1
    with open_map(tmp_path / "far.gpkg", writable=True) as universal:
        universal.set_transform("1", 0.5, 0.0)
    with pytest.raises(ConfigError, match=r"it lies up to \d\.\d+ m aside"):
        merge_maps([north, tmp_path / "far.gpkg"], tmp_path / "other.gpkg", datum=DATUM)


def geodetic(datum: Datum, east_m: float, north_m: float, up_m: float) -> tuple[float, ...]:
    """Latitude, longitude and height by PROJ."""
    pipeline = (
        f"+proj=pipeline +step +inv +proj=topocentric +lat_0={datum.lat_deg} "
        f"+lon_0={datum.lon_deg} +h_0={datum.height_m} +ellps=WGS84 "
        "+step +inv +proj=cart +ellps=WGS84"
    )
    lon, lat, height = pyproj.Transformer.from_pipeline(pipeline).transform(east_m, north_m, up_m)
    return lat, lon, height
