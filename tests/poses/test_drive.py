"""Where the batch estimate contradicts its gears."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import GearName, GearSpan, PoseSettings
from fieldgrid.geometry import Carrier, LeverArm, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.drive import contradicted_gear, lasting
from fieldgrid.poses.nodes import Nodes
from tests.scenes import paper_rig
from tests.simulated import DATUM, SLALOM, Command, fixes_of, gyro_of, simulate, steps_of
from tests.told import codes


@pytest.mark.parametrize("hz", [1, 5, 20])
def test_only_a_lasting_contradiction_counts(hz: int) -> None:
    time_s = np.arange(30 * hz) / hz
    brief = (time_s > 3.0) & (time_s < 4.0)  # a cusp that is misplaced
    long = (time_s >= 10.0) & (time_s <= 13.0)
    np.testing.assert_array_equal(lasting(brief | long, time_s), long)


def test_a_contradiction_at_the_ends_counts_too() -> None:
    time_s = np.arange(40) / 5.0
    against = (time_s < 2.0) | (time_s > 6.0)
    np.testing.assert_array_equal(lasting(against, time_s), against)
    assert not lasting(np.zeros(40, dtype=np.bool_), time_s).any()


K_TURNS_UNSEEN = [
    *(Command(20.0, 1.5), Command(5.0, 1.0, 0.35), Command(5.0, -0.8, -0.3)),
    *(Command(4.0, 1.2, 0.2), Command(20.0, 1.5)),
]


@pytest.mark.parametrize("shift_s", [1.0, 4.0, 7.0])
def test_a_hole_that_is_crossed_backwards_puts_its_gears_in_doubt(shift_s: float) -> None:
    """Of a K-turn whose cusps lie in holes, what is seen looks like turns forward."""
    drive = simulate(K_TURNS_UNSEEN, 35.0)
    fixes = fixes_of(drive, 1.0, 0.01)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    settings = PoseSettings(quality=4, accuracy_m=0.02)
    seen = fixes[(late_s + shift_s) % 10.0 < 5.0]
    track = estimate_poses(seen, Carrier(0.0), DATUM, settings).trajectory
    truth = drive.at((track.time_ns - fixes.time_ns[0]) / 1e9)
    off = np.abs(wrap_deg(track.heading_deg - np.degrees(truth.heading_rad)))
    assert not (off[track.accepted] > 90.0).any()


def test_gears_that_the_user_names_are_not_denied() -> None:
    drive = simulate(K_TURNS_UNSEEN, 35.0)
    fixes = fixes_of(drive, 1.0, 0.01)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    first, last = int(fixes.time_ns[0]), int(fixes.time_ns[-1])
    span = GearSpan(start_ns=first - 1, stop_ns=last, gear=GearName.FORWARD)
    settings = PoseSettings(quality=4, accuracy_m=0.02)
    accepted = [
        estimate_poses(
            fixes[(late_s + 4.0) % 10.0 < 5.0],
            Carrier(0.0),
            DATUM,
            settings.model_copy(update={"gear_spans": spans}),
        ).trajectory.accepted
        for spans in ((), (span,))
    ]
    assert accepted[0].sum() < accepted[1].sum()


@pytest.mark.parametrize("alone", [0, 1])
def test_a_start_that_the_user_names_counts_where_it_is_first_seen_to_drive(alone: int) -> None:
    """One fix before a hole of 8 s had no way to which it could belong."""
    drive = simulate([Command(20.0, -1.2), Command(10.0, -1.2, 0.1)], 25.0)
    fixes = fixes_of(drive, 0.2, 0.01)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    seen = fixes[(np.arange(len(fixes)) < alone) | (late_s > 8.0)]
    settings = PoseSettings(quality=4, accuracy_m=0.02, starts=GearName.REVERSE)
    found = estimate_poses(seen, Carrier(0.0), DATUM, settings)
    used = found.trajectory.accepted
    assert used.mean() > 0.7  # not in the hole
    assert (found.trajectory.gear[used] == -1).all()


@pytest.mark.parametrize(
    ("shifts_s", "noted"),
    [((0.0,), False), ((60.0,), True), ((-90.0,), True), ((-90.0, 0.0), False)],
)
def test_known_gears_of_another_time_are_told(shifts_s: tuple[float, ...], noted: bool) -> None:
    """A file of local times, say."""
    drive = simulate(SLALOM, 35.0)
    fixes = fixes_of(drive, 1.0, 0.01)
    starts = [int(fixes.time_ns[0]) + round(shift_s * 1e9) for shift_s in shifts_s]
    spans = tuple(
        GearSpan(start_ns=start, stop_ns=start + 10**10, gear=GearName.FORWARD) for start in starts
    )
    settings = PoseSettings(quality=4, accuracy_m=0.02, gear_spans=spans)
    notes = estimate_poses(fixes, Carrier(0.0), DATUM, settings).report.notes
    assert any("known gears are all of a time before or after" in note for note in notes) == noted


def test_the_shorter_stretch_beside_such_a_hole_is_in_doubt() -> None:
    """Fixes from 0 to 4 s, 10 to 12 s and 20 to 30 s; in the first hole it drives back."""
    time_s = np.arange(0.0, 30.1, 0.5)
    seen = (time_s <= 4.0) | ((time_s >= 10.0) & (time_s <= 12.0)) | (time_s >= 20.0)
    fix = np.where(seen, np.cumsum(seen) - 1, -1)
    at = Nodes(np.round(time_s * 1e9).astype(np.int64), fix, np.full(len(time_s) - 1, np.nan))
    forward = np.ones(len(time_s), dtype=np.int64)
    speed = np.where((time_s > 5.0) & (time_s < 8.0), -1.0, 1.0)
    assert not contradicted_gear(at, forward, np.ones(len(time_s))).any()
    # What follows the hole is seen for longer than what comes before it.
    np.testing.assert_array_equal(contradicted_gear(at, forward, speed), time_s < 10.0)
    both = np.where((time_s > 14.0) & (time_s < 17.0), -1.0, speed)
    denied = contradicted_gear(at, forward, both)
    # So are the holes beside it: a node there is as wrong as the stretch that it continues.
    assert denied[(time_s > 4.0) & (time_s < 20.0)].all()
    assert not denied[time_s >= 20.0].any()
    # With a change of gear in the hole there is nothing to deny.
    changed = np.where(time_s >= 10.0, -1, 1)
    assert not contradicted_gear(at, changed, np.where(time_s > 7.0, -1.0, 1.0)).any()


@pytest.mark.parametrize("turn_rad_s", [0.5, -0.5])
@pytest.mark.parametrize("past_deg", [-8.0, 0.0, 8.0])
def test_a_gyro_tells_which_way_a_hole_was_turned(turn_rad_s: float, past_deg: float) -> None:
    """Half a circle in a hole is as likely left as right; a wrong guess cannot be left again."""
    half = Command((np.pi + np.radians(past_deg)) / 0.5, 1.0, turn_rad_s)
    bend = [Command(8.0, 1.5), Command(3.0, 1.5, 0.3), Command(3.0, 1.5, -0.3), Command(8.0, 1.5)]
    drive = simulate([*bend, half, Command(20.0, 1.5)], 35.0)  # the bend shows the gyro's sense
    fixes = fixes_of(drive, 0.2, 0.01)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    some = fixes[(late_s < 18.0) | (late_s > drive.time_s[-1] - 15.0)]
    motion = Motion(gyro=gyro_of(drive, bias_dps=0.6, noise_dps=0.05))
    found = estimate_poses(some, Carrier(0.0), DATUM, motion=motion)
    trajectory = found.trajectory
    assert codes(found.report) == []
    seen = np.isin(trajectory.time_ns, some.time_ns)
    assert trajectory.accepted[seen].mean() > 0.95
    truth = drive.at((trajectory.time_ns - fixes.time_ns[0]) / 1e9)
    off_deg = np.abs(wrap_deg(trajectory.heading_deg - np.degrees(truth.heading_rad)))
    assert off_deg[seen].max() < 2.0


@pytest.mark.parametrize("turn_rad_s", [0.5, -0.5])
@pytest.mark.parametrize("hole_s", [(1.0, 1.0), (4.0, 12.0)])
def test_a_camera_tells_which_way_a_hole_was_turned(
    turn_rad_s: float, hole_s: tuple[float, float]
) -> None:
    """And what the camera sees of it neither tips the vehicle over nor moves its antenna."""
    half = Command((np.pi + np.radians(7.0)) / 0.5, 1.0, turn_rad_s)
    drive = simulate([Command(20.0, 1.5), half, Command(25.0, 1.5)], 35.0)
    fixes = fixes_of(drive, 0.2, 0.01)
    late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    before_s, after_s = hole_s
    some = fixes[(late_s < 20.0 - before_s) | (late_s > 20.0 + half.seconds + after_s)]
    rig = paper_rig(antenna=LeverArm(0.0, 0.0, 3.0), rear_axle_forward_m=0.0)
    found = estimate_poses(some, rig, DATUM, motion=Motion(steps=steps_of(drive, noise=1.0)))
    trajectory = found.trajectory
    assert codes(found.report) == []
    assert trajectory.accepted.mean() > 0.98
    truth = drive.at((trajectory.time_ns - fixes.time_ns[0]) / 1e9)
    off_deg = np.abs(wrap_deg(trajectory.heading_deg - np.degrees(truth.heading_rad)))
    assert off_deg.max() < 2.0
    off_m = np.hypot(trajectory.east_m - truth.east_m, trajectory.north_m - truth.north_m)
    assert off_m.max() < 0.3
    assert (off_m < 3.0 * np.sqrt(2.0) * trajectory.position_sigma_m).all()
    assert found.report.attitude is not None
    assert found.report.attitude.as_dict()["steepest_roll_deg"] < 3.0


def test_a_hole_whose_turns_a_gyro_saw_may_be_crossed_backwards() -> None:
    """Fixes to 4 s and from 20 s on; in the hole it backs up, as in a turn on a headland."""
    time_s = np.arange(0.0, 30.1, 0.5)
    seen = (time_s <= 4.0) | (time_s >= 20.0)
    fix = np.where(seen, np.cumsum(seen) - 1, -1)
    turned = np.zeros(len(time_s) - 1)
    time_ns = np.round(time_s * 1e9).astype(np.int64)
    forward = np.ones(len(time_s), dtype=np.int64)
    speed = np.where((time_s > 8.0) & (time_s < 12.0), -1.0, 1.0)
    assert not contradicted_gear(Nodes(time_ns, fix, turned), forward, speed).any()
    turned[20] = np.nan
    assert contradicted_gear(Nodes(time_ns, fix, turned), forward, speed).any()
