"""`track.csv` and the numbers of a track."""

from __future__ import annotations

import csv
import dataclasses
import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import (
    DatumError,
    FieldgridError,
    MapExistsError,
    MapWriteError,
    info,
    publish,
)
from fieldgrid.geometry import Datum, Fix, FixColumns, Status, Trajectory
from fieldgrid.poses import Estimate, estimate_poses, summarise_track, write_track
from fieldgrid.poses.faults.convention import Comparison
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.summary import summarise
from fieldgrid.poses.report import PoseReport
from fieldgrid.poses.track.table import COLUMNS, track_rows

DATUM = Datum(41.65, -4.72, 787.4)
SECOND = 1_000_000_000
START_NS = 1_308_133_811 * SECOND
OK, HELD, REJECTED = Status.OK, Status.HELD, Status.REJECTED

PLACES = (
    "41.650000000,-4.720000000,787.4000,0.0000,0.0000",
    "41.650009003,-4.719987997,787.9000,1.0000,1.0000",
    "41.650018005,-4.719975994,788.4000,2.0000,2.0000",
    "41.650027007,-4.719963991,788.9000,3.0000,3.0000",
)
"""As PROJ's topocentric conversion has them."""

AT, NS = "2011-06-15T10:30", ".000000000Z"
GOLDEN = "\n".join(
    (
        "time_ns,lat_deg,lon_deg,height_m,east_m,north_m,heading_deg,heading_sigma_deg,"
        "speed_mps,gear,status,reason,time,position_sigma_m,gear_doubt",
        f'1308133811000000000,,,,,,,,,,rejected,"quality 0 (none), not allowed",{AT}:11{NS},,',
        f"1308133812000000000,{PLACES[0]},37.123,0.321,1.500,1,ok,,{AT}:12{NS},0.0200,0.0000",
        f"1308133813000000000,{PLACES[1]},180.000,0.500,-0.800,-1,rejected,"
        f'"says ""no"", twice",{AT}:13{NS},0.0200,0.0200',
        f"1308133815000000000,{PLACES[2]},-90.000,1.250,0.000,0,held,,{AT}:15{NS},0.0200,0.0013",
        f"1308133816000000000,{PLACES[3]},,,0.000,0,rejected,heading unknown,"
        f"{AT}:16{NS},0.0200,0.0000",
        "",
    )
)


