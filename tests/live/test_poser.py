"""Poses and the window while driving: what is sure, what is not, and when fixes stop."""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import BuildSettings, Quality
from fieldgrid.geometry import (
    Datum,
    Fix,
    GridSpec,
    LeverArm,
    LocalGrid,
    Mount,
    Pose,
    Rig,
    Status,
    StereoCamera,
)
from fieldgrid.live import LiveEvent, LiveOptions, LivePose, LiveWindow, What, WindowDoubt
from fieldgrid.live.perceiver import PerceivedFrame
from fieldgrid.live.pose.estimator import Estimator
from fieldgrid.live.pose.fixed_lag import KEPT_S, EstimateInputs, FixedLagSmoother
from fieldgrid.live.pose.poser import Poser
from fieldgrid.live.pose.running_tilt import lean_advice
from fieldgrid.live.pose.sensor_rows import rows_of
from fieldgrid.live.pose.stamps import FIXES, FRAMES
from fieldgrid.live.results import Outbox
from fieldgrid.live.window import PlacedGrid, RollingWindow
from fieldgrid.maps import Transfer
from fieldgrid.maps.transfer import MeanFold
from fieldgrid.perception import CameraStep
from fieldgrid.poses import Attitude
from tests.live.making import Told
from tests.live.sources import TIMEOUT_S, Heard

DATUM = Datum(41.65, -4.72, 787.4)
RIG = Rig(
    StereoCamera(640, 480, 500.0, 320.0, 240.0, 0.12),
    Mount(1.0, 20.0),
    LeverArm(0.0, 0.0, 1.0),
    rear_axle_forward_m=0.0,
)
SPEC = GridSpec(4.0, 6.0, 0.1)
SETTINGS = BuildSettings(grid={"width_m": 4.0, "length_m": 6.0, "cell_m": 0.1})
START_NS = 1_700_000_000_000_000_000
SPEED_MPS = 1.0
GRID = LocalGrid(SPEC, np.full(SPEC.shape, 10, np.uint8), np.ones(SPEC.shape, np.bool_))


def at_ns(seconds: float) -> int:
    return START_NS + round(1e9 * seconds)


def fix(seconds: float, quality: Quality = Quality.RTK_FIXED) -> Fix:
    """A receiver on a vehicle that drives north, with some noise."""
    noise_m = 0.01 * math.sin(37.0 * seconds), 0.01 * math.cos(53.0 * seconds)
    lat, lon, height = DATUM.to_geodetic(noise_m[0], SPEED_MPS * seconds + noise_m[1], 1.0)
    return Fix(at_ns(seconds), float(lat), float(lon), float(height), quality, 14, sigma_m=0.02)


def frame(seconds: float, period_s: float | None) -> PerceivedFrame:
    """What a camera sees, which tells its own way since `period_s` ago or not at all."""
    step = None
    if period_s is not None:
        step = CameraStep(SPEED_MPS * period_s, 0.0, 0.0, 0.01, 0.05, 0.0, 0.0, 0.0, 0.1, 200)
    return PerceivedFrame(f"{seconds:.1f}", at_ns(seconds), GRID, True, step, 0.0)


def watched() -> tuple[Heard, Poser]:
    told = Heard()
    return told, Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)


def driven(until_s: float, fixes_until_s: float, *, follows: bool) -> Told:
    """What is told of a drive at 5 Hz whose fixes end before it."""
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(round(5.0 * until_s) + 1):
        seconds = k / 5.0
        if seconds <= fixes_until_s:
            poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        if seconds >= until_s - 15.0:  # further back nothing hangs on frames here
            poser.put(frame(seconds, 0.2 if follows else None))
    poser.close()
    return told


