"""A journal: what was written is there again, whatever was cut off, damaged or refused."""

from __future__ import annotations

import errno
import io
import os
import random
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import MapError
from fieldgrid.pipeline import DAMAGED, Journal, read_journal


def said(path: Path) -> list[tuple[str, Any]]:
    """What the records of a journal say."""
    return [(record.kind, record.value) for record in read_journal(path)]


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A journal of twenty records, every third with two blobs."""
    path = tmp_path / "journal"
    with Journal(path) as journal:
        for k in range(20):
            blobs = (bytes([k]) * 50 * k, b"second") if k % 3 == 0 else ()
            assert journal.append("rows", [k, "ä" * k, 0.1 * k], *blobs)
        assert journal.sync()
    return path


def starts(path: Path) -> list[int]:
    return [record.start for record in read_journal(path)] + [path.stat().st_size]


def test_records_come_back_with_their_blobs(written: Path) -> None:
    with Journal(written) as journal:
        records = list(journal.records())
        assert [record.value for record in records] == [[k, "ä" * k, 0.1 * k] for k in range(20)]
        for k, record in enumerate(records):
            assert journal.at(record.start) == record
            read = [journal.read(blob) for blob in record.blobs]
            assert read == ([bytes([k]) * 50 * k, b"second"] if k % 3 == 0 else [])


def test_one_that_is_cut_off_has_every_record_before(written: Path) -> None:
    records, whole = said(written), written.read_bytes()
    for end in [*range(0, 25), *random.Random(3).sample(range(24, len(whole)), 60)]:
        written.write_bytes(whole[:end])
        found = said(written)
        assert found == records[: len(found)]
        assert len(found) == sum(start <= end for start in starts(written)[1:])
        with Journal(written) as journal:
            assert journal.append("fix", end, b"x" * 99)
        assert said(written) == [*found, ("fix", end)]


def test_what_a_kill_cut_off_is_no_damage_also_behind_some(written: Path) -> None:
    records, whole = said(written), written.read_bytes()
    *_, last, end = starts(written)
    for cut in range(last + 16, end):
        written.write_bytes(whole[:last] + bytes(100) + whole[last:cut])
        for _ in range(2):
            assert said(written) == [*records[:-1], (DAMAGED, 100)]
            Journal(written).close()
        with Journal(written) as journal:
            journal.append("fix", 1, bytes(9999))  # what was cut off does not take it in
        assert said(written)[-1] == ("fix", 1)


def test_damage_costs_its_record_alone_and_is_told_each_time(written: Path) -> None:
    records, whole, at = said(written), written.read_bytes(), starts(written)
    for k in (0, 7, 12, 19):
        for place in (0, 12, 25):  # mark, sum, JSON
            data = bytearray(whole)
            data[at[k] + place] ^= 0x55
            written.write_bytes(data)
            for _ in range(2):
                assert said(written) == [
                    *records[:k],
                    (DAMAGED, at[k + 1] - at[k]),
                    *records[k + 1 :],
                ]
                Journal(written).close()
    # Of a blob it is seen when that is read.
    data = bytearray(whole)
    data[at[4] - 1] ^= 0x55
    written.write_bytes(data)
    with Journal(written) as journal:
        first, second = list(journal.records())[3].blobs
        assert journal.read(first) == bytes([3]) * 150
        assert journal.read(second) is None


def test_zeros_that_a_power_cut_left_are_damage(written: Path) -> None:
    records, whole = said(written), written.read_bytes()
    written.write_bytes(whole + bytes(3000))
    assert said(written) == [*records, (DAMAGED, 3000)]
    written.write_bytes(bytes(len(whole)))
    with Journal(written) as journal:
        journal.append("rows", 1)
    assert said(written)[-1] == ("rows", 1)


def test_records_behind_a_long_damage_are_found_and_kept(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fieldgrid.pipeline.staging.journal._SEARCHED_BYTES", 16)
    records, whole, at = said(written), written.read_bytes(), starts(written)
    written.write_bytes(whole[: at[5]] + bytes(2000) + whole[at[5] :])
    assert said(written) == [*records[:5], (DAMAGED, 2000), *records[5:]]


def test_a_file_of_others_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    path.write_bytes(b"something else altogether")
    with pytest.raises(MapError, match="no journal"):
        Journal(path)
    assert path.read_bytes() == b"something else altogether"


@pytest.mark.parametrize("length", [20, 6 * 500, 1 << 30])
def test_the_search_behind_damage_reads_little_for_marks_of_no_record(
    length: int, written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = 0

    class Counting(io.BufferedReader):
        def read(self, size: int | None = -1, /) -> bytes:
            nonlocal read
            data = super().read(size)
            read += len(data)
            return data

    whole, at = written.read_bytes(), starts(written)
    mark = whole[at[1] : at[1] + 4] + length.to_bytes(4, "little") + bytes(8) + b'["'
    size = written.write_bytes(whole[: at[1]] + mark * 1000 + whole[at[2] :])
    monkeypatch.setattr(Path, "open", lambda path, _mode: Counting(io.FileIO(path)))
    monkeypatch.setattr("fieldgrid.pipeline.staging.journal._SEARCHED_BYTES", 16)
    assert said(written)[1:3] == [(DAMAGED, 18_000), ("rows", [2, "ää", 0.2])]
    assert read < 10 * size


class SmallDisk:
    """Takes bytes while there is room, of the last write a part."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room, self._pwrite = 1 << 30, os.pwrite
        monkeypatch.setattr("fieldgrid.pipeline.staging.journal.os.pwrite", self.pwrite)

    def pwrite(self, file: int, data: bytes | memoryview, offset: int) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        part = bytes(data[: self.room])
        self.room -= len(part)
        return self._pwrite(file, part, offset)


