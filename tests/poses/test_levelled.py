"""Poses of vehicles that lean: the grid origin through the full attitude."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import Float64, PoseSettings
from fieldgrid.geometry import (
    FixColumns,
    Gyro,
    LeverArm,
    Motion,
    Mount,
    Orientation,
    Rig,
    Status,
    WheelSpeed,
    heading_rad,
    roll_pitch_deg,
)
from fieldgrid.poses import Estimate, estimate_poses, fused, levelling_attitude, tells_attitude
from fieldgrid.poses.attitude.axes import AxisTilt
from fieldgrid.poses.levelled import find_lean
from tests.hilly import (
    Hike,
    antenna_fixes,
    axis_rises,
    camera_steps,
    fixes_over,
    gyro_and,
    hike,
    hills,
    inertial,
    mounted,
    recorded_tilt,
    rows,
    slope,
)
from tests.scenes import paper_rig
from tests.simulated import DATUM, START, time_ns
from tests.told import codes

SENSOR_M = (0.0, 1.4, 2.5)  # from the axle: right, forward, up
ANTENNA_M = (-0.12, -0.45, 0.35)  # from the sensor
RIG = Rig(
    paper_rig().camera,
    Mount(SENSOR_M[2], 15.0),
    LeverArm(ANTENNA_M[0], ANTENNA_M[1], SENSOR_M[2] + ANTENNA_M[2]),
    rear_axle_forward_m=-SENSOR_M[1],
)
FRAMES_S = np.arange(1.03, 50.0, 1.0)
GROUNDS = {"12° across": slope(12.0, 120.0), "hills": hills(9.0, 45.0)}


def headings(way: Hike, toward_deg: float) -> Float64:
    """What two antennas that point so far clockwise from the nose show at the fixes, degrees."""
    toward = np.radians(toward_deg)
    times, _ = antenna_fixes(way, ANTENNA_M)
    seen = way.at((times - START) / 1e9)
    east, north, _ = (seen.R @ np.array([np.sin(toward), np.cos(toward), 0.0])).T
    return np.degrees(np.arctan2(east, north))


def estimate(way: Hike, motion: Motion, *, level_grids: bool = True) -> Estimate:
    return estimate_poses(
        fixes_over(way, ANTENNA_M),
        RIG,
        DATUM,
        motion=motion,
        frame_ns=time_ns(FRAMES_S),
        level_grids=level_grids,
    )


def off_m(way: Hike, found: Estimate, above_sensor_m: float = 0.0) -> tuple[Float64, Float64]:
    """East and north [n, 2] of the accepted poses at frames off a point in line with the sensor
    along the vehicle's axis, and three of their sigmas [n]."""
    seen = way.at(FRAMES_S)
    true = seen.sensor_m + seen.R @ np.array([0.0, 0.0, above_sensor_m])
    poses = [found.trajectory.at(t) for t in time_ns(FRAMES_S).tolist()]
    used = np.array([pose.status is Status.OK for pose in poses])
    assert used.mean() > 0.8
    place = np.array([[pose.east_m, pose.north_m] for pose in poses])
    sigma = np.array([3.0 * pose.position_sigma_m for pose in poses])
    return (place - true[:, :2])[used], sigma[used]


def farthest_m(off: npt.NDArray[np.float64]) -> float:
    return float(np.percentile(np.hypot(*off.T), 95))


@pytest.mark.parametrize("ground", GROUNDS)
def test_the_origin_lies_vertically_below_the_sensor(ground: str) -> None:
    way = hike(GROUNDS[ground], rows(2, 28.0))
    found = estimate(way, gyro_and(inertial(way)))
    assert found.report.attitude is not None
    off, within = off_m(way, found)
    assert farthest_m(off) < 0.03
    assert np.mean(np.hypot(*off.T) < within) > 0.98
    heading = [found.trajectory.at(t).heading_deg for t in time_ns(FRAMES_S).tolist()]
    true = np.degrees(heading_rad(way.at(FRAMES_S).R))
    turned = np.abs((np.array(heading) - true + 180.0) % 360.0 - 180.0)
    assert np.median(turned) < 0.2
    assert np.percentile(turned, 95) < 0.5
    up = np.array([found.trajectory.at(t).up_m for t in time_ns(FRAMES_S).tolist()])
    assert np.percentile(np.abs(up + SENSOR_M[2] - way.at(FRAMES_S).sensor_m[:, 2]), 95) < 0.06


