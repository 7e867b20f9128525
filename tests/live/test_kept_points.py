"""Points of a session that the disk does not take or has lost cost no frame and no session."""

from __future__ import annotations

import errno
import io
import zlib
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import BuildSettings, ConfigError
from fieldgrid.geometry import Tilt
from fieldgrid.live import finish_from, finish_session, live_folder, replay
from fieldgrid.live.finish import NOT_LEVELLED
from fieldgrid.live.kept.kept_points import AGAIN_BYTES, RESERVE_BYTES
from fieldgrid.live.kept.points import packed, unpacked
from fieldgrid.live.pose.running_tilt import RunningTilt
from fieldgrid.live.pose.sensor_rows import KEPT_NS, RecentRows, rows_of
from fieldgrid.maps import open_map
from fieldgrid.perception import Sweep
from fieldgrid.pipeline import Journal, build_map, read_journal
from fieldgrid.recordings import open_recording
from tests.conftest import make_small_drive
from tests.live.making import Told, begin
from tests.live.test_levelling import points_of
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")

SEEN = Sweep(np.ones((50, 3), np.float32))
LEAN = Tilt(0.5, 0.3, 0.2)


def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tilt is known from the first frame on."""
    monkeypatch.setattr(RunningTilt, "at", lambda _self, _time_ns: LEAN)


def test_a_disk_that_is_full_for_points_costs_no_frame(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known(monkeypatch)
    append, count = Journal.append, [0]

    def appending(self: Journal, kind: str, value: Any, *blobs: bytes) -> bool:
        count[0] += len(blobs) == 2 and kind == "frame"
        if len(blobs) == 2 and count[0] == 3:
            self.problem = OSError(errno.ENOSPC, "No space left on device")
            return False
        return append(self, kind, value, *blobs)

    monkeypatch.setattr(Journal, "append", appending)
    out, told = tmp_path / "m.gpkg", Told()
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out, on_result=told)
        replay(live, recording, rate=None)
        assert live.counts.frames == 6
        assert live.counts.dropped == 0
        live.stop()
    assert count[0] == 6
    text, again = told.texts("disk")
    assert "No space left" in text
    assert "until there is room the points of frames are not kept" in text
    assert again == "The points of frames are kept again."
    report = finish_session(out)
    assert report.frames == 6
    assert not report.bad
    assert sum("The points of 1 of 6 frames" in note for note in report.notes) == 1


def test_no_points_are_kept_below_the_reserve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "free")
    free = [RESERVE_BYTES]
    monkeypatch.setattr(
        "fieldgrid.live.kept.kept_points.shutil.disk_usage", lambda _path: usage(free[0])
    )
    kept = points_of(tmp_path)
    assert kept.packed(SEEN, 1)
    free[0] -= 1
    assert not kept.packed(SEEN, 2)
    assert "less than 1 GB free" in kept.warnings.pop()
    free[0] += 1  # files come and go
    assert not kept.packed(SEEN, 3)
    assert not kept.warnings
    free[0] = AGAIN_BYTES
    kept.kept(len(kept.packed(SEEN, 4)))
    assert kept.warnings.pop() == "The points of frames are kept again."
    free[0] = RESERVE_BYTES
    assert kept.packed(SEEN, 5)
    assert not kept.warnings


@pytest.mark.parametrize("dtype", ["int16", "int32", "float64", ">f4", ">f8", ">i2", "f2"])
def test_points_of_any_numbers_are_kept(dtype: str) -> None:
    points = np.array([[1, 2, 3], [90, 0, 0]], dtype)
    found = unpacked(packed(Sweep(points), 15.0), None)  # type: ignore[arg-type] - it asks for none
    assert isinstance(found, Sweep)
    assert np.array_equal(found.points_m[0], points[0])
    assert np.isnan(found.points_m[1]).all()
    assert found.points_m.dtype.isnative


BOMB = zlib.compress(bytes(80 << 20))
NPY = io.BytesIO()
np.save(NPY, np.zeros((2, 3), np.float32))
ARRAY = NPY.getvalue()


@pytest.mark.parametrize(
    ("header", "data"),
    [
        ("[null, [[83886080, 4]]]", BOMB),
        (f"[null, [[{len(ARRAY)}, 4]]]", BOMB),
        (f"[null, [[{len(ARRAY)}, 4]]]", zlib.compress(ARRAY)),  # not plane by plane
        (f"[null, [[{len(ARRAY)}, 1]]]", zlib.compress(ARRAY[:-1])),
        (f"[null, [[{len(ARRAY) - 1}, 1]]]", zlib.compress(ARRAY[:-1])),
        (f"[null, [[{len(ARRAY)}, 0]]]", zlib.compress(ARRAY)),
        (f"[null, [[{len(ARRAY)}, -3]]]", zlib.compress(ARRAY)),
        (f"[null, [[-1, 1], [{len(ARRAY) + 1}, 1]]]", zlib.compress(ARRAY)),
        ('[null, [["a", 1]]]', zlib.compress(ARRAY)),
        ("[null, [[0, 1]]]", zlib.compress(b"")),
        ("[null, []]", zlib.compress(b"")),
        ("[null, 5]", zlib.compress(b"")),
        (100_000 * "[", b""),
        ("[null, []]", b"none"),
    ],
)  # fmt: skip
def test_a_record_of_another_program_is_a_lost_one(header: str, data: bytes) -> None:
    record = len(header).to_bytes(4, "little") + header.encode() + data
    assert unpacked(record, None) is None  # type: ignore[arg-type]


def test_points_that_cannot_be_packed_cost_no_frame(tmp_path: Path) -> None:
    kept = points_of(tmp_path)
    assert not kept.packed(Sweep(np.array([["a", "b", "c"]])), 1)  # type: ignore[arg-type]
    assert "cannot be kept" in kept.warnings.pop()


def test_rates_that_end_in_a_long_gap_are_taken() -> None:
    time_ns = np.arange(0, 40_000_000_000, 100_000_000)
    rate = np.zeros((len(time_ns), 3))
    rate[50:] = np.nan
    running = RecentRows()
    running.add("inertial", rows_of("inertial", time_ns, rate, np.zeros_like(rate)))
    late = time_ns + 40_000_000_000
    running.add("inertial", rows_of("inertial", late, 0.0 * late[:, None] + [0.0] * 3, rate))
    assert (
        running.track("inertial", 1).time_ns.tolist() == late[late >= late[-1] - KEPT_NS].tolist()
    )


def damage_points(out: Path) -> None:
    """Change a byte in the points of each frame of a session."""
    path = live_folder(out) / "live"
    data = bytearray(path.read_bytes())
    for record in read_journal(path):
        if record.kind == "frame":
            data[record.blobs[1].start] ^= 1
    path.write_bytes(data)


def test_level_frames_whose_points_are_damaged_are_in_the_map_as_driven(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known(monkeypatch)
    out = tmp_path / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    damage_points(out)
    report = finish_session(out)
    assert report.frames == 6
    assert not report.bad
    assert NOT_LEVELLED not in report.notes
    assert sum("points" in note for note in report.notes) == 1
    with open_map(out) as universal:
        assert universal.sessions()[0].config["level_grids"] is True
    assert not live_folder(out).exists()


def test_frames_that_are_left_out_keep_the_session(
    leaning_drive: Path, built_level: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_recording(leaning_drive) as recording:
        unknown_ns = recording.frame_times_ns()[1]
        monkeypatch.setattr(
            RunningTilt, "at", lambda _self, at_ns: LEAN if at_ns > unknown_ns else None
        )
        out = tmp_path / "m.gpkg"
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    damage_points(out)
    for _ in range(2):  # another end finds the drive in the map and removes nothing
        report = finish_session(out)
        assert report.frames == 4
        (note,) = (note for note in report.notes if "left out" in note)
        assert note.startswith("2 frames are left out")
        assert "--finish-from" in note
        assert live_folder(out).exists()
    out.unlink()
    finish_from(out, leaning_drive)
    assert content(out) == content(built_level)
    assert not live_folder(out).exists()


def test_a_session_of_the_same_name_with_fewer_frames_is_another_drive(
    short_drive: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with open_recording(short_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    fewer = make_small_drive(tmp_path / "fewer" / "drive", range(20, 24))
    build_map([fewer], out, BuildSettings())
    with pytest.raises(ConfigError, match="The drive is kept"):
        finish_session(out)
    assert live_folder(out).exists()
