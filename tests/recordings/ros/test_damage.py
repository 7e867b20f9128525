"""Bags that end early, were never closed, or hold wrong bytes give all that is readable."""

from __future__ import annotations

import random
import re
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings import decode
from fieldgrid.recordings.ros.bag import open_bag
from tests.recordings.ros.samples import (
    MCAP_COMPRESSIONS,
    ROS1_COMPRESSIONS,
    ROS2,
    Plain,
    add_rows,
    expected,
    read,
    samples,
    write,
    write_folder,
    write_mcap,
    write_old_db3,
)

SENTENCE = re.compile(r"[^\n]+; \d+ messages? up to [-\d:TZ]+ are used\.")


def is_sentence(text: str) -> bool:
    return re.fullmatch(r"[^\n]+\.", text) is not None


def read_or_refuse(path: Path) -> tuple[list[Plain], str]:
    """What is readable of a damaged bag, none if it is refused with a sentence."""
    try:
        messages, damage = read(path)
    except RecordingError as error:
        assert is_sentence(str(error))  # noqa: PT017
        return [], str(error)
    assert damage == "" or SENTENCE.fullmatch(damage), damage
    return messages, damage


def ends(blob: bytes, messages: list[Plain]) -> list[int]:
    """Where in the file each message ends; they must not be compressed."""
    found = [blob.find(message.data) + len(message.data) for message in messages]
    assert found == sorted(set(found))
    return found


