"""Paths of fixes that are the mirror image of what the camera saw."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fieldgrid.core import Float64, Severity
from fieldgrid.geometry import Datum, Gyro, Motion, Status, Steps, Trajectory
from fieldgrid.pipeline.checks.mirrored import mirror_findings
from fieldgrid.recordings import Recording

COUNT = 60
TIME_NS = 1_308_133_815_000_000_000 + np.arange(COUNT + 1, dtype=np.int64) * 500_000_000
TURN_DEG = np.where(np.arange(COUNT) % 40 < 20, 0.0, 9.0)
"""Twenty steps straight on, half a circle to the right, and again."""


def steps(sense: float = 1.0, hole: bool = False) -> Steps:
    kept = np.arange(COUNT) != 30 if hole else np.ones(COUNT, dtype=bool)
    zero = np.zeros(COUNT)
    columns = (
        *(np.full(COUNT, 0.7), zero, sense * TURN_DEG, np.full(COUNT, 0.01), np.full(COUNT, 0.1)),
        *(zero, zero, zero, np.full(COUNT, 0.1)),
    )
    start, stop = TIME_NS[:-1][kept], TIME_NS[1:][kept]
    return Steps(start, stop, *(column[kept] for column in columns))


def way(turn_deg: Float64, lat_deg: float, lon_deg: float, exchanged: bool = False) -> Trajectory:
    heading = np.concatenate([[0.0], np.cumsum(turn_deg)])
    each = 0.7 * np.exp(1j * np.radians(heading[:-1]))
    place = np.concatenate([[0.0], np.cumsum(each)])
    north, east = place.real, place.imag
    if exchanged:  # what is east by the right datum becomes north by the wrong one
        north, east = east / np.cos(np.radians(lon_deg)), north * np.cos(np.radians(lat_deg))
    many: Any = len(TIME_NS)
    return Trajectory(
        datum=Datum(lat_deg, lon_deg, 700.0),
        time_ns=TIME_NS,
        east_m=east,
        north_m=north,
        up_m=np.zeros(many),
        heading_deg=heading,
        position_sigma_m=np.full(many, 0.02),
        heading_sigma_deg=np.full(many, 0.3),
        speed_mps=np.full(many, 1.4),
        gear=np.ones(many, dtype=np.int64),
        quality=np.full(many, 4),
        status=(Status.OK,) * many,
        reason=("",) * many,
        heading_source="smooth",
    )


def drive(gyro_deg: Float64 | None = None) -> Recording:
    """As much of a recording as is asked for; the gyro turns by so much in each step."""
    gyro = None
    if gyro_deg is not None:
        gyro = Gyro(TIME_NS[:-1] + 250_000_000, np.radians(gyro_deg) / 0.5)
    return cast(Recording, SimpleNamespace(motion=lambda: Motion(gyro=gyro)))


@pytest.mark.parametrize("hole", [False, True])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_way_that_the_camera_saw_is_believed(sense: float, hole: bool) -> None:
    trajectory = way(sense * TURN_DEG, 41.65, -4.72)
    assert not list(mirror_findings(drive(), trajectory, steps(sense, hole)))


def test_a_straight_way_tells_nothing() -> None:
    straight = steps()._replace(turn_deg=np.zeros(COUNT))
    assert not list(mirror_findings(drive(), way(np.zeros(COUNT), 41.65, 4.72), straight))


def test_nothing_is_said_without_a_camera() -> None:
    assert not list(mirror_findings(drive(), way(-TURN_DEG, 41.65, 4.72), None))


@pytest.mark.parametrize("hole", [False, True])
def test_a_longitude_without_its_sign(hole: bool) -> None:
    (found,) = mirror_findings(drive(TURN_DEG), way(-TURN_DEG, 41.65, 4.72), steps(hole=hole))
    assert (found.code, found.severity) == ("mirrored", Severity.ERROR)
    said = str(found)
    assert "m apart, and 0.00 m with left and right exchanged" in said
    assert "the gyro turns as the camera does" in said
    assert "latitude 41.650000, longitude 4.720000" in said
    assert "a minus, a W or an S" in said


def test_images_that_were_flipped() -> None:
    (found,) = mirror_findings(drive(-TURN_DEG), way(-TURN_DEG, 41.65, -4.72), steps())
    assert "the images were flipped" in str(found)


def test_latitude_and_longitude_exchanged() -> None:
    (found,) = mirror_findings(
        drive(TURN_DEG), way(TURN_DEG, -4.72, 41.65, exchanged=True), steps()
    )
    assert "0.00 m with latitude and longitude exchanged" in str(found)
    assert "--columns lat=COLUMN,lon=COLUMN" in str(found)