def test_without_an_attitude_it_lies_downhill() -> None:
    way = hike(GROUNDS["12° across"], rows(2, 28.0))
    found = estimate(way, Motion())
    assert found.report.attitude is None
    assert farthest_m(off_m(way, found)[0]) > 0.05
    assert farthest_m(off_m(way, found, -SENSOR_M[2])[0]) > 0.4


def test_grids_square_to_the_ground_have_theirs_below_the_sensor_on_the_ground() -> None:
    way = hike(GROUNDS["hills"], rows(2, 28.0))
    level, square = (
        estimate(way, gyro_and(inertial(way)), level_grids=level) for level in (True, False)
    )
    assert farthest_m(off_m(way, square, -SENSOR_M[2])[0]) < 0.04
    assert farthest_m(off_m(way, level, -SENSOR_M[2])[0]) > 0.2


def test_the_camera_levels_the_lever_arm_of_grids_square_to_the_ground() -> None:
    way = hike(GROUNDS["12° across"], rows(2, 28.0))
    found = estimate(way, Motion(steps=camera_steps(way)))
    assert found.report.attitude is not None
    off, within = off_m(way, found, -SENSOR_M[2])
    assert farthest_m(off) < 0.1
    assert np.mean(np.hypot(*off.T) < within) > 0.95


def test_grids_that_were_levelled_stay_so_when_the_imu_is_thrown_out() -> None:
    """The grids are made before the camera denies the gyro."""
    way = hike(GROUNDS["12° across"], rows(2, 28.0))
    sensed = inertial(way)
    wrong = sensed._replace(time_ns=sensed.time_ns + 1_500_000_000)
    motion = Motion(
        gyro=Gyro(wrong.time_ns, wrong.rate_rad_s[:, 2]), inertial=wrong, steps=camera_steps(way)
    )
    found = estimate(way, motion)
    assert any("gyro" in note for note in found.report.notes)
    assert found.report.attitude is not None
    assert farthest_m(off_m(way, found)[0]) < 0.1
    square = estimate(way, motion, level_grids=False)
    assert farthest_m(off_m(way, square, -SENSOR_M[2])[0]) < 0.1


@pytest.mark.parametrize("camera", ["camera", "camera and IMU"])
@pytest.mark.parametrize("around_s", [(1.0, 1.0), (5.0, 5.0), (1.0, 10.0)])
def test_a_turn_in_a_hole_of_the_fixes_tips_nothing_over(
    around_s: tuple[float, float], camera: str
) -> None:
    """Headings at the fixes alone would say that it turned the other way around."""
    way = hike(GROUNDS["hills"], rows(2, 28.0))
    turning_s = way.drive.time_s[np.abs(way.drive.curvature_per_m) > 0.1]
    fixes = fixes_over(way, ANTENNA_M)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    before_s, after_s = around_s
    hole = (late_s > turning_s[0] - before_s) & (late_s < turning_s[-1] + after_s)
    motion = Motion() if camera == "camera" else gyro_and(inertial(way))
    motion = motion._replace(steps=camera_steps(way, 0.5))
    found = estimate_poses(
        *(fixes[~hole], RIG, DATUM), motion=motion, frame_ns=time_ns(FRAMES_S), level_grids=False
    )
    assert codes(found.report) == []
    off, within = off_m(way, found, -SENSOR_M[2])
    assert farthest_m(off) < 0.12
    assert (np.hypot(*off.T) < within).all()
    assert found.report.attitude is not None
    seen = found.report.attitude.at(time_ns(FRAMES_S))
    for told_deg, sigma_deg, true_deg in zip(
        (seen.roll_deg, seen.pitch_deg),
        (seen.roll_sigma_deg, seen.pitch_sigma_deg),
        roll_pitch_deg(way.at(FRAMES_S).R),
        strict=True,
    ):
        assert np.mean(np.abs(told_deg - true_deg) < 3.0 * sigma_deg) > 0.98