def check_cuts(path: Path, wanted: list[Plain], step: int) -> None:
    """However the uncompressed file is cut off, all messages before the cut are read."""
    blob = path.read_bytes()
    message_ends = ends(blob, wanted)
    cut = path.with_name(f"cut{path.suffix}")
    for offset in [*range(0, len(blob), step), len(blob) - 1]:
        cut.write_bytes(blob[:offset])
        messages, damage = read_or_refuse(cut)
        assert messages == wanted[: sum(end <= offset for end in message_ends)], offset
        assert len(messages) == len(wanted) or damage, offset


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_bag_cut_anywhere(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive.{kind}"
    check_cuts(path, write(path), 97)


def test_an_mcap_without_chunks_cut_anywhere(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    made = samples(ROS2)
    write_mcap(path, made, "none", use_chunking=False)
    check_cuts(path, expected(made, ROS2), 97)


def check_compressed_cuts(path: Path, wanted: list[Plain], chunk_starts: list[int]) -> None:
    """However the file is cut off, a prefix is read, which holds all whole chunks."""
    blob = path.read_bytes()
    cut = path.with_name(f"cut{path.suffix}")
    least, partial = 0, 0
    for offset in sorted({*range(0, len(blob), 197), *chunk_starts}):
        cut.write_bytes(blob[:offset])
        messages, damage = read_or_refuse(cut)
        assert messages == wanted[: len(messages)], offset
        assert len(messages) >= least, offset
        assert len(messages) == len(wanted) or damage, offset
        if offset in chunk_starts:
            least = len(messages)
        partial += len(messages) > least
    assert least == len(wanted)
    assert partial or path.suffix == ".bag"  # bz2 gives blocks of a whole chunk


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_cut_compressed_ros1_bag(compression: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    wanted = write(path, compression)
    blob = path.read_bytes()
    starts = [match.start() for match in re.finditer(rb"op=\x05", blob)]
    assert len(starts) > 3
    check_compressed_cuts(path, wanted, [*starts, blob.rindex(b"op=\x07")])


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_cut_compressed_mcap(compression: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    # Two parts of a chunk, so that the first of a torn chunk can be decompressed.
    made = samples(ROS2, side=200)
    write_mcap(path, made, compression, chunk_bytes=300_000)
    blob = path.read_bytes()
    name = len(compression).to_bytes(4, "little") + compression.encode()
    starts = [match.start() - 37 for match in re.finditer(re.escape(name), blob)]
    starts = [start for start in starts if blob[start] == 6]
    assert len(starts) > 3
    cut = path.with_name("cut.mcap")
    wanted = expected(made, ROS2)
    partial = 0
    before = 0
    for start, after in zip(starts, [*starts[1:], len(blob)], strict=True):
        cut.write_bytes(blob[:start])
        before = len(read_or_refuse(cut)[0])
        cut.write_bytes(blob[: start + 3 * (after - start) // 4])
        messages, damage = read_or_refuse(cut)
        assert messages == wanted[: len(messages)]
        assert len(messages) >= before
        assert re.search(r"cut\.mcap ends in the middle of a record: its last \d+", damage)
        partial += len(messages) > before
    assert partial >= len(starts) - 1
    assert before > 0


def test_a_ros1_bag_that_was_never_closed(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    wanted = write(path, "lz4")
    blob = path.read_bytes()
    at = blob.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(blob[at : at + 8], "little")
    path.write_bytes((blob[:at] + bytes(8) + blob[at + 8 :])[:index])
    messages, damage = read(path)
    assert messages == wanted
    assert damage == (
        "drive.bag was cut off, or not closed by its recorder: its end may be missing; "
        "60 messages up to 2024-06-01T12:00:02Z are used."
    )


def test_a_ros1_bag_that_lacks_only_its_index(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    wanted = write(path)
    blob = path.read_bytes()
    for end in (blob.rindex(b"op=\x07"), len(blob) - 3):
        path.write_bytes(blob[:end])
        assert read(path) == (wanted, "")


def test_a_ros1_bag_cut_between_chunks(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    write(path)
    blob = path.read_bytes()
    op = [match.start() for match in re.finditer(rb"\x04\x00\x00\x00op=\x05", blob)][2]
    start = blob.rindex(b"\x00\x00\x00", 0, op - 30)  # somewhere in the index before the chunk
    path.write_bytes(blob[:start])
    messages, damage = read(path)
    assert 0 < len(messages) < 60
    assert "drive.bag" in damage


def test_an_mcap_without_its_summary_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    wanted = write(path, "zstd")
    blob = path.read_bytes()
    data_end = blob.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")
    path.write_bytes(blob[: data_end + 13])
    assert read(path) == (wanted, "")
    path.write_bytes(blob[:data_end])
    messages, damage = read(path)
    assert messages == wanted
    assert "drive.mcap was cut off, or not closed by its recorder" in damage


CHUNK_MARKS = {"bag": rb"\x04\x00\x00\x00op=\x05", "mcap": rb"\x04\x00\x00\x00zstd"}


def second_chunk(path: Path) -> int:
    """Where the mark of the second chunk is."""
    pattern = CHUNK_MARKS[path.suffix[1:]]
    return [match.start() for match in re.finditer(pattern, path.read_bytes())][1]


@pytest.mark.parametrize(("kind", "compression"), [("bag", "none"), ("mcap", "zstd")])
def test_what_follows_a_damaged_place_is_read(kind: str, compression: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive.{kind}"
    wanted = write(path, compression)
    blob = bytearray(path.read_bytes())
    # The head of the second chunk, whose length is nonsense then.
    second = second_chunk(path)
    blob[second - 60 : second + 30] = b"\xff" * 90
    path.write_bytes(blob)
    messages, damage = read(path)
    lost = [message for message in wanted if message not in messages]
    first = wanted.index(lost[0])
    assert 0 < first < first + len(lost) < len(wanted)
    assert messages == wanted[:first] + wanted[first + len(lost) :]
    assert re.search(rf"drive\.{kind} holds 1 damaged place \(\d.*B\)", damage)
    assert f"drive.{kind} holds {len(lost)} unreadable messages" in damage


@pytest.mark.parametrize(
    ("kind", "compression", "op_at", "ops"),
    [("mcap", "zstd", -37, (7, 15, 2, 0, 200)), ("bag", "none", 7, (4, 99))],
)
def test_a_chunk_that_calls_itself_something_else_is_missed(
    kind: str, compression: str, op_at: int, ops: tuple[int, ...], tmp_path: Path
) -> None:
    """As MCAP, another kind of record that is skipped, and the end of the data."""
    path = tmp_path / f"drive.{kind}"
    write(path, compression)
    blob, op = bytearray(path.read_bytes()), second_chunk(path) + op_at
    assert blob[op] in (5, 6)
    for value in ops:
        blob[op] = value
        path.write_bytes(blob)
        messages, damage = read(path)
        assert 40 < len(messages) < 60
        assert f"holds {60 - len(messages)} unreadable messages" in damage


@pytest.mark.parametrize(
    ("kind", "compression"),
    [
        *(("mcap", compression) for compression in MCAP_COMPRESSIONS),
        *(("bag", compression) for compression in ROS1_COMPRESSIONS),
        ("db3", "none"),
    ],
)
def test_wrong_bytes_within_a_bag(kind: str, compression: str, tmp_path: Path) -> None:
    path = tmp_path / f"drive.{kind}"
    # Only an MCAP and bz2 have checksums; else contents may be wrong.
    exact = kind == "mcap" or compression == "bz2"
    check_flips(path, write(path, compression), random.Random(1), exact=exact)


def check_flips(path: Path, wanted: list[Plain], rng: random.Random, *, exact: bool = True) -> None:
    """Wrong bytes anywhere cost some messages, which is said, but not all and no crash."""
    blob = path.read_bytes()
    kept = 0
    for _ in range(100):
        changed = bytearray(blob)
        at = rng.randrange(len(blob))
        changed[at : at + 4] = rng.randbytes(4)
        path.write_bytes(changed[: len(blob)])
        messages, damage = read_or_refuse(path)
        kept += len(messages) > len(wanted) // 2
        if exact:
            found = iter(wanted)
            names = {message.topic for message in wanted}
            assert all(
                any(
                    (message.receive_ns, message.data) == (one.receive_ns, one.data)
                    for one in found
                )
                for message in messages
                if message.topic in names
            )
            assert damage or len(messages) == len(wanted)
        with open_bag(path) if messages else open_bag(_whole(path, blob)) as bag:
            for message in bag.messages():
                try:
                    decode(message)
                except RecordingError as error:
                    assert is_sentence(str(error))  # noqa: PT017
    assert kept > 60


def _whole(path: Path, blob: bytes) -> Path:
    path.write_bytes(blob)
    return path


def test_cut_database(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    wanted = write(path, count=400)
    blob = path.read_bytes()
    cut = tmp_path / "cut.db3"
    for offset in range(0, len(blob), 3333):
        cut.write_bytes(blob[:offset])
        messages, damage = read_or_refuse(cut)
        found = iter(wanted)
        assert all(message in found for message in messages), offset
        assert len(messages) == len(wanted) or damage, offset
        # The pages are about in the order of the rows, so what came before the cut is there.
        assert len(messages) >= len(wanted) * (offset - 20_000) // len(blob), offset
    assert re.search(r"cut\.db3 is cut off: its last \d+\.\d kB are missing", damage)


def test_rows_behind_a_damaged_page_are_read(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    write(path, count=400)
    blob = bytearray(path.read_bytes())
    middle = len(blob) // 2 // 4096 * 4096
    blob[middle : middle + 4096] = b"\xff" * 4096
    path.write_bytes(blob)
    messages, damage = read(path)
    assert 380 < len(messages) < 400
    assert "drive.db3 is a damaged database" in damage
    assert f"holds {400 - len(messages)} unreadable messages" in damage


def test_a_database_whose_recorder_was_killed(tmp_path: Path) -> None:
    made = samples(ROS2)
    live = tmp_path / "live.db3"
    database = write_old_db3(live, made[:20], journal="wal")
    database.execute("PRAGMA wal_checkpoint")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    add_rows(database, made[20:])
    path = tmp_path / "drive.db3"
    for end in ("", "-wal"):
        shutil.copyfile(f"{live}{end}", f"{path}{end}")
    database.close()
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert read(path) == (expected(made, ROS2), "")
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
    (tmp_path / "drive.db3-wal").write_bytes(before["drive.db3-wal"][:9000])  # a torn log
    assert read(path) == (expected(made[:20], ROS2), "")


def test_a_log_that_cannot_be_used_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "drive.db3"
    write(path)
    (tmp_path / "drive.db3-wal").write_bytes(b"log")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(RecordingError, match=r"No space left on device.*temporary files"):
        open_bag(path)


def test_an_interrupted_transaction_is_taken_back(tmp_path: Path) -> None:
    made = samples(ROS2)
    live = tmp_path / "live.db3"
    database = write_old_db3(live, made[:40])
    database.execute("PRAGMA cache_size = 1")  # so that the transaction reaches the file
    database.execute("BEGIN")
    database.execute("UPDATE messages SET data = zeroblob(5000)")
    path = tmp_path / "drive.db3"
    for end in ("", "-journal"):
        shutil.copyfile(f"{live}{end}", f"{path}{end}")
    database.close()
    assert read(path)[0] == expected(made[:40], ROS2)


def test_strange_rows_are_left_out(tmp_path: Path) -> None:
    made = samples(ROS2)
    path = tmp_path / "drive.db3"
    database = write_old_db3(path, made)
    for row in [(99, 1, b"x"), (1, "noon", b"x"), (1, 2, "text"), ("a", 2, b"x")]:
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    database.close()
    messages, damage = read(path)
    assert messages == expected(made, ROS2)
    assert "drive.db3 holds 4 unreadable messages" in damage


def test_cut_compressed_folder(tmp_path: Path) -> None:
    made = samples(ROS2)
    folder = tmp_path / "drive"
    write_folder(folder, made, "mcap", "file")
    file = folder / "drive.mcap.zstd"
    blob = file.read_bytes()
    for offset in range(0, len(blob), len(blob) // 20):
        file.write_bytes(blob[:offset])
        messages, _ = read_or_refuse(folder)
        assert messages == expected(made, ROS2)[: len(messages)]


def test_a_real_bag_cut_anywhere(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    path = shared_data("husky_gps_rosbag") / "test1.bag"
    wanted, _ = read(path)
    blob = path.read_bytes()
    cut = tmp_path / "cut.bag"
    counts = []
    for offset in range(100_000, len(blob), 250_000):
        cut.write_bytes(blob[:offset])
        messages, damage = read_or_refuse(cut)
        assert messages == wanted[: len(messages)]
        assert damage
        counts.append(len(messages))
    assert counts == sorted(counts)
    assert counts[-1] > 14_000


def test_a_pipe_is_no_bag(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is no file"):
        open_bag(Path("/dev/null"))


def test_the_database_module_is_not_told_to_write(tmp_path: Path) -> None:
    path = tmp_path / "drive.db3"
    write(path)
    path.chmod(0o444)
    before = path.read_bytes()
    assert len(read(path)[0]) == 60
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["drive.db3"]
    with sqlite3.connect(path) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()


def test_messages_before_their_connection_are_lost_each_time(tmp_path: Path) -> None:
    """A damaged bag: what the first run could not read, a later one does not give either."""

    def record(header: dict[str, bytes], data: bytes) -> bytes:
        fields = b"".join(
            (len(name) + 1 + len(value)).to_bytes(4, "little") + name.encode() + b"=" + value
            for name, value in header.items()
        )
        return len(fields).to_bytes(4, "little") + fields + len(data).to_bytes(4, "little") + data

    def message(secs: int) -> bytes:
        time = secs.to_bytes(4, "little") + bytes(4)
        return record({"conn": bytes(4), "op": b"\x02", "time": time}, b"\2\0\0\0ab")

    definition = record({"type": b"std_msgs/String", "message_definition": b"string data"}, b"")
    length = int.from_bytes(definition[:4], "little")
    connection = record(
        {"conn": bytes(4), "op": b"\x07", "topic": b"/a"}, definition[4 : 4 + length]
    )
    head = record({"op": b"\x03", "chunk_count": bytes(4), "index_pos": bytes(8)}, b"")
    path = tmp_path / "drive.bag"
    start = b"#ROSBAG V2.0\n" + head
    path.write_bytes(start + message(5) + message(6) + connection + message(7) + message(8))
    with open_bag(path) as bag:
        assert bag.topics["/a"].count == 2
        for _ in range(2):
            assert [one.receive_ns for one in bag.messages()] == [7 * 10**9, 8 * 10**9]
        assert "2 unreadable messages" in bag.damage