def test_a_full_disk_loses_only_what_memory_does_not_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, disk = tmp_path / "journal", SmallDisk(monkeypatch)
    with Journal(path) as journal:
        disk.room = 1_000
        monkeypatch.setattr("fieldgrid.pipeline.staging.journal.MAX_WAITING_BYTES", 20_000)
        # A minute of a receiver and a gyro.
        taken = [journal.append("rows", [k, 0.1 * k]) for k in range(6000)]
        assert not journal.sync()
        assert taken[0]
        assert not taken[-1]
        assert journal.lost > 0
        assert len(list(read_journal(path))) == sum(taken)
        assert len(list(journal.records())) == 6000 - journal.lost  # with those that wait
        disk.room = 1 << 30
        assert journal.sync()
        assert journal.waits() == 0
        assert journal.append("rows", [6000, 0.0])
    kept = [value[0] for _, value in said(path)]
    assert kept == [*range(len(kept) - 1), 6000]
    assert len(kept) == 6001 - journal.lost


def test_of_a_record_with_blobs_a_full_disk_takes_all_or_nothing(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records, size, disk = said(written), written.stat().st_size, SmallDisk(monkeypatch)
    with Journal(written) as journal:
        disk.room = 500
        assert not journal.append("frame", 1, bytes(1000))
        assert journal.problem.errno == errno.ENOSPC
        assert written.stat().st_size == size
        disk.room = 500
        assert journal.append("frame", 2, bytes(100))
        disk.room = 10
        assert not journal.append("fix", 3)  # it waits, and goes before what follows
        assert not journal.append("frame", 4, bytes(1))
        disk.room = 1 << 30
        assert journal.append("frame", 5, bytes(1))
    assert said(written) == [*records, ("frame", 2), ("fix", 3), ("frame", 5)]


def test_an_error_on_opening_leaves_no_file_open(tmp_path: Path) -> None:
    (tmp_path / "journal").write_bytes(b"something else")
    before = os.listdir("/proc/self/fd")
    with pytest.raises(MapError, match="no journal"):
        Journal(tmp_path / "journal")
    assert len(os.listdir("/proc/self/fd")) == len(before)


def test_the_journal_of_another_version_is_refused(written: Path) -> None:
    data = written.read_bytes()
    written.write_bytes(data.replace(b"journal 4", b"journal 2", 1))
    with pytest.raises(MapError, match="of another version of this program"):
        list(read_journal(written))