def log_of(count: int) -> list[Fix]:
    """Five fixes a second, straight to the north at 1.5 m/s."""
    lat, lon, height = DATUM.to_geodetic(
        np.zeros(count), 0.3 * np.arange(count), np.full(count, 2.0)
    )
    return [
        Fix(START_NS + k * SECOND // 5, float(lat[k]), float(lon[k]), float(height[k]), 4, 12, 0.8)
        for k in range(count)
    ]


def report() -> PoseReport:
    fixes = FixColumns.of_rows(log_of(30))
    verdicts = condition(fixes)
    summary = summarise(fixes, verdicts)
    return PoseReport(
        summary, None, None, None, float("nan"), None, None, None, (info("x", "A remark."),)
    )


def trajectory(**changes: Any) -> Trajectory:
    values: dict[str, Any] = {
        "datum": DATUM,
        "time_ns": START_NS + np.arange(6, dtype=np.int64) * SECOND,
        "east_m": np.array([500.0, 0.0, 1.0, 1.5, 2.0, 3.0]),
        "north_m": np.array([500.0, -0.00001, 1.0, 1.5, 2.0, 3.0]),
        "up_m": np.array([0.0, 0.0, 0.5, 0.75, 1.0, 1.5]),
        "heading_deg": np.array([np.nan, 37.1234, -179.9999, 0.0, -90.0, 12.0]),
        "position_sigma_m": np.full(6, 0.02),
        "heading_sigma_deg": np.array([np.inf, 0.3211, 0.5, 0.4, 1.25, 95.0]),
        "speed_mps": np.array([np.nan, 1.5, -0.8, -0.4, -0.0001, 0.0]),
        "gear": np.array([0, 1, -1, -1, 0, 0], dtype=np.int64),
        "quality": np.array([0, 4, 4, 6, 4, 4], dtype=np.int64),
        "status": (REJECTED, OK, REJECTED, OK, HELD, REJECTED),
        "reason": (
            "quality 0 (none), not allowed",
            "",
            'says "no", twice',
            "",
            "",
            "heading unknown",
        ),
        "heading_source": "smooth",
    }
    return Trajectory(**{**values, **changes})


def estimate(**changes: Any) -> Estimate:
    """Five fixes; the fourth row of the trajectory is none of them."""
    doubt = np.array([0.5, 0.0, 0.02, 0.0, 0.00126, 0.0])
    return Estimate(trajectory(**changes), np.array([0, 1, 2, 4, 5]), report(), doubt)


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# --- the table


def test_the_table_is_as_others_expect_it(tmp_path: Path) -> None:
    write_track(estimate(), tmp_path / "track.csv")
    # 0.1 mm below zero is no negative zero, and -180 degrees are 180.
    assert (tmp_path / "track.csv").read_bytes().decode() == GOLDEN
    assert ",".join(COLUMNS) == GOLDEN.splitlines()[0]
    assert os.listdir(tmp_path) == ["track.csv"]


def test_quoted_text_comes_back(tmp_path: Path) -> None:
    reasons = ("a, b", "", 'say "no"', "", "", "one\ntwo")
    write_track(estimate(reason=reasons), tmp_path / "t.csv")
    back = [row["reason"] for row in read(tmp_path / "t.csv")]
    assert back == ["a, b", "", 'say "no"', "", "one\ntwo"]


def test_positions_are_the_inverse_of_the_plane(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    east, north, up = rng.uniform(-5000.0, 5000.0, (3, 6)) * np.array([[1.0], [1.0], [0.01]])
    write_track(
        estimate(east_m=east, north_m=north, up_m=up, heading_deg=np.zeros(6)), tmp_path / "t.csv"
    )
    rows = read(tmp_path / "t.csv")
    back = DATUM.to_enu(
        *([float(row[name]) for row in rows] for name in ("lat_deg", "lon_deg", "height_m"))
    )
    kept = [0, 1, 2, 4, 5]
    np.testing.assert_allclose(back[0], east[kept], atol=2e-4)
    np.testing.assert_allclose(back[1], north[kept], atol=2e-4)
    np.testing.assert_allclose(back[2], up[kept], atol=2e-4)
    for name, values in (("east_m", east), ("north_m", north)):
        np.testing.assert_allclose([float(r[name]) for r in rows], values[kept], atol=5.1e-5)


def test_a_row_an_input_fix_in_order_of_time() -> None:
    fixes = log_of(40)
    fixes[20] = fixes[20]._replace(quality=0)
    fixes[30] = fixes[30]._replace(lat_deg=fixes[30].lat_deg + 0.001)  # 111 m to the north
    found = estimate_poses(FixColumns.of_rows(reversed(fixes)), datum=DATUM)
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in track_rows(found)]
    assert [int(row["time_ns"]) for row in rows] == [fix.time_ns for fix in fixes]
    for k, why in ((20, "quality 0"), (30, "jump of 111")):
        row = rows[k]
        assert row["status"] == "rejected"
        assert row["reason"].startswith(why)
        # The estimate at that time, not what the fix says.
        assert float(row["north_m"]) == pytest.approx(0.3 * k, abs=0.1)
        assert float(row["heading_deg"]) == pytest.approx(0.0, abs=3.0)


def test_an_earlier_track_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    header = GOLDEN.splitlines()[0]
    for earlier in (header, header.partition(",time,")[0]):  # 0.1.0 ended with the reason
        path.write_text(f"{earlier}\r\nold\r\n")
        write_track(estimate(), path)
        assert path.read_text() == GOLDEN
    path.write_text("")
    write_track(estimate(), path)
    assert path.read_text() == GOLDEN


@pytest.mark.parametrize("content", [b"$GPGGA,1\r\n", GOLDEN[:40].encode(), b"\xff\xd8" * 300])
def test_anything_else_is_not_replaced(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "rtk.csv"
    path.write_bytes(content)
    with pytest.raises(MapExistsError, match=r"rtk\.csv exists already and is no track; give"):
        write_track(estimate(), path)
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("place", "error"), [("f.csv", MapExistsError), ("not/t.csv", MapWriteError)]
)
def test_a_place_where_no_file_can_be(
    place: str, error: type[FieldgridError], tmp_path: Path
) -> None:
    (tmp_path / "f.csv").mkdir()
    with pytest.raises(error, match=r"folder"):
        write_track(estimate(), tmp_path / place)
    assert list(tmp_path.iterdir()) == [tmp_path / "f.csv"]


def test_a_full_disk_leaves_the_earlier_track(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "t.csv"
    path.write_text(GOLDEN)

    def full(_: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(publish, "sync", full)
    with pytest.raises(MapWriteError, match=r"disk is full"):
        write_track(estimate(), path)
    assert path.read_text() == GOLDEN
    assert list(tmp_path.iterdir()) == [path]


def test_a_drive_far_from_its_datum_is_refused(tmp_path: Path) -> None:
    far = np.array([0.0, 0.0, 0.0, 60_000.0, 0.0, 0.0])
    with pytest.raises(DatumError, match=r"60 km from its datum, over 50 km; give a --datum"):
        write_track(estimate(east_m=far), tmp_path / "t.csv")
    assert list(tmp_path.iterdir()) == []
    write_track(estimate(east_m=np.roll(far, 2)), tmp_path / "t.csv")  # a rejected pose may be


# --- the numbers


def test_the_numbers_of_a_track() -> None:
    found = summarise_track(estimate())
    assert (found.fixes, found.ok, found.held, found.rejected) == (5, 1, 1, 3)
    assert found.duration_s == 5.0
    assert found.distance_m == pytest.approx(np.hypot(1.5, 1.5) + np.hypot(0.5, 0.5), abs=1e-4)
    assert found.gears == (1.0, 2.0, 1.0, 1)  # the row that is no fix counts, too
    assert found.heading_sigma_deg == pytest.approx((0.78555, 1.203555))
    assert found.position_sigma_m == pytest.approx((0.02, 0.02))
    assert [count for count, _ in found.reasons] == [1, 1, 1]


def test_json_holds_it_all() -> None:
    compared = Comparison(1.5, 0.1, 2.0, False, False, 321)
    known = dataclasses.replace(report(), recorded=compared, gyro_bias_dps=0.2)
    found = summarise_track(estimate()._replace(report=known)).as_dict()
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["datum"] == {"lat_deg": 41.65, "lon_deg": -4.72, "height_m": 787.4}
    assert found["recorded_heading"]["offset_deg"] == 1.5
    assert found["gyro_bias_dps"] == 0.2
    assert [one["message"] for one in found["findings"]] == ["A remark."]
    assert found["heading_sigma_deg"].keys() == {"median", "p95"}


def test_nothing_accepted_is_null_not_nan() -> None:
    found = summarise_track(estimate(status=(REJECTED,) * 6, reason=("no",) * 6)).as_dict()
    assert found["heading_sigma_deg"] is None
    assert found["position_sigma_m"] is None
    assert (found["distance_m"], found["rejected"]) == (0.0, 5)
    assert found["reasons"] == [{"fixes": 5, "example": "no"}]
    json.dumps(found, allow_nan=False)
