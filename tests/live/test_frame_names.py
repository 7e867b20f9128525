"""No two frames of a session have one name, however often it is started again."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.live import finish_session
from fieldgrid.live.kept.frame_names import told_apart
from fieldgrid.maps import open_map
from fieldgrid.recordings import open_recording
from tests.live.making import begin


def test_names_that_come_again_are_told_apart() -> None:
    names = ["a", "b", "a", "a-2", "a", "c", "a-2"]
    assert told_apart(names) == ["a", "b", "a-3", "a-2", "a-4", "c", "a-2-2"]
    many = told_apart(["cam"] * 50_000)
    assert len(set(many)) == 50_000
    assert many[-1] == "cam-50000"


@pytest.mark.parametrize("named", [False, True])
def test_a_session_that_counts_its_frames_anew_makes_its_map(
    named: bool, leaning_drive: Path, tmp_path: Path
) -> None:
    """Started again after each second frame. Without names the session numbers frames itself; a
    stream (`--mcap`) numbers them from 0 in each program."""
    out = tmp_path / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        frames = list(recording.frames())
        inertial, fixes = recording.motion().inertial, recording.fixes()
        assert inertial is not None
        for start in range(0, len(frames), 2):
            live = begin(recording, out)
            if not start:
                live.push_imu(*inertial)
                for fix in fixes:
                    live.push_fix(fix)
            for k, frame in enumerate(frames[start : start + 2]):
                name = f"{k:06d}" if named else None
                assert live.push_pair(*frame.images(), frame.time_ns, frame_id=name, wait=True)
            live.stop()
    report = finish_session(out)
    assert (report.frames, report.used) == (6, 6)
    with open_map(out) as universal:
        found = [frame.frame_id for frame in universal.frames("drive")]
        times_ns = [frame.pose.time_ns for frame in universal.frames("drive")]
    again = [f"{name}{end}" for end in ("", "-2", "-3") for name in ("000000", "000001")]
    assert found == (again if named else [f"{k:06d}" for k in range(1, 7)])
    assert times_ns == [frame.time_ns for frame in frames]