@pytest.mark.parametrize("follows", [True, False])
def test_when_fixes_stop_sigma_grows_until_the_window_is_not_trusted(follows: bool) -> None:
    last = [
        driven(20.0 + silent_s, 20.0, follows=follows).of(LiveWindow)[-1]
        for silent_s in (0.0, 1.0, 4.0, 14.0, 30.0)
    ]
    assert last[0].is_trusted
    assert last[0].pose is not None
    assert last[0].pose.position_sigma_m < 0.3
    known = [window.pose for window in last[:4]]
    sigmas_m = [pose.position_sigma_m for pose in known if pose is not None]
    assert len(sigmas_m) == 4
    assert all(b > a for a, b in pairwise(sigmas_m))
    assert not last[3].is_trusted
    assert not last[4].is_trusted
    assert "no fix for 30 s" in last[4].doubt or "no pose" in last[4].doubt
    # The camera carries it on.
    assert last[2].is_trusted is follows
    # True places stay within three of their sigmas.
    for pose in known:
        assert pose is not None
        off_m = math.hypot(pose.east_m, pose.north_m - SPEED_MPS * (pose.time_ns - START_NS) / 1e9)
        assert off_m < 3.0 * pose.position_sigma_m + 0.05


@pytest.mark.parametrize("has_tilt", [True, False])
def test_who_has_no_accelerometer_is_told_once_what_the_lean_costs(has_tilt: bool) -> None:
    """On a straight row nothing tells how the vehicle leans, by which an antenna far up is off."""
    told = Heard()
    rig = replace(RIG, antenna=LeverArm(0.0, 0.0, 3.0))
    poser = Poser(rig, SETTINGS, DATUM, LiveOptions(), told)

    def advice() -> list[LiveEvent]:
        return [event for event in told.of(LiveEvent) if "an accelerometer" in event.text]

    for k in range(101):
        seconds = 0.2 * k
        poser.put(fix(seconds))
        if has_tilt:
            poser.put(("tilt", rows_of("tilt", at_ns(seconds), 0.0, 0.0, 0.5)))
        poser.put(frame(seconds, 0.2))
        if k == 50 and not has_tilt:
            told.wait(lambda: bool(advice()))
    poser.close()
    assert told.of(LiveWindow)[-1].is_trusted is has_tilt
    assert len(advice()) == (not has_tilt)
    if not has_tilt:
        assert advice()[0].what is What.POSE
        assert "the antenna, 3.0 m up, may be 0." in advice()[0].text


def test_advice_on_the_lean_is_given_where_that_is_most_of_the_doubt() -> None:
    time_ns, one = np.array([0, 10**9]), np.ones(2)
    attitude = Attitude(time_ns, 0.0 * one, 0.0 * one, 5.0 * one, one, 0.0 * one, one, 8.0)
    text = lean_advice(attitude, 10**9, -3.0, 0.25)
    assert text.startswith(
        "Roll or pitch is known to 5° only, by which the antenna, 3.0 m up, may be 0.26 m off."
    )
    assert lean_advice(attitude, 10**9, 1.0, 0.25) == ""
    assert lean_advice(attitude, 10**9, 3.0, 0.4) == ""
    assert lean_advice(None, 10**9, 3.0, 0.25) == ""


def test_poses_are_told_when_they_are_good_and_again_when_they_are_settled() -> None:
    told = driven(20.0, 20.0, follows=True)
    by_frame: dict[str, list[LivePose]] = {}
    for pose in told.of(LivePose):
        by_frame.setdefault(pose.frame_id, []).append(pose)
    for poses in by_frame.values():
        assert len(poses) <= 2
        assert all(one.pose.status is Status.OK for one in poses)
        assert all(one.gear == 1 for one in poses)
        assert abs(poses[-1].pose.heading_deg) < 3.0 * poses[-1].pose.heading_sigma_deg
    settled = [float(name) for name, poses in by_frame.items() if poses[-1].is_settled]
    assert max(settled) == pytest.approx(18.0)
    assert (
        not told.of(LiveEvent)[-1].text.endswith("trusted.") or told.of(LiveWindow)[-1].is_trusted
    )


