"""Points of a session that the disk does not take or has lost cost no frame and no session."""

from __future__ import annotations

import errno
import os
import zlib
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import BuildSettings, MapError, MapExistsError, MapWriteError
from fieldgrid.geometry import Tilt
from fieldgrid.live import discard_session, finish_from, finish_session, live_folder, replay
from fieldgrid.live.finish import NOT_LEVELLED
from fieldgrid.live.kept.kept_drive import POINTS
from fieldgrid.live.kept.kept_points import AGAIN_BYTES, LOST, RESERVE_BYTES, KeptPoints
from fieldgrid.live.kept.points_file import _MARK, _RECORD, MAGIC, PointsFile, packed
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.live.pose.running_tilt import RunningTilt
from fieldgrid.live.pose.sensor_rows import KEPT_NS, rows_of
from fieldgrid.maps import StageFile, open_map
from fieldgrid.perception import Sweep
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import open_recording
from tests.conftest import make_small_drive
from tests.live.making import Told, begin
from tests.pipeline.drives.making import content

pytestmark = pytest.mark.usefixtures("worked_out_once")

RECORD = packed(Sweep(np.ones((50, 3), np.float32)), 15.0)
LEAN = Tilt(0.5, 0.3, 0.2)


def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tilt is known from the first frame on."""
    monkeypatch.setattr(RunningTilt, "at", lambda _self, _time_ns: LEAN)


def test_a_disk_that_is_full_for_points_costs_no_frame(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known(monkeypatch)
    append, count = PointsFile.append, [0]

    def appending(self: PointsFile, record: bytes) -> object:
        count[0] += 1
        if count[0] == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return append(self, record)

    monkeypatch.setattr(PointsFile, "append", appending)
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


def test_a_record_that_did_not_fit_gives_its_room_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.pwrite

    def part(file: int, data: bytes, offset: int) -> int:
        if offset > len(MAGIC):
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, bytes(data)[:10], offset)

    with PointsFile(tmp_path / POINTS) as file:
        monkeypatch.setattr("fieldgrid.live.kept.points_file.os.pwrite", part)
        with pytest.raises(OSError, match="No space"):
            file.append(RECORD)
    assert (tmp_path / POINTS).read_bytes() == MAGIC


def test_no_points_are_kept_below_the_reserve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "free")
    free = [RESERVE_BYTES]
    monkeypatch.setattr(
        "fieldgrid.live.kept.kept_points.shutil.disk_usage", lambda _path: usage(free[0])
    )
    with KeptPoints(tmp_path / POINTS, 15.0, 1 << 40, None) as kept:
        assert kept.add(RECORD, 1) is not None
        free[0] -= 1
        assert kept.add(RECORD, 2) is None
        assert "less than 1 GB free" in kept.take_warning()
        free[0] += 1  # files come and go
        assert kept.record(Sweep(np.ones((50, 3), np.float32))) is None
        assert kept.add(RECORD, 3) is None
        assert not kept.take_warning()
        free[0] = AGAIN_BYTES
        record = kept.record(Sweep(np.ones((50, 3), np.float32)))
        assert kept.add(record, 4) is not None
        assert kept.take_warning() == "The points of frames are kept again."
        free[0] = RESERVE_BYTES
        assert kept.add(RECORD, 5) is not None
        assert not kept.take_warning()


@pytest.mark.parametrize("dtype", ["int16", "int32", "float64", ">f4", ">f8", ">i2", "f2"])
def test_points_of_any_numbers_are_kept(dtype: str, tmp_path: Path) -> None:
    points = np.array([[1, 2, 3], [90, 0, 0]], dtype)
    with KeptPoints(tmp_path / POINTS, 15.0, 1 << 30, None) as kept:
        place = kept.add(kept.record(Sweep(points)), 1)
        found = kept.read(place, None)  # type: ignore[arg-type] - a sweep asks for none
    assert isinstance(found, Sweep)
    assert np.array_equal(found.points_m[0], points[0])
    assert np.isnan(found.points_m[1]).all()
    assert found.points_m.dtype.isnative


def test_records_that_hold_points_in_another_byte_order_are_read(tmp_path: Path) -> None:
    """Those of earlier versions."""
    points = np.array([[1.5, -2.0, 3.0], [4.0, 5.0, 6.0]], ">f4")
    head = b'[false, 0, [[">f4", [2, 3], false]]]'
    data = zlib.compress(points.reshape(-1, 1).view(np.uint8).reshape(-1, 4).T.tobytes())
    check = zlib.crc32(data, zlib.crc32(head))
    with PointsFile(tmp_path / POINTS) as file:
        place = file.append(_RECORD.pack(_MARK, len(head), len(data), check) + head + data)
        found = file.read(place, None)  # type: ignore[arg-type]
    assert isinstance(found, Sweep)
    assert found.points_m.dtype == np.float32
    assert np.array_equal(found.points_m, points)


BOMB = zlib.compress(bytes(80 << 20))


@pytest.mark.parametrize(
    ("header", "data"),
    [
        ('[false, 0, [["float32", [7000000, 3], false]]]', BOMB),
        ('[false, 0, [["float32", [2, 3], false]]]', BOMB),
        ('[false, 0, [["float32", [2, 3], false]]]', zlib.compress(bytes(23))),
        ('[false, 0, [["float32", [-2, 3], false]]]', zlib.compress(b"")),
        ('[false, 0, [["float32", [-2, -3], false]]]', zlib.compress(bytes(24))),
        (
            '[false, 0, [["float32", [-1, 3], false], ["float32", [9], false]]]',
            zlib.compress(bytes(24)),
        ),
        ('[false, 0, [["O", [1], false]]]', zlib.compress(bytes(8))),
        ('[false, 0, [["i4,i4", [1], false]]]', zlib.compress(bytes(8))),
        ('[false, 0, [[1, [1], false]]]', zlib.compress(bytes(8))),
        ("[false, 0, []]", zlib.compress(b"")),
        ("[false, 0, 5]", zlib.compress(b"")),
        (100_000 * "[", b""),
        ("[false, 0, []]", b"none"),
    ],
)  # fmt: skip
def test_a_record_of_another_program_is_a_lost_one(
    header: str, data: bytes, tmp_path: Path
) -> None:
    head = header.encode()
    check = zlib.crc32(data, zlib.crc32(head))
    record = _RECORD.pack(_MARK, len(head), len(data), check) + head + data
    with PointsFile(tmp_path / POINTS) as file:
        place = file.append(record)
        assert file.has(place)
        assert file.read(place, None) is None  # type: ignore[arg-type]


def test_points_that_cannot_be_packed_cost_no_frame(tmp_path: Path) -> None:
    with KeptPoints(tmp_path / POINTS, 15.0, 1 << 30, None) as kept:
        assert kept.record(Sweep(np.array([["a", "b", "c"]]))) is None  # type: ignore[arg-type]
        assert "cannot be kept" in kept.take_warning()
        assert kept.add(None, 1) is None


def test_rates_that_end_in_a_long_gap_are_taken() -> None:
    time_ns = np.arange(0, 40_000_000_000, 100_000_000)
    rate = np.zeros((len(time_ns), 3))
    rate[50:] = np.nan
    running = RunningTilt()
    running.add_rows("inertial", rows_of("inertial", time_ns, rate, np.zeros_like(rate)))
    late = time_ns + 40_000_000_000
    running.add_rows("inertial", rows_of("inertial", late, 0.0 * late[:, None] + [0.0] * 3, rate))
    assert running.track("inertial").time_ns.tolist() == late[late >= late[-1] - KEPT_NS].tolist()


@pytest.mark.parametrize("failing", ["points", "stage"])
def test_all_files_are_synced_though_one_fails(
    failing: str, leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise OSError(errno.EIO, "Input/output error")

    with open_recording(leaning_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
    live.stop()
    synced: list[str] = []
    with SessionFolder(tmp_path / "m.gpkg", None) as kept:
        for name in ("stage", "journal", "points"):
            file = getattr(kept, name)
            monkeypatch.setattr(
                type(file), "sync", lambda _self, name=name: synced.append(name) or True
            )
        assert kept.sync()
        assert synced == ["stage", "journal", "points"]
        synced.clear()
        monkeypatch.setattr(type(getattr(kept, failing)), "sync", lambda _self: refuse())
        assert not kept.sync()
        assert synced == [name for name in ("stage", "journal", "points") if name != failing]
        monkeypatch.undo()


def lose(points: Path, how: str) -> None:
    if how == "missing":
        points.unlink()
    elif how == "empty":
        points.write_bytes(b"")
    else:
        data = points.read_bytes()
        points.write_bytes(bytes(512) + data[512:])


@pytest.mark.parametrize(
    "how", ["missing", *(pytest.param(how, marks=pytest.mark.long) for how in ("empty", "head"))]
)
def test_level_frames_whose_points_are_lost_are_in_the_map_as_driven(
    how: str, leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known(monkeypatch)
    out = tmp_path / "m.gpkg"
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        replay(live, recording, rate=None)
        live.stop()
    lose(live_folder(out) / POINTS, how)
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
    (live_folder(out) / POINTS).unlink()
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


def test_a_session_with_a_damaged_head_goes_on_and_can_be_discarded(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known(monkeypatch)
    out, told = tmp_path / "m.gpkg", Told()
    with open_recording(leaning_drive) as recording:
        live = begin(recording, out)
        for frame in recording.frames(0, 3):
            live.push_frame(frame, wait=True)
        live.drain()
        live.stop()
        lose(live_folder(out) / POINTS, "head")
        live = begin(recording, out, on_result=told)
        assert live.counts.frames == 3
        replay(live, recording, rate=None)
        assert live.counts.frames == 6
        live.stop()
    (text,) = told.texts("disk")
    assert text == LOST
    with SessionFolder(out, None) as kept:
        assert all(frame.is_level for frame in kept.drive.frames)
    assert discard_session(out) == ("drive", 6)
    assert not live_folder(out).exists()


def test_a_damaged_head_before_the_first_frame_is_written_anew(tmp_path: Path) -> None:
    (tmp_path / POINTS).write_bytes(MAGIC[:5])
    with KeptPoints(tmp_path / POINTS, 15.0, 1 << 30, None) as kept:
        place = kept.add(RECORD, 1)
        assert place is not None
        assert place.start == len(MAGIC)
        assert not kept.is_lost


def test_a_file_of_points_that_cannot_be_opened_is_closed(tmp_path: Path) -> None:
    (tmp_path / POINTS).write_bytes(b"something else")
    before = os.listdir("/proc/self/fd")
    with pytest.raises(MapError, match="holds no points"):
        PointsFile(tmp_path / POINTS)
    assert len(os.listdir("/proc/self/fd")) == len(before)


def test_the_head_is_on_the_disk_when_a_session_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[bytes] = []
    monkeypatch.setattr(
        "fieldgrid.live.kept.points_file.os.fsync",
        lambda file: synced.append(os.pread(file, 99, 0)),
    )
    PointsFile(tmp_path / POINTS).close()
    assert synced == [MAGIC]


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
    with pytest.raises(MapExistsError, match="The drive is kept"):
        finish_session(out)
    assert live_folder(out).exists()


def test_points_of_a_frame_that_is_not_kept_give_their_room_back(
    leaning_drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_self: StageFile, _frame: object) -> int:
        raise MapWriteError("The disk is full.")

    monkeypatch.setattr(StageFile, "append", refuse)
    with open_recording(leaning_drive) as recording:
        live = begin(recording, tmp_path / "m.gpkg")
        live.push_frame(next(iter(recording.frames())), wait=True)
        live.drain()
        assert live.counts.dropped == 1
        live.stop()
    assert (live_folder(tmp_path / "m.gpkg") / POINTS).read_bytes() == MAGIC
