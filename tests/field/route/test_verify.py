"""The check finds what is wrong with a way, whoever made it."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from benchmarks.planting import DATUM
from fieldgrid.field import Vehicle
from fieldgrid.field.route.ground import Ground
from fieldgrid.field.route.path import Path
from fieldgrid.field.route.verify import find_fault
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import CostCurve, MapView

VEHICLE = Vehicle(front_m=1.0, rear_m=0.5, width_m=1.0, turning_radius_m=2.0, clearance_m=0.25)


def ground(east_m: float = 5.0, north_m: float = 8.0) -> Ground:
    """10 m square of cells of 0.1 m, with one obstacle cell whose south-west corner is there."""
    density = np.zeros((100, 100), dtype=np.uint8)
    density[round(north_m / 0.1), round(east_m / 0.1)] = 200
    view = MapView(Lattice(0.1), Window(0, 0, 100, 100), density, density >= 0, DATUM, is_base=True)
    return Ground.of(view, CostCurve(), VEHICLE, allow_unknown=False, margin_m=2.0)


def eastward(gear: int = 1) -> Path:
    """A straight way along north 5 m; its vehicle covers 4.5 to 5.5 m."""
    east = np.linspace(2.0, 8.0, 61)
    return Path(east, np.full(61, 5.0), np.full(61, 90.0 * gear), np.full(61, gear), np.zeros(61))


def arc(radius_m: float) -> Path:
    """A quarter of a circle to the left, from east to north."""
    yaw = np.linspace(0.0, 0.5 * np.pi, 61)
    east, north = 3.0 + radius_m * np.sin(yaw), 3.0 + radius_m * (1.0 - np.cos(yaw))
    return Path(
        east, north, 90.0 - np.degrees(yaw), np.ones(61, dtype=np.int64),
        np.full(61, 1.0 / radius_m),
    )  # fmt: skip


def test_good_ways_have_no_fault() -> None:
    assert find_fault(eastward(), ground(), VEHICLE) is None
    assert find_fault(eastward(-1), ground(), VEHICLE) is None
    assert find_fault(arc(2.0), ground(), VEHICLE) is None


@pytest.mark.parametrize(
    ("north_m", "touches"), [(5.7, True), (5.8, False), (4.2, True), (4.1, False)]
)
def test_the_clearance_counts_to_the_centimetre(north_m: float, touches: bool) -> None:
    """The vehicle and its clearance cover 4.25 to 5.75 m; a cell is 0.1 m wide."""
    fault = find_fault(eastward(), ground(5.0, north_m), VEHICLE)
    assert (fault is not None) == touches
    if fault is not None:
        assert "an obstacle" in fault.reason
        assert (fault.east_m, fault.north_m) == pytest.approx((5.05, north_m + 0.05))


def test_ground_between_poses_is_swept() -> None:
    """Outside an arc, beside the corner that the nose sweeps between two poses."""
    path, vehicle = arc(2.0), dataclasses.replace(VEHICLE, clearance_m=0.0)
    thin = Path(*(column[::2] for column in path))
    rho = np.hypot(vehicle.front_m, 2.0 + 0.5 * vehicle.width_m)
    ahead = np.arctan2(vehicle.front_m, 2.5)
    yaw = 0.5 * (np.radians(90.0 - thin.heading_deg[14]) + np.radians(90.0 - thin.heading_deg[15]))
    corner = 3.0 + rho * np.sin(yaw + ahead), 5.0 - rho * np.cos(yaw + ahead)
    inside = ground(*(np.floor(np.array(corner) / 0.1) * 0.1))
    assert find_fault(thin, inside, vehicle) is not None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"east_m": np.linspace(2.0, 20.0, 61)}, "a hole"),
        ({"gear": np.zeros(61, dtype=np.int64)}, "no gear"),
        ({"heading_deg": np.full(61, -90.0)}, "against its gear"),
        ({"heading_deg": np.full(61, 80.0)}, "sideways"),
        ({"gear": np.where(np.arange(61) < 30, 1, -1)}, "against its gear|gear changes"),
        ({"curvature_1pm": np.full(61, 0.4)}, "curvature is another"),
        ({"east_m": np.linspace(4.0, 10.0, 61)}, "ground that was not seen"),
    ],
)
def test_faults_of_a_straight_way(change: dict[str, np.ndarray], reason: str) -> None:
    fault = find_fault(eastward()._replace(**change), ground(), VEHICLE)
    assert fault is not None
    assert re.search(reason, fault.reason), fault


def test_faults_of_turns_and_gears() -> None:
    sharp = find_fault(arc(1.9), ground(), VEHICLE)
    assert sharp is not None
    assert "sharper" in sharp.reason
    assert (
        find_fault(arc(1.9), ground(), dataclasses.replace(VEHICLE, turning_radius_m=1.9)) is None
    )
    mirrored = arc(2.0)._replace(curvature_1pm=np.full(61, -0.5))
    found = find_fault(mirrored, ground(), VEHICLE)
    assert found is not None
    assert "curvature" in found.reason
    backwards = find_fault(eastward(-1), ground(), dataclasses.replace(VEHICLE, reverse=False))
    assert backwards is not None
    assert "reverses" in backwards.reason
    stand = eastward()
    spun = stand._replace(east_m=np.full(61, 5.0), heading_deg=np.linspace(0.0, 90.0, 61))
    fault = find_fault(spun, ground(), VEHICLE)
    assert fault is not None
    assert "on the spot" in fault.reason


def test_beyond_the_window_is_off_the_map() -> None:
    fault = find_fault(eastward()._replace(north_m=np.full(61, -4.0)), ground(), VEHICLE)
    assert fault is not None
    assert "leaves the map" in fault.reason
