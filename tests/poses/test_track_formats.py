"""Tracks in the formats of others, read by others' rules."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.geometry import Motion
from fieldgrid.poses import Estimate, estimate_poses, write_track
from tests.simulated import DATUM, K_TURN, fixes_of, gyro_of, simulate

NS = {"g": "http://www.topografix.com/GPX/1/1"}


@pytest.fixture(scope="module")
def found() -> Estimate:
    """A K-turn with a hole of 5 s and a fix that is rejected."""
    drive = simulate(K_TURN, 35.0)
    fixes = fixes_of(drive, 0.2, 0.01)
    seconds = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    keep = (seconds < 8.0) | (seconds > 13.0)
    hdop = np.where(np.arange(keep.sum()) == 10, 9.0, 0.8)
    fixes = fixes[np.flatnonzero(keep)].replace(hdop=hdop)
    return estimate_poses(fixes, None, DATUM, motion=Motion(gyro=gyro_of(drive)))


def test_gpx_has_the_poses_that_can_be_used_in_segments(found: Estimate, tmp_path: Path) -> None:
    path = tmp_path / "track.gpx"
    write_track(found, path)
    root = ET.parse(path).getroot()
    points = root.findall(".//g:trkpt", NS)
    rows = found.fix_row[found.trajectory.accepted[found.fix_row]]
    assert len(points) == len(rows)
    east, north, _ = DATUM.to_enu(
        np.array([float(p.attrib["lat"]) for p in points]),
        np.array([float(p.attrib["lon"]) for p in points]),
        np.array([float(p.findtext("g:ele", namespaces=NS) or "nan") for p in points]),
    )
    assert east == pytest.approx(found.trajectory.east_m[rows], abs=1e-3)
    assert north == pytest.approx(found.trajectory.north_m[rows], abs=1e-3)
    times = np.array(
        [(p.findtext("g:time", namespaces=NS) or "").rstrip("Z") for p in points],
        dtype="datetime64[ns]",
    ).astype(np.int64)
    assert np.abs(times - found.trajectory.time_ns[rows]).max() <= 1_000_000
    gaps = np.count_nonzero(np.diff(found.trajectory.time_ns[rows]) > 1_500_000_000)
    assert gaps >= 1
    assert len(root.findall(".//g:trkseg", NS)) == gaps + 1


def test_geojson_has_every_fix_with_a_pose(found: Estimate, tmp_path: Path) -> None:
    path = tmp_path / "track.geojson"
    write_track(found, path)
    told = json.loads(path.read_text())
    assert len(told["features"]) == len(found.fix_row)
    statuses = [feature["properties"]["status"] for feature in told["features"]]
    assert statuses == [found.trajectory.status[k].value for k in found.fix_row.tolist()]
    assert "HDOP 9" in told["features"][10]["properties"]["reason"]
    lon, lat, _ = told["features"][0]["geometry"]["coordinates"]
    assert lon == pytest.approx(DATUM.lon_deg, abs=0.01)
    assert lat == pytest.approx(DATUM.lat_deg, abs=0.01)


def test_tum_has_positions_and_headings_of_the_plane(found: Estimate, tmp_path: Path) -> None:
    path = tmp_path / "track.tum"
    write_track(found, path)
    table = np.loadtxt(path)  # '#' begins a comment
    rows = found.fix_row[found.trajectory.accepted[found.fix_row]]
    assert table.shape == (len(rows), 8)
    track = found.trajectory
    assert table[:, 1] == pytest.approx(track.east_m[rows], abs=1e-4)
    assert table[:, 2] == pytest.approx(track.north_m[rows], abs=1e-4)
    # The forward axis of the vehicle, turned by the quaternion.
    z, w = table[:, 6], table[:, 7]
    east, north = 1.0 - 2.0 * z**2, 2.0 * z * w
    phi = np.radians(track.heading_deg[rows])
    assert east == pytest.approx(np.sin(phi), abs=1e-6)
    assert north == pytest.approx(np.cos(phi), abs=1e-6)
    first = path.read_text().splitlines()[1].split()[0]
    assert int(first.replace(".", "")) == track.time_ns[rows[0]]


@pytest.mark.parametrize("suffix", ["gpx", "geojson", "tum"])
def test_only_an_earlier_track_is_replaced(found: Estimate, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"track.{suffix}"
    write_track(found, path)
    write_track(found, path)
    path.write_text("something else\n")
    with pytest.raises(MapExistsError, match="is no track"):
        write_track(found, path)
    assert path.read_text() == "something else\n"


@pytest.mark.parametrize("name", ["track", "track.txt", "track.kml", "track.csv.gz"])
def test_another_ending_is_an_error(found: Estimate, tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"\.csv, \.gpx, \.geojson, \.tum"):
        write_track(found, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_track_without_poses_is_whole(tmp_path: Path) -> None:
    fixes = fixes_of(simulate([K_TURN[0]._replace(speed_mps=0.0)]), 0.2, 0.01)
    nothing = estimate_poses(fixes, None, DATUM)
    assert not nothing.trajectory.accepted.any()
    for suffix in ("gpx", "geojson", "tum"):
        write_track(nothing, tmp_path / f"t.{suffix}")
    assert not ET.parse(tmp_path / "t.gpx").getroot().findall(".//g:trkpt", NS)
    assert json.loads((tmp_path / "t.geojson").read_text())["type"] == "FeatureCollection"
