"""What is kept of a session for who looks on, and what of it is new."""

from __future__ import annotations

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image

from fieldgrid.geometry import Status
from fieldgrid.live import LivePose, LiveState, What
from fieldgrid.live.servers import live_state
from tests.live.servers.making import event, noisy, pose_of, settled, window


def test_cells_are_told_as_they_are() -> None:
    sent = noisy((30, 40), pose_of(1.0, 2.0))
    told = LiveState()
    told.take(sent)
    cells = base64.b64decode(told.told()["window"]["cells"])
    cost, age, sigma = np.moveaxis(np.asarray(Image.open(io.BytesIO(cells)))[::-1], -1, 0)
    np.testing.assert_array_equal(cost, sent.costmap.costs)
    # No cell is said to be newer or surer than it is, up to the most that can be said.
    late = 0.25 * age - np.minimum(sent.age_s, 63.5)
    assert (late >= -1e-3).all()
    assert (late < 0.251).all()
    off = 0.01 * sigma - np.minimum(sent.sigma_m, 2.54)
    assert (off >= -1e-6).all()
    assert (off < 0.0101).all()
    assert {age.max(), sigma.max()} == {254}


def test_what_was_not_seen_is_not_known() -> None:
    sent = window(None)
    pixels = np.asarray(Image.open(io.BytesIO(live_state.draw_cells(sent))))
    assert (pixels[:, :100] == 255).all()
    assert (pixels[:, 100:, 1:] < 255).all()
    # The wall is north of the middle, which is above it in the picture.
    assert set(np.flatnonzero(pixels[:, 150, 0] == 254)) == set(range(75, 80))


def test_a_window_says_all_that_is_known_of_the_vehicle() -> None:
    told = LiveState("row 3")
    told.take(
        window(pose_of(10.0, -3.0), gear=-1, doubt="no fix", fixes=[(9.0, -3.0), (9.5, -3.0)])
    )
    said = json.loads(json.dumps(told.told(), allow_nan=False))
    shown = said["window"]
    assert (said["session"], shown["doubt"], shown["trusted"]) == ("row 3", "no fix", False)
    assert shown["pose"]["heading_deg"] == 90.0
    assert shown["pose"]["gear"] == shown["gear"] == -1
    assert shown["bounds_m"] == pytest.approx([0.0, -13.0, 20.0, 7.0])
    assert shown["fixes"] == [[9.0, -3.0, 4, False], [9.5, -3.0, 4, True]]
    told.take(window(pose_of(np.nan, np.nan, np.nan, Status.REJECTED)))
    pose = json.loads(json.dumps(told.told(), allow_nan=False))["window"]["pose"]
    assert (pose["east_m"], pose["heading_deg"], pose["is_good"]) == (None, None, False)
    told.take(window(None))
    assert told.told()["window"]["pose"] is None


def test_only_what_is_new_of_the_path_is_told_again() -> None:
    told = LiveState()
    assert told.told() == {
        "session": "", "number": 0, "walked": 0, "said": 0, "path": [], "events": [], "window": None
    }  # fmt: skip
    told.take(settled(1.0, 0.0))
    told.take(settled(2.0, 0.0, Status.REJECTED))
    told.take(event("first"))
    told.take(LivePose("8", pose_of(9.0, 9.0), 1, is_settled=False))  # it may still move
    told.take(settled(np.nan, np.nan, Status.REJECTED))
    first = told.told()
    assert first["path"] == [(1.0, 0.0, 1, True), (2.0, 0.0, 1, False)]
    assert first["events"] == [("pose", "first")]
    told.take(settled(3.0, 0.0))
    told.take(event("second"))
    told.take(event("every frame is dropped", What.FRAME_DROPPED))
    second = told.told(first["walked"], first["said"])
    assert [step[0] for step in second["path"]] == [3.0]
    assert second["events"] == [("pose", "second")]
    assert second["number"] == 2
    assert told.told(second["walked"], second["said"])["path"] == []


def test_it_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_state, "MOST_PATH", 5)
    told = LiveState()
    for k in range(100):
        told.take(settled(float(k), 0.0))
        told.take(event(str(k)))
    known = told.told()
    assert [step[0] for step in known["path"]] == [95.0, 96.0, 97.0, 98.0, 99.0]
    assert [text for _, text in known["events"]] == [str(k) for k in range(70, 100)]
    # Who heard the 90th long ago gets what is still there.
    assert [step[0] for step in told.told(98, 98)["path"]] == [98.0, 99.0]
    assert len(told.told(2, 0)["path"]) == 5


def test_whoever_waits_is_told_of_windows_and_events() -> None:
    calls: list[int] = []
    told = LiveState("", lambda: calls.append(told.number))
    told.take(settled(1.0, 0.0))
    told.take(window(None))
    told.take(event("said"))
    assert calls == [1, 2]