@pytest.mark.parametrize("lanes", [1, 2])
@pytest.mark.parametrize(
    ("left_deg", "words"),
    [
        (90.0, "90° to the left"),
        (-80.0, "90° to the right"),
        (180.0, "180°"),
        (45.0, "45° to the left: mount it square"),
    ],
)
def test_an_imu_that_is_mounted_sideways_levels_nothing(
    left_deg: float, words: str, lanes: int
) -> None:
    """Rolling for pitching, poses were 0.2 m off and said 0.03, and grids leant by 15°."""
    way = hike(GROUNDS["hills"], rows(lanes, 40.0))
    found = estimate(way, gyro_and(mounted(inertial(way), left_deg)))
    assert found.report.attitude is None
    (note,) = (str(one) for one in found.report.findings if one.code == "accelerometer-unused")
    assert words in note
    seen = way.at(FRAMES_S)
    true = seen.sensor_m - seen.R @ np.array([0.0, 0.0, SENSOR_M[2]])
    for time_s, (east, north, _) in zip(time_ns(FRAMES_S).tolist(), true, strict=True):
        pose = found.trajectory.at(time_s)
        off_m = np.hypot(pose.east_m - east, pose.north_m - north)
        assert pose.status is not Status.OK or off_m < 3.0 * pose.position_sigma_m


def test_the_camera_levels_where_an_imu_is_mounted_sideways() -> None:
    way = hike(GROUNDS["hills"], rows(2, 28.0))
    motion = gyro_and(mounted(inertial(way), 90.0))._replace(steps=camera_steps(way))
    found = estimate(way, motion, level_grids=False)
    assert found.report.attitude is not None
    seen = found.report.attitude.at(time_ns(FRAMES_S))
    roll_deg, pitch_deg = roll_pitch_deg(way.at(FRAMES_S).R)
    assert np.percentile(np.abs(seen.roll_deg - roll_deg), 95) < 1.5
    assert np.percentile(np.abs(seen.pitch_deg - pitch_deg), 95) < 1.0
    off, within = off_m(way, found, -SENSOR_M[2])
    assert np.mean(np.hypot(*off.T) < within) > 0.95


@pytest.mark.parametrize("lanes", [1, 3])
def test_a_good_gyro_on_steep_hills_is_used(lanes: int) -> None:
    """Antenna and gyro lean with the vehicle; taken for level they contradict each other."""
    way = hike(hills(15.0, 40.0), rows(lanes, 40.0))
    found = estimate(way, gyro_and(inertial(way)))
    assert codes(found.report) == []
    assert found.report.attitude is not None
    if lanes > 1:
        assert farthest_m(off_m(way, found)[0]) < 0.05


def test_a_wrong_gyro_on_hills_is_still_told() -> None:
    way = hike(hills(15.0, 40.0), rows(3, 40.0))
    sensed = inertial(way)
    rate = sensed.rate_rad_s.copy()
    rate[:, 2] *= 1.2
    found = estimate(way, gyro_and(sensed._replace(rate_rad_s=rate)))
    assert any("turns of the gyro are" in note for note in found.report.notes)


@pytest.mark.parametrize("late_s", [0.1, 0.2])
@pytest.mark.parametrize("ground", ["hills", "level"])
def test_an_imu_that_is_late_is_less_sure_of_roll_and_pitch(ground: str, late_s: float) -> None:
    way = hike(GROUNDS.get(ground, slope(0.0)), rows(4, 40.0))
    sensed = inertial(way)
    late = sensed._replace(time_ns=sensed.time_ns + round(late_s * 1e9))
    found = estimate(way, gyro_and(late)).report.attitude
    assert found is not None
    times_s = np.arange(1.03, way.drive.time_s[-1] - 2.0, 0.5)
    seen = found.at(time_ns(times_s))
    true = roll_pitch_deg(way.at(times_s).R)
    off = np.abs(np.concatenate([seen.roll_deg - true[0], seen.pitch_deg - true[1]]))
    sigma = np.concatenate([seen.roll_sigma_deg, seen.pitch_sigma_deg])
    assert np.mean(off < 3.0 * sigma) > 0.93
    assert np.median(off / sigma) > 0.2


