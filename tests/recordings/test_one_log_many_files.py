"""One log as NMEA, as a table and in bags of every kind: one trajectory and one set of verdicts."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import BuildSettings, PoseSettings
from fieldgrid.geometry import FixColumns, wrap_deg
from fieldgrid.pipeline import track_drive
from tests.poses.gnss.sentences import sentence
from tests.recordings.ros.samples import (
    FIX,
    ROS1,
    ROS2,
    TYPES,
    Sample,
    write_folder,
    write_mcap,
    write_old_db3,
    write_rosbag1,
)
from tests.simulated import K_TURN, SLALOM, fixes_of, simulate


def log() -> FixColumns:
    """Curves, a cusp, and a jump of two metres for a second that the conditioning refuses."""
    fixes = fixes_of(simulate([*SLALOM, *K_TURN], 35.0), 0.2, 0.01)
    jump = (np.arange(len(fixes)) // 5 == 30) * (2.0 / 111_000.0)
    # As fine as NMEA writes it below, so that every file holds the same numbers.
    lat, lon = (
        np.round(np.round(deg * 60.0, 7) / 60.0, 12)
        for deg in (fixes.lat_deg + jump, fixes.lon_deg)
    )
    return fixes.replace(lat_deg=lat, lon_deg=lon, height_m=np.round(fixes.height_m, 4))


def nmea(path: Path, fixes: FixColumns) -> None:
    lines = []
    for fix in fixes:
        moment = datetime.fromtimestamp(fix.time_ns // 10**9, UTC)
        time = f"{moment:%H%M%S}.{fix.time_ns % 10**9 // 10**6:03d}"
        lat, lon = (
            f"{int(abs(deg)):0{width}d}{abs(deg) % 1.0 * 60.0:010.7f}"
            for deg, width in ((fix.lat_deg, 2), (fix.lon_deg, 3))
        )
        east = "E" if fix.lon_deg > 0 else "W"
        lines += [
            sentence(f"GPRMC,{time},A,{lat},N,{lon},{east},,,{moment:%d%m%y},,,A"),
            sentence(
                f"GPGGA,{time},{lat},N,{lon},{east},4,12,0.8,{fix.height_m:.4f},M,0.0,M,1.0,1"
            ),
        ]
    path.write_bytes(b"".join(lines))


def table(path: Path, fixes: FixColumns) -> None:
    rows = ["time_ns,lat,lon,height"]
    rows += [f"{f.time_ns},{f.lat_deg:.12f},{f.lon_deg:.12f},{f.height_m:.4f}" for f in fixes]
    path.write_text("\n".join(rows) + "\n")


def messages(fixes: FixColumns, store: Any) -> list[Sample]:
    made = []
    for fix in fixes:
        seconds, nanoseconds = divmod(fix.time_ns, 10**9)
        stamp = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        extra = {"seq": 0} if store is ROS1 else {}
        header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="gps", **extra)
        message = store.types[TYPES[FIX]](
            header=header,
            status=store.types["sensor_msgs/msg/NavSatStatus"](status=2, service=1),
            latitude=fix.lat_deg,
            longitude=fix.lon_deg,
            altitude=fix.height_m,
            position_covariance=np.diag([4e-4, 4e-4, 16e-4]).ravel(),
            position_covariance_type=2,
        )
        made.append(Sample(FIX, message, fix.time_ns))
    return made


def old_db3(path: Path, fixes: FixColumns) -> None:
    write_old_db3(path, messages(fixes, ROS2)).close()


FILES: dict[str, Callable[[Path, FixColumns], None]] = {
    "log.nmea": nmea,
    "log.csv": table,
    "log.bag": lambda path, fixes: write_rosbag1(path, messages(fixes, ROS1), "lz4"),
    "log.mcap": lambda path, fixes: write_mcap(path, messages(fixes, ROS2)),
    "ros1.mcap": lambda path, fixes: write_mcap(path, messages(fixes, ROS1), store=ROS1),
    "log.db3": old_db3,
    "folder": lambda path, fixes: write_folder(path, messages(fixes, ROS2)),
}


@pytest.mark.parametrize("name", [name for name in FILES if name != "log.csv"])
def test_a_log_gives_one_trajectory_whatever_it_lies_in(name: str, tmp_path: Path) -> None:
    fixes = log()
    # What a source says of its own accuracy differs, and is declared here.
    settings = BuildSettings(pose=PoseSettings(quality=4, accuracy_m=0.02))
    found = []
    for one in ("log.csv", name):
        FILES[one](tmp_path / one, fixes)
        found.append(track_drive(tmp_path / one, settings).estimate.trajectory)
    by_table, other = found
    assert 0 < np.count_nonzero(~by_table.accepted) < 0.2 * len(fixes)
    assert np.array_equal(other.time_ns, by_table.time_ns)
    assert other.status == by_table.status
    assert other.reason == by_table.reason
    assert np.array_equal(other.gear, by_table.gear)
    away_m = np.hypot(other.east_m - by_table.east_m, other.north_m - by_table.north_m)
    assert away_m.max() < 1e-3
    turned_deg = np.abs(wrap_deg(other.heading_deg - by_table.heading_deg))
    assert np.nanmax(turned_deg) < 0.01