def test_no_frame_is_given_up_before_an_estimate_was_made_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A machine so slow that no estimate is ready before the end: the one of the end has all.
    monkeypatch.setattr("fieldgrid.live.pose.poser.Estimator.ask", lambda _self, _asked: None)
    monkeypatch.setattr(
        "fieldgrid.live.pose.poser.Estimator.is_free", property(lambda _self: False)
    )
    told = driven(20.0, 20.0, follows=True).of(LivePose)
    assert len({pose.frame_id for pose in told}) == 76
    assert all(pose.pose.status is Status.OK for pose in told)


def test_grids_of_poses_that_are_not_good_enough_stay_out_of_the_window() -> None:
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(100):
        poser.put(fix(0.2 * k, Quality.NONE))
        poser.put(frame(0.2 * k, 0.2))
    poser.close()
    assert not told.of(LiveWindow) or not told.of(LiveWindow)[-1].view.observed.any()
    assert any("not to be trusted" in text for text in told.texts("pose"))
    poses = told.of(LivePose)
    assert poses
    assert all(pose.pose.status is Status.REJECTED for pose in poses)
    # What is not known has a value in JSON, too.
    assert json.loads(json.dumps([one.as_dict() for one in told.results], allow_nan=False))


@pytest.mark.parametrize("is_level", [True, False])
def test_a_grid_that_is_not_level_lies_below_the_sensor_along_the_vehicles_axis(
    is_level: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The antenna is at the sensor: below it is the way of the fixes, however the vehicle leans."""
    placed: list[PlacedGrid] = []
    monkeypatch.setattr(RollingWindow, "_add", lambda _self, _cells, one: placed.append(one))
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(76):
        seconds = k / 5.0
        poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        poser.put(("tilt", rows_of("tilt", at_ns(seconds), 10.0, 0.0, 0.1)))
        if seconds >= 10.0:
            poser.put(frame(seconds, None)._replace(is_level=is_level))
    poser.close()
    tilt = poser.tilt.at(at_ns(15.0))
    assert tilt is not None
    assert tilt.roll_deg == pytest.approx(10.0, abs=0.5)
    assert len(placed) > 10
    to_the_left_m = 0.0 if is_level else RIG.mount.height_m * math.sin(math.radians(10.0))
    usual_m = float(np.median([one.pose.east_m for one in placed]))
    assert usual_m == pytest.approx(-to_the_left_m, abs=0.03)
    # What is told is where the vehicle is.
    told_m = [one.pose.east_m for one in told.of(LivePose)]
    assert float(np.median(told_m)) == pytest.approx(0.0, abs=0.03)


def test_fixes_that_are_not_used_are_told_with_the_reason() -> None:
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(60):
        away = fix(0.2 * k)
        if 30 <= k < 33:
            away = away._replace(lat_deg=away.lat_deg + 0.001)
        poser.put(away)
    poser.put(frame(11.8, None))
    poser.close()
    (text,) = told.texts("fix refused")
    assert text.startswith("A fix is not used: ")
    assert "m" in text


def test_a_receiver_that_was_silent_comes_back() -> None:
    """Of a drive with fixes at 0..20 s and from 40 s on, what is told at the end of it."""

    def told_at(until_s: float) -> LiveWindow:
        told, poser = watched()
        for k in range(round(5.0 * until_s) + 1):
            seconds = k / 5.0
            if not 20.0 < seconds < 40.0:
                poser.put(fix(seconds))
            poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
            if seconds >= until_s - 8.0:
                poser.put(frame(seconds, 0.2))
        poser.close()
        return told.of(LiveWindow)[-1]

    silent, back = told_at(39.8), told_at(46.0)
    assert not silent.is_trusted
    assert silent.doubt
    assert back.is_trusted
    assert back.pose is not None
    assert back.pose.position_sigma_m < 0.3
    assert math.hypot(back.pose.east_m, back.pose.north_m - 46.0 * SPEED_MPS) < 0.1
    assert back.view.observed.any()


def rest(poser: Poser) -> None:
    """Until there is an estimate of all that was pushed."""
    until_s = time.monotonic() + TIMEOUT_S
    while poser._inbox or not poser._is_asked or not poser._estimator.is_free:
        assert time.monotonic() < until_s
        time.sleep(0.01)


def is_without_frames(told: Told) -> bool:
    return any(window.doubt_code is WindowDoubt.NO_FRAMES for window in told.of(LiveWindow)[-1:])


def test_a_camera_that_was_unplugged_comes_back() -> None:
    told, poser = watched()
    for k in range(5 * 30 + 1):
        seconds = k / 5.0
        poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        if not 10.0 < seconds < 20.0:
            poser.put(frame(seconds, 0.2 if seconds != 20.0 else None))
        if seconds == 19.8:
            told.wait(lambda: is_without_frames(told))
    poser.close()
    assert told.of(LiveWindow)[-1].is_trusted
    settled = [float(one.frame_id) for one in told.of(LivePose) if one.is_settled]
    assert sorted(settled) == [k / 5.0 for k in range(5 * 28 + 1) if not 50 < k < 100]


def test_a_camera_that_comes_back_after_an_hour_is_where_the_vehicle_is_now() -> None:
    """The session goes on and holds no more than before; the camera's step over the hour, between
    rows that look alike, is not believed."""
    told, poser = watched()
    for k in range(5 * 20 + 1):
        poser.put(fix(k / 5.0))
        poser.put(("gyro", rows_of("gyro", at_ns(k / 5.0), 0.0)))
        poser.put(frame(k / 5.0, 0.2))
    told.wait(lambda: bool(told.of(LiveWindow)) and told.of(LiveWindow)[-1].is_trusted)
    back_s = 3620.0
    for seconds in [*range(21, 3600), *(back_s - 20.0 + k / 5.0 for k in range(101))]:
        poser.put(fix(seconds))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
    told.wait(lambda: is_without_frames(told) and told.of(LiveWindow)[-1].time_ns == at_ns(back_s))
    rest(poser)
    trailing = poser._trailing
    assert len(trailing._said[FIXES]) <= 5 * KEPT_S + 1
    assert not trailing._said[FRAMES]
    assert not poser._waiting
    before = len(told.results)
    poser.put(frame(back_s + 0.1, 0.2))
    told.wait(lambda: any(w.frame_id for w in told.of(LiveWindow)[-1:]))
    for k in range(1, 31):
        seconds = back_s + 0.1 + k / 5.0
        poser.put(fix(seconds))
        poser.put(frame(seconds, 0.2))
    poser.close()
    windows = [one for one in told.results[before:] if isinstance(one, LiveWindow)]
    off_m = [
        abs(w.pose.north_m - SPEED_MPS * (w.time_ns - START_NS) / 1e9) for w in windows if w.pose
    ]
    assert max(off_m) < 1.0
    assert windows[-1].is_trusted
    assert windows[-1].view.observed.any()


@pytest.mark.parametrize("jump_s", [3600.0, 300.0, 6.0, -6.0, -300.0])
def test_a_clock_that_jumps_and_comes_back_costs_that_while(jump_s: float) -> None:
    told, poser = watched()
    for k in range(5 * 65 + 1):
        seconds = k / 5.0
        moved_s = jump_s if 20.0 <= seconds < 35.0 else 0.0
        poser.put(fix(seconds)._replace(time_ns=at_ns(seconds + moved_s)))
        poser.put(("gyro", rows_of("gyro", at_ns(seconds), 0.0)))
        if seconds >= 60.0:
            poser.put(frame(seconds, 0.2))
    poser.close()
    last = told.of(LiveWindow)[-1]
    assert last.is_trusted, last.doubt
    assert last.pose is not None
    assert math.hypot(last.pose.east_m, last.pose.north_m - 65.0 * SPEED_MPS) < 0.1


def test_a_frame_without_a_step_waits_for_no_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a depth camera or a lidar: gyro and wheels place it."""
    told, poser = watched()

    def put(from_s: float, until_s: float) -> None:
        for k in range(round(20.0 * from_s), round(20.0 * until_s) + 1):
            poser.put(("gyro", rows_of("gyro", at_ns(k / 20.0), 0.0)))
            poser.put(("wheels", rows_of("wheels", at_ns(k / 20.0), SPEED_MPS)))

    put(0.0, 20.0)
    for k in range(101):
        poser.put(fix(k / 5.0))
    poser.put(frame(20.0, None))
    told.wait(lambda: any(one.frame_id == "20.0" for one in told.of(LivePose)))
    monkeypatch.setattr(
        "fieldgrid.live.pose.poser.Estimator.is_free", property(lambda _self: False)
    )
    put(20.0, 20.4)
    poser.put(frame(20.4, None))
    told.wait(lambda: any(window.frame_id == "20.4" for window in told.of(LiveWindow)))
    placed = next(one.pose for one in told.of(LivePose) if one.frame_id == "20.4")
    assert math.hypot(placed.east_m, placed.north_m - 20.4 * SPEED_MPS) < 0.05
    assert abs(placed.heading_deg) < 3.0 * placed.heading_sigma_deg
    assert not any(one.is_settled for one in told.of(LivePose))
    poser.close()


def test_a_window_is_told_before_the_estimate_that_has_its_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told, poser = watched()
    asked_of: list[tuple[str, bool]] = []

    def asking(_self: Estimator, asked: EstimateInputs) -> None:
        name = f"{(asked.frame_ns[-1] - START_NS) / 1e9:.1f}"
        asked_of.append((name, is_shown(told, name)))

    for k in range(61):
        poser.put(fix(k / 5.0))
    poser.put(("gyro", rows_of("gyro", at_ns(0.0) + np.arange(700) * 20_000_000, np.zeros(700))))
    poser.put(frame(12.0, None))
    told.wait(lambda: is_shown(told, "12.0"))
    rest(poser)  # an estimate that lacks the frame carries few of those that follow
    monkeypatch.setattr("fieldgrid.live.pose.poser.Estimator.ask", asking)
    monkeypatch.setattr("fieldgrid.live.pose.poser.Estimator.is_free", property(lambda _self: True))
    names = [f"{k / 5.0:.1f}" for k in range(61, 66)]
    for name in names:
        poser.put(frame(float(name), 0.2))
        told.wait(lambda name=name: is_shown(told, name))
    poser.close()
    assert {name for name, _ in asked_of} >= set(names[:-1])
    assert all(was_shown for _, was_shown in asked_of)


def is_shown(told: Told, name: str) -> bool:
    return any(window.frame_id == name for window in told.of(LiveWindow))


def test_memory_is_bounded_by_what_an_estimate_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    trailing = FixedLagSmoother(RIG, SETTINGS, DATUM, 20.0)
    for k in range(5 * 600):
        trailing.add_fix(fix(0.2 * k))
        trailing.add_frame(at_ns(0.2 * k), None)
        trailing.rows.add("gyro", rows_of("gyro", at_ns(0.2 * k), 0.0))
    sizes = [len(trailing._said[source]) for source in (FIXES, FRAMES)]
    sizes.append(len(trailing.rows.since(0)["gyro"].time_ns))
    assert max(sizes) <= 5 * 60 + 1
    monkeypatch.setattr("fieldgrid.live.results.MOST_WAITING", 3)
    outbox = Outbox()
    for k in range(5):
        outbox.put(LiveEvent(What.INPUT, str(k), 0))
    assert outbox.missed == 2
    outbox.close()
    events = (one for one in iter(outbox.take, None) if isinstance(one, LiveEvent))
    assert [event.text for event in events] == ["2", "3", "4"]


def test_windows_that_nobody_takes_do_not_pile_up() -> None:
    (*_, window) = driven(6.0, 6.0, follows=False).of(LiveWindow)
    outbox = Outbox()
    for k in range(4):
        outbox.put(LiveEvent(What.INPUT, str(k), 0))
        outbox.put(window)
    outbox.close()
    assert outbox.missed == 3
    taken = list(iter(outbox.take, None))
    assert [isinstance(one, LiveWindow) for one in taken] == [False] * 4 + [True]


def test_a_window_that_moves_along_has_what_a_fold_over_all_has() -> None:
    rng = np.random.default_rng(5)
    window = RollingWindow(0.1, Transfer.AREA, 12.0, SPEC.reach_m)
    placed = []
    for k in range(40):
        density = rng.integers(0, 255, SPEC.shape, dtype=np.uint8)
        grid = LocalGrid(SPEC, density, rng.random(SPEC.shape) < 0.7)
        pose = Pose(at_ns(k), 0.3 * k, 0.5 * k, 0.0, 10.0 * k, 0.02, 0.3, 1.0)
        placed.append(PlacedGrid(grid, pose, at_ns(k), 0.01 * (k + 1)))
        window.follow(pose)
        window.settle(placed[-2:-1])
    view, age_s, sigma_m = window.view(placed[-1:], DATUM, at_ns(41.0))
    fold = MeanFold(window.lattice, view.window, Transfer.AREA)
    # The window has forgotten what it left behind, so only its last frames are compared.
    middle = window.lattice.bounds(view.window)
    for one in placed[-8:]:
        fold.add(one.grid, one.pose)
    density, observed = fold.density()
    assert middle.west_m < placed[-1].pose.east_m < middle.east_m
    late = np.nan_to_num(age_s, nan=99.0) < 9.5
    untouched = MeanFold(window.lattice, view.window, Transfer.AREA)
    for one in placed[:-8]:
        untouched.add(one.grid, one.pose)
    alone = late & (untouched.sums[0] == 0)
    assert alone.sum() > 500
    np.testing.assert_array_equal(view.density[alone], density[alone])
    np.testing.assert_array_equal(view.observed[alone], observed[alone])
    assert np.nanmin(age_s) == pytest.approx(2.0)
    assert sigma_m[age_s == np.nanmin(age_s)] == pytest.approx(0.4)


def test_frames_that_stay_where_they_were_are_not_placed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    placed = [
        PlacedGrid(
            LocalGrid(SPEC, np.full(SPEC.shape, 20 * k, np.uint8), GRID.observed),
            Pose(at_ns(k), 0.0, 0.2 * k, 0.0, 3.0 * k, 0.02, 0.3, 1.0),
            *(at_ns(k), 0.1 + k),
        )
        for k in range(8)
    ]
    moved = [one._replace(pose=replace(one.pose, east_m=0.3)) for one in placed]
    window = RollingWindow(0.1, Transfer.AREA, 12.0, SPEC.reach_m)
    added: list[int] = []
    add = RollingWindow._add

    def adding(self: RollingWindow, cells: Any, frame: PlacedGrid) -> None:
        added.append(frame.time_ns)
        add(self, cells, frame)

    monkeypatch.setattr(RollingWindow, "_add", adding)

    def shown(frames: list[PlacedGrid], fewest: int, *, settled: int = 0) -> None:
        """The same as a window that never saw them, with so many added."""
        added.clear()
        found = window.view(frames, DATUM, at_ns(9.0))
        assert len(added) == fewest
        fresh = RollingWindow(0.1, Transfer.AREA, 12.0, SPEC.reach_m)
        fresh.settle(placed[:settled])
        given = fresh.view(frames, DATUM, at_ns(9.0))
        for ours, theirs in zip(
            (found[0].density, *found[1:]), (given[0].density, *given[1:]), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs)
        kept.append((found, [found[0].density.copy(), *(one.copy() for one in found[1:])]))

    kept: list[Any] = []
    shown(placed[:3], 3)
    shown(placed[:3], 0)
    shown(placed[:5], 2)
    shown([*placed[:4], moved[4]], 5)
    shown(placed[:2], 2)
    window.settle(placed[:2])
    shown(placed[2:6], 4, settled=2)
    shown(placed[2:7], 1, settled=2)
    # What was given out before has not changed since.
    for found, copied in kept:
        for ours, then in zip((found[0].density, *found[1:]), copied, strict=True):
            np.testing.assert_array_equal(ours, then)