def test_a_recorded_tilt_levels_the_lever_arm() -> None:
    way = hike(GROUNDS["hills"], rows(2, 28.0))
    found = estimate(way, Motion(tilt=recorded_tilt(way)))
    off, within = off_m(way, found)
    assert farthest_m(off) < 0.06
    assert np.mean(np.hypot(*off.T) < within) > 0.95


@pytest.mark.parametrize("toward_deg", [90.0, -90.0])
def test_antennas_across_level_the_lever_arm(toward_deg: float) -> None:
    """On a slope of 12° across the way an antenna 2.85 m up is 0.6 m downhill."""
    way = hike(GROUNDS["12° across"], rows(2, 28.0))
    _, rises = axis_rises(way, toward_deg, noise_deg=0.2)
    rig = replace(RIG, heading_offset_deg=toward_deg)
    found = estimate_poses(
        fixes_over(
            way,
            ANTENNA_M,
            heading_deg=headings(way, toward_deg),
            pitch_deg=rises,
            tilt_sigma_deg=0.2,
        ),
        rig,
        DATUM,
        frame_ns=time_ns(FRAMES_S),
    )
    assert found.report.attitude is not None
    assert found.report.attitude.findings == ()
    off, within = off_m(way, found, -SENSOR_M[2])
    assert farthest_m(off) < 0.12
    assert np.mean(np.hypot(*off.T) < within) == 1.0
    without = estimate_poses(fixes_over(way, ANTENNA_M), rig, DATUM, frame_ns=time_ns(FRAMES_S))
    assert without.report.attitude is None


def test_antennas_that_are_not_where_they_are_said_to_be_are_noted() -> None:
    way = hike(GROUNDS["12° across"], rows(2, 28.0))
    _, rises = axis_rises(way, 90.0, noise_deg=0.2)
    found = estimate_poses(
        fixes_over(way, ANTENNA_M, heading_deg=headings(way, 0.0), pitch_deg=rises),
        RIG,
        DATUM,
        motion=gyro_and(inertial(way)),
        frame_ns=time_ns(FRAMES_S),
    )
    (note,) = (note for note in found.report.notes if "heading_offset_deg" in note)
    assert note.startswith("The pitch beside the recorded heading is ")
    assert farthest_m(off_m(way, found)[0]) < 0.03


def axes_used(
    monkeypatch: pytest.MonkeyPatch, fixes: FixColumns, **settings: Any
) -> tuple[AxisTilt, ...]:
    """The axes of the receiver that an estimate of a drive goes by."""
    used: list[AxisTilt] = []

    def found(*given: Any) -> Any:
        used.extend(given[-1])
        return find_lean(*given)

    monkeypatch.setattr(fused, "find_lean", found)
    estimate_poses(fixes, RIG, DATUM, PoseSettings(**settings))
    return tuple(used)


def test_a_pitch_counts_along_where_the_heading_was_found_to_point(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    way = hike(slope(6.0, 120.0), rows(2, 28.0))
    _, rises = axis_rises(way, 7.0)
    fixes = fixes_over(way, ANTENNA_M, heading_deg=headings(way, 7.0), pitch_deg=rises)
    (axis,) = axes_used(monkeypatch, fixes, max_heading_offset_deg=10.0)
    assert axis.toward_deg == pytest.approx(7.0, abs=0.5)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["across", "counted the other way"])
