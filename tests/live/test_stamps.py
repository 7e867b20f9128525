"""Stamps of one source that run away are refused; the time of all sources is followed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.geometry import Status
from fieldgrid.live import LiveOptions, LivePose, LiveWindow
from fieldgrid.live.pose.poser import Poser
from fieldgrid.live.pose.sensor_rows import rows_of
from fieldgrid.live.pose.stamps import FIXES, TIMES_OFF, Stamps
from fieldgrid.recordings import open_recording
from tests.live.making import Told, begin
from tests.live.test_poser import DATUM, RIG, SETTINGS, SPEED_MPS, at_ns, fix, frame
from tests.pipeline.drives.making import content

DAY_S = 86_400.0


def gyro(stamps: Stamps, seconds: float) -> bool:
    taken, _ = stamps.rows("gyro", rows_of("gyro", at_ns(seconds), 0.0))
    return taken is not None


def driven_to(stamps: Stamps, until_s: float, since_s: float = 0.0) -> None:
    """Fixes, gyro and frames, none of which is refused."""
    for k in range(round(5.0 * since_s), round(5.0 * until_s) + 1):
        assert not stamps.fix(at_ns(k / 5.0)).why
        assert gyro(stamps, k / 5.0)
        assert not stamps.frame(at_ns(k / 5.0)).why


@pytest.mark.parametrize("ahead_s", [11.0, 300.0, 1000.0 * DAY_S])
def test_a_source_that_runs_away_is_refused_until_it_is_back(ahead_s: float) -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    for k in range(50, 200):
        seconds = k / 5.0
        assert not gyro(stamps, seconds + ahead_s)
        assert not stamps.frame(at_ns(seconds)).why
        assert not stamps.fix(at_ns(seconds)).why
    driven_to(stamps, 60.0, 40.0)


def test_what_is_refused_is_told_once_in_a_while() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    told = []
    for k in range(500, 600):
        judged = stamps.rows("gyro", rows_of("gyro", at_ns(k / 50.0 + DAY_S), 0.0))[1]
        assert not stamps.fix(at_ns(k / 50.0)).why
        told += [judged.why] if judged.is_first else []
    assert told == ["Rows of gyro are stamped 86400 s ahead of all else, so poses do without them."]


@pytest.mark.parametrize("pause_s", [12.0, DAY_S])
def test_the_time_of_all_that_speak_is_followed(pause_s: float) -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    later_s = 10.0 + pause_s
    assert stamps.fix(at_ns(later_s)).why
    assert not gyro(stamps, later_s)
    # It is the last of them; nothing of another time was said meanwhile.
    assert not stamps.frame(at_ns(later_s)).why
    assert stamps.refuted == 0
    driven_to(stamps, later_s + 5.0, later_s)


def test_a_source_alone_is_followed_when_nobody_speaks_against_it() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    heard = [gyro(stamps, DAY_S + 0.1 * k) for k in range(20)]
    assert heard.index(True) == 15
    assert all(heard[15:])
    # Fixes go on as they did: it was the gyro.
    lost = [stamps.fix(at_ns(10.0 + 0.2 * k)).lost for k in range(1, 20)]
    assert lost.index(frozenset({"gyro"})) == TIMES_OFF - 1
    assert not gyro(stamps, DAY_S + 9.0)
    driven_to(stamps, 20.0, 14.0)


def test_a_frame_that_runs_away_is_refuted_by_what_comes_next() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    assert gyro(stamps, 10.0)
    assert "4 s ahead of all else" in stamps.frame(at_ns(14.0)).why
    assert stamps.refuted == 0
    assert gyro(stamps, 10.1)
    assert stamps.refuted == 1
    assert not stamps.frame(at_ns(10.2)).why


def test_frames_alone_may_be_far_apart() -> None:
    stamps = Stamps()
    assert not any(stamps.frame(at_ns(8.0 * k)).why for k in range(6))
    # Farther apart, the next one tells that it is right.
    refused = [bool(stamps.frame(at_ns(60.0 + 12.0 * k)).why) for k in range(6)]
    assert refused == [True, False, True, False, True, False]
    assert stamps.refuted == 0


def test_a_frame_ahead_is_right_when_others_come_to_its_time() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    assert gyro(stamps, 10.0)
    assert stamps.frame(at_ns(14.0)).why
    assert not stamps.fix(at_ns(14.2)).why
    assert not stamps.frame(at_ns(15.6)).why
    assert stamps.refuted == 0


def test_of_many_rows_those_that_run_away_are_left_out() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    seconds = [9.9, 10.0, DAY_S, 10.1, DAY_S + 0.1, 10.2]
    rows = rows_of("gyro", [at_ns(one) for one in seconds], np.arange(6.0))
    taken, judged = stamps.rows("gyro", rows)
    assert taken is not None
    assert taken.columns[0].tolist() == [0.0, 1.0, 3.0, 5.0]
    assert judged.is_first
    # A long push without a hole is no jump.
    long = rows_of("gyro", [at_ns(10.0 + k) for k in range(100)], np.zeros(100))
    taken, judged = stamps.rows("gyro", long)
    assert taken is long
    assert not judged.why


def test_one_fix_of_another_time_costs_nothing() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    assert "300 s ahead" in stamps.fix(at_ns(310.0)).why
    driven_to(stamps, 11.0, 10.2)
    assert "300 s behind" in stamps.fix(at_ns(-289.0)).why
    driven_to(stamps, 12.0, 11.2)


def test_a_receiver_whose_clock_jumps_is_not_followed_at_once() -> None:
    stamps = Stamps()
    for k in range(50):
        assert not stamps.fix(at_ns(0.2 * k)).why
    day = [stamps.fix(at_ns(DAY_S + 0.2 * k)).why for k in range(TIMES_OFF)]
    assert all(day[:-1])
    assert day[-1] == ""
    # And back again, with what was said at the other time forgotten.
    back = [stamps.fix(at_ns(10.0 + 0.2 * k)) for k in range(TIMES_OFF)]
    assert all(one.why for one in back[:-1])
    assert back[-1] == ("", False, frozenset({FIXES}), at_ns(10.0 + 0.2 * (TIMES_OFF - 1)))


def test_a_receiver_whose_clock_is_put_back_leaves_the_others_alone() -> None:
    stamps = Stamps()
    driven_to(stamps, 100.0)
    for k in range(3 * TIMES_OFF):
        assert gyro(stamps, 100.0 + 0.2 * k)
        assert "gyro" not in stamps.fix(at_ns(10.0 + 0.2 * k)).lost


def test_after_a_restart_any_time_may_come() -> None:
    stamps = Stamps()
    driven_to(stamps, 10.0)
    stamps.forget()
    driven_to(stamps, DAY_S + 1.0, DAY_S)


Off = Callable[[float], float]


@pytest.mark.parametrize("part", ["gyro", "wheels"])
@pytest.mark.parametrize(
    "ahead_s",
    [
        lambda s: 0.5 * DAY_S if s == 8.0 else 0.0,
        lambda s: 3600.0 if 8.0 <= s < 14.0 else 0.0,
        lambda s: 40.0 if s >= 8.0 else 0.0,
    ],
    ids=["once", "a while", "for good"],
)
def test_poses_go_on_while_a_sensor_runs_away(part: str, ahead_s: Off) -> None:
    told = Told()
    poser = Poser(RIG, SETTINGS, DATUM, LiveOptions(), told)
    for k in range(101):
        seconds = k / 5.0
        poser.put(fix(seconds))
        for one, value in (("gyro", 0.0), ("wheels", SPEED_MPS)):
            off_s = ahead_s(seconds) if one == part else 0.0
            poser.put((one, rows_of(one, at_ns(seconds + off_s), value)))
        poser.put(frame(seconds, 0.2))
    poser.close()
    last = told.of(LiveWindow)[-1]
    assert last.is_trusted, last.doubt
    assert last.time_ns == at_ns(20.0)
    assert last.pose is not None
    assert math.hypot(last.pose.east_m, last.pose.north_m - 20.0 * SPEED_MPS) < 0.1
    assert all(one.pose.status is Status.OK for one in told.of(LivePose) if one.is_settled)
    texts = told.texts("input")
    assert texts
    assert all(f"Rows of {part} are stamped" in text for text in texts)


def test_frames_that_run_away_cost_themselves_only(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    """A frame stamped a day ahead is told; the map is that of a build without it."""
    out, told = tmp_path / "m.gpkg", Told()
    with open_recording(short_drive) as recording:
        with begin(recording, out, on_result=told) as live:
            frames = list(recording.frames())
            wild = [replace(frames[1], frame_id="wild", time_ns=at_ns(3e8))]
            fixes = iter(recording.fixes())
            for one in [*frames[:2], *wild, *frames[2:]]:
                if one.frame_id != "wild":
                    for fixed in fixes:
                        live.push_fix(fixed)
                        if fixed.time_ns > one.time_ns:
                            break
                assert live.push_frame(one, wait=True)
            for fixed in fixes:
                live.push_fix(fixed)
            live.drain()
            counts = live.counts
        assert (counts.frames, counts.late) == (6, 1)
    (text,) = told.texts("frame late")
    assert text.startswith("Frame wild is stamped ")
    assert text.endswith(" s ahead of all else; it was left out.")
    assert content(out) == content(built)


def test_frames_after_a_pause_of_all_are_kept(short_drive: Path, tmp_path: Path) -> None:
    """They are held until it is clear that all went on at that time."""
    with open_recording(short_drive) as recording:
        frames, fixes = list(recording.frames()), list(recording.fixes())
        with begin(recording, tmp_path / "m.gpkg") as live:
            for late_s in (0.0, 600.0):
                late_ns = round(1e9 * late_s)
                for one in frames[:3]:
                    assert live.push_frame(replace(one, time_ns=one.time_ns + late_ns), wait=True)
                for fixed in fixes:
                    live.push_fix(fixed._replace(time_ns=fixed.time_ns + late_ns))
            live.drain()
            assert (live.counts.frames, live.counts.late) == (6, 0)
            live.stop()