def test_the_pitch_of_a_heading_that_is_denied_is_not_used(
    sign: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the heading of the course, a drive goes on without the recorded one."""
    way = hike(slope(6.0, 120.0), rows(2, 28.0))
    _, rises = axis_rises(way, 90.0)
    fixes = fixes_over(way, ANTENNA_M, heading_deg=sign * headings(way, 90.0), pitch_deg=rises)
    assert axes_used(monkeypatch, fixes, heading="course") == ()


def test_a_pitch_without_a_heading_to_compare_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    way = hike(slope(6.0, 120.0), rows(2, 28.0))
    _, rises = axis_rises(way, 0.0)
    assert axes_used(monkeypatch, fixes_over(way, ANTENNA_M, pitch_deg=rises)) == ()


def test_the_pitch_of_fixes_that_are_rejected_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    way = hike(slope(6.0, 120.0), rows(2, 28.0))
    _, rises = axis_rises(way, 0.0)
    fixes = fixes_over(way, ANTENNA_M, heading_deg=headings(way, 0.0), pitch_deg=rises)
    none = fixes.quality.copy()
    none[40:60] = 0
    (axis,) = axes_used(monkeypatch, fixes.replace(quality=none))
    assert not np.isin(fixes.time_ns[40:60], axis.time_ns).any()
    assert len(axis.time_ns) > 0.8 * len(fixes)


def test_wheels_that_know_reverse_count_along_the_slope() -> None:
    way = hike(slope(15.0, 30.0), rows(2, 28.0))
    seen = way.at(np.arange(0.0, way.drive.time_s[-1], 0.1))
    speed = np.einsum("nj,nj->n", seen.R[:, :, 1], np.gradient(seen.sensor_m, 0.1, axis=0))
    speed[:3] = -0.1
    wheels = WheelSpeed(time_ns(seen.drive.time_s), speed)
    found = estimate(way, gyro_and(inertial(way))._replace(wheels=wheels))
    assert farthest_m(off_m(way, found)[0]) < 0.04


def test_what_tells_the_attitude_before_an_image_is_read() -> None:
    way = hike(slope(0.0), rows(1, 10.0))
    sensed = inertial(way)
    at_ns = sensed.time_ns[::100]
    assert tells_attitude(Motion(inertial=sensed), at_ns)
    assert tells_attitude(Motion(tilt=recorded_tilt(way)), at_ns)
    blind = sensed._replace(force_mps2=np.full_like(sensed.force_mps2, np.nan))
    assert not tells_attitude(Motion(inertial=blind, steps=camera_steps(way)), at_ns)


def test_an_unsure_lean_counts_before_the_verdict() -> None:
    """The antenna is 2.85 m above the ground: a degree is 5 cm."""
    way = hike(slope(0.0), rows(2, 28.0))
    settings = PoseSettings(max_position_sigma_m=0.09)
    sure, unsure = (
        estimate_poses(
            fixes_over(way, ANTENNA_M),
            RIG,
            DATUM,
            settings,
            Motion(tilt=recorded_tilt(way, sigma_deg=sigma_deg)),
            frame_ns=time_ns(FRAMES_S),
            level_grids=False,
        ).trajectory
        for sigma_deg in (0.1, 5.0)
    )
    assert sure.accepted.mean() > 0.9
    assert unsure.accepted.mean() < 0.1
    assert any(reason.startswith("position sigma") for reason in unsure.reason)


def test_an_accelerometer_over_little_of_the_drive_tells_no_attitude() -> None:
    sensed = inertial(hike(slope(0.0), rows(1, 10.0)))
    few = sensed.force_mps2.copy()
    few[: int(0.6 * len(few))] = np.nan
    assert not tells_attitude(Motion(inertial=sensed._replace(force_mps2=few)), time_ns(FRAMES_S))


def orientation(way: Hike, *, sign: float = 1.0) -> Orientation:
    """What an IMU states at 10 Hz; with the other sign, of one that is mounted backward."""
    times_s = np.arange(0.0, way.drive.time_s[-1], 0.1)
    roll, pitch = roll_pitch_deg(way.at(times_s).R)
    n = len(times_s)
    return Orientation(time_ns(times_s), sign * roll, sign * pitch, np.ones(n), np.zeros(n))


@pytest.mark.parametrize("which", ["two rows", "a third", "elsewhere"])
def test_an_orientation_over_little_of_the_drive_tells_no_attitude(which: str) -> None:
    way = hike(GROUNDS["12° across"], rows(2, 28.0))
    whole = orientation(way)
    if which == "two rows":
        said = Orientation(*(column[[10, 20]] for column in whole))
    elif which == "a third":
        said = Orientation(*(column[: len(column) // 3] for column in whole))
    else:
        said = whole._replace(time_ns=whole.time_ns + 10**14)
    motion = Motion(orientation=said)
    assert tells_attitude(Motion(orientation=whole), fixes_over(way, ANTENNA_M).time_ns)
    assert not tells_attitude(motion, fixes_over(way, ANTENNA_M).time_ns)
    found, nothing = estimate(way, motion), estimate(way, Motion())
    assert found.report.attitude is None
    assert "tilt-unused" in codes(found.report)
    assert set(nothing.report.notes) < set(found.report.notes)


def test_an_orientation_that_contradicts_tells_no_attitude() -> None:
    way = hike(slope(12.0, 120.0), rows(3, 40.0))
    right, backward = (Motion(orientation=orientation(way, sign=sign)) for sign in (1.0, -1.0))
    used = estimate(way, right).report.attitude
    assert used is not None
    assert levelling_attitude(used) is used
    found, nothing = estimate(way, backward), estimate(way, Motion())
    assert found.report.attitude is None
    assert "tilt-unused" in codes(found.report)
    assert set(nothing.report.notes) < set(found.report.notes)


def test_grids_are_level_by_what_the_drive_does_not_deny() -> None:
    """Where the camera tells the attitude, grids are square to the ground."""
    way = hike(slope(12.0, 120.0), rows(3, 40.0))
    backward = Motion(orientation=orientation(way, sign=-1.0), steps=camera_steps(way))
    found = estimate(way, backward).report.attitude
    assert found is not None
    assert levelling_attitude(found) is None


@pytest.mark.parametrize("blind", [False, True])
def test_an_accelerometer_shows_which_way_up_its_gyro_is(blind: bool) -> None:
    """Where the only turn lies in a hole, no course does."""
    way = hike(GROUNDS["hills"], rows(2, 28.0))
    turning_s = way.drive.time_s[np.abs(way.drive.curvature_per_m) > 0.1]
    fixes = fixes_over(way, ANTENNA_M)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    hole = (late_s > turning_s[0] - 1.0) & (late_s < turning_s[-1] + 1.0)
    motion, frames_ns = gyro_and(inertial(way)), time_ns(FRAMES_S)
    if blind:
        assert motion.inertial is not None
        nothing = np.full_like(motion.inertial.force_mps2, np.nan)
        motion = motion._replace(inertial=motion.inertial._replace(force_mps2=nothing))
    found = estimate_poses(fixes[~hole], RIG, DATUM, motion=motion, frame_ns=frames_ns)
    assert any("too few" in note for note in found.report.notes) is blind
    assert (found.report.attitude is None) is blind
    if blind:
        # Two rows, and either may be backed up.
        assert not found.trajectory.accepted.any()
        return
    poses = [found.trajectory.at(t) for t in frames_ns.tolist()]
    used = np.array([pose.status is Status.OK for pose in poses])
    assert used.mean() > 0.8
    heading_deg = np.array([pose.heading_deg for pose in poses])
    sigma_deg = np.array([pose.heading_sigma_deg for pose in poses])
    off_deg = (heading_deg - np.degrees(heading_rad(way.at(FRAMES_S).R)) + 180.0) % 360.0 - 180.0
    assert (np.abs(off_deg) < 3.0 * sigma_deg)[used].all()


def test_antennas_do_not_level_the_grids_of_a_denied_imu() -> None:
    way = hike(GROUNDS["hills"], rows(2, 40.0))
    motion = gyro_and(mounted(inertial(way), 90.0))
    _, rises = axis_rises(way, 0.0, noise_deg=0.2)
    fixes = fixes_over(
        way, ANTENNA_M, heading_deg=headings(way, 0.0), pitch_deg=rises, tilt_sigma_deg=0.2
    )
    found = estimate_poses(fixes, RIG, DATUM, motion=motion, frame_ns=time_ns(FRAMES_S))
    assert "accelerometer-unused" in codes(found.report)
    assert found.report.attitude is not None
    assert levelling_attitude(found.report.attitude) is None
    good = gyro_and(inertial(way))
    used = estimate_poses(fixes, RIG, DATUM, motion=good, frame_ns=time_ns(FRAMES_S))
    assert levelling_attitude(used.report.attitude) is not None
