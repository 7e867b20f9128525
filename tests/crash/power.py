"""Power cuts: what was not synced arrives in any part and order, sectors torn.

    python -m tests.crash.power 10000 [SEED]

Every command that changes a map runs once, while each call that changes a file is written down.
From that come as many states of the disk as are asked for: the power goes after any of the calls;
of what no sync has brought to the disk until then, any part is there, of a write any of its sectors
of 512 bytes, of the changes of names any first part. Each is opened as a user would: the map must
be bit for bit as it was after one of the command's own commits, and nothing that was acknowledged
may be lost. Needs a C compiler, for the library of `tests.crash.failures`.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.maps import open_map
from fieldgrid.maps.file import store
from fieldgrid.maps.file.database import keep_one_file
from tests.crash.failures import run_in_child
from tests.crash.operations import (
    Step,
    add,
    align,
    create,
    make,
    mark,
    merge,
    remove,
    rename,
    repair,
    repose,
    restore,
    shift,
    upgrade,
)

SECTOR = 512
WRITE, TRUNCATE, SYNC, UNLINK, RENAME, LINK, CREATE = range(1, 8)
_HEAD = struct.Struct("<6Q")
_LOOKED_AT_WHOLE = 200
"""Every so manyth state is verified, repaired and written to, too."""

_OLD_FORMAT = Path(__file__).resolve().parents[1] / "maps" / "file" / "format2.gpkg"


class Call(NamedTuple):
    """A call that changed a file or its name."""

    kind: int
    inode: int
    offset: int
    path: str
    to: str
    data: bytes


class Scene(NamedTuple):
    """A step, the map that it changes, and the file in which that shows."""

    step: Step
    begins_with: str
    shows_in: str = "map.gpkg"


def scenes(folder: Path) -> list[Scene]:
    """Every command that changes a map; `two` has an active session 0 and a removed one, 1."""
    copy = folder / "copy.gpkg"
    return [
        Scene(create(30.0), "nothing"),
        Scene(add("2", 50.0, 6), "two"),
        Scene(remove("0"), "two"),
        Scene(restore("1"), "two"),
        Scene(rename("0", "zero"), "two"),
        Scene(repose("0", -140.0), "two"),
        Scene(shift("0", 0.75), "two"),
        Scene(align(("0", "1"), 0.25), "two"),
        Scene(mark(3.0), "two"),
        Scene(repair(), "two"),
        Scene(merge(copy), "two", copy.name),
        Scene(merge(copy), "two and a copy", copy.name),
        Scene(upgrade(), "old"),
    ]


class Disk:
    """What is surely on the disk, and what was asked for since."""

    def __init__(self, files: dict[str, bytes], inodes: dict[str, int]) -> None:
        self.content = {inodes[name]: bytearray(data) for name, data in files.items()}
        self.names = dict(inodes)
        self.waiting: dict[int, list[Call]] = {}
        self.renaming: list[Call] = []

    def take(self, call: Call) -> None:
        """A call as the program made it; a sync brings what waits to the disk."""
        if call.kind in (WRITE, TRUNCATE):
            self.waiting.setdefault(call.inode, []).append(call)
        elif call.kind == SYNC and call.inode in self.content:
            for waiting in self.waiting.pop(call.inode, []):
                _write(self.content[call.inode], waiting, None)
        elif call.kind == SYNC:  # of the folder
            for change in self.renaming:
                _change_names(self.names, change)
            self.renaming.clear()
        else:
            if call.kind == CREATE:
                self.content[call.inode] = bytearray()
                self.waiting.pop(call.inode, None)
            self.renaming.append(call)

    def after_a_cut(self, random: np.random.Generator | None) -> dict[str, bytes]:
        """The files by name, with any part of what waits, or all of it where nothing is random."""
        names, files = dict(self.names), {}
        count = len(self.renaming)
        if random is not None:
            count = int(random.integers(count + 1))
        for change in self.renaming[:count]:
            _change_names(names, change)
        share = 1.0 if random is None else float(random.choice([0.0, 0.1, 0.5, 0.9, 1.0]))
        tearing = random is not None and random.random() < 0.5
        for name, inode in names.items():
            data = bytearray(self.content.get(inode, b""))
            for call in self.waiting.get(inode, ()):
                if random is None or random.random() < share:
                    torn = random if tearing and len(call.data) > SECTOR else None
                    _write(data, call, torn)
            files[name] = bytes(data)
        return files


def _write(data: bytearray, call: Call, torn: np.random.Generator | None) -> None:
    if call.kind == TRUNCATE:
        del data[call.offset :]
        data.extend(bytes(call.offset - len(data)))
        return
    end = call.offset + len(call.data)
    data.extend(bytes(max(0, end - len(data))))
    if torn is None:
        data[call.offset : end] = call.data
        return
    for at in range(0, len(call.data), SECTOR):
        if torn.random() < 0.5:
            part = call.data[at : at + SECTOR]
            data[call.offset + at : call.offset + at + len(part)] = part


def _change_names(names: dict[str, int], call: Call) -> None:
    path = Path(call.path).name
    if call.kind == CREATE:
        names[path] = call.inode
    elif call.kind == UNLINK:
        names.pop(path, None)
    elif path in names:
        names[Path(call.to).name] = names[path]
        if call.kind == RENAME:
            del names[path]


def read_calls(file: Path, folder: Path) -> list[Call]:
    """The calls that were written down, of files in a folder and of the folder itself."""
    data, at, calls = file.read_bytes(), 0, []
    while at < len(data):
        kind, inode, offset, size, first, second = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        path = data[at : at + first].decode()
        to = data[at + first : at + first + second].decode()
        at += first + second
        call = Call(kind, inode, offset, path, to, data[at : at + size])
        at += size
        if Path(path.removesuffix(" (deleted)")).parent == folder or Path(path) == folder:
            calls.append(call)
    return calls


def record(
    scene: Scene, begin: dict[str, bytes], folder: Path, log: Path
) -> tuple[Disk, list[Call]]:
    """Run a step in a process of its own; returns the disk before it, and its calls."""
    lay_out(folder, begin)
    inodes = {name: (folder / name).stat().st_ino for name in begin}
    library = ctypes.CDLL(None)
    file = os.open(log, os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            library.fault_record(file)
            scene.step.run(folder / "map.gpkg")
            library.fault_record(-1)
            code = 0
        finally:
            os._exit(code)
    os.close(file)
    _, status = os.waitpid(child, 0)
    assert status == 0, f"{scene.step.name} failed"
    return Disk(begin, inodes), read_calls(log, folder)


def lay_out(folder: Path, files: dict[str, bytes]) -> None:
    """Make a folder hold these files and no others."""
    for old in folder.iterdir():
        old.unlink()
    for name, data in files.items():
        (folder / name).write_bytes(data)


def state_of(path: Path) -> str:
    """A digest of all that the map holds, after opening it as a reader does; empty without one."""
    if not path.exists():
        return ""
    hashed = hashlib.sha256()
    with open_map(path) as universal:
        database = universal._connection
        tables = database.execute("SELECT * FROM sqlite_schema ORDER BY name").fetchall()
        hashed.update(repr(tables).encode())
        for kind, name, *_ in tables:
            if kind == "table":
                for row in database.execute(f"SELECT rowid, * FROM {name} ORDER BY 1"):
                    hashed.update(repr(row).encode())
    return hashed.hexdigest()


def cut(scene: Scene, begin: dict[str, bytes], folder: Path, log: Path, count: int,
        random: np.random.Generator) -> Counter[str]:  # fmt: skip
    """Cut the power so often during a step, and once more after it for each ten."""
    disk, calls = record(scene, begin, folder, log)
    shows_in = folder / scene.shows_in
    assert calls, f"{scene.step.name} made no call: the library is not in its way"
    states = _commits(disk, calls, begin, folder, shows_in)
    found: Counter[str] = Counter()
    points = sorted(int(p) for p in random.integers(1, len(calls) + 1 + len(calls) // 10, count))
    disk, done = _disk_of(begin, disk), 0
    for number, point in enumerate(points):
        while done < min(point, len(calls)):
            disk.take(calls[done])
            done += 1
        files = disk.after_a_cut(random)
        lay_out(folder, files)
        allowed = (
            [states[-1]] if point > len(calls) else states[: states.index(_at(states, done)) + 1]
        )
        try:
            state = state_of(shows_in)
            assert state in [one for one, _ in allowed], "neither old nor new"
            if number % _LOOKED_AT_WHOLE == 0:
                _go_on(shows_in)
        except BaseException as error:
            kept = Path("build") / "power_cut"
            kept.mkdir(parents=True, exist_ok=True)
            lay_out(kept, files)
            error.add_note(f"{scene.step.name}, after call {done} of {len(calls)}; see {kept}")
            raise
        found["old" if state == states[0][0] else "new" if state == states[-1][0] else "one of its "
              "commits"] += 1  # fmt: skip
    return found


def _disk_of(begin: dict[str, bytes], disk: Disk) -> Disk:
    return Disk(begin, disk.names)


def _commits(disk: Disk, calls: list[Call], begin: dict[str, bytes], folder: Path,
             shows_in: Path) -> list[tuple[str, int]]:  # fmt: skip
    """The states of the map in their order, each with the call after which a kill leaves it; each
    is verified once."""
    lay_out(folder, begin)
    states = [(state_of(shows_in), 0)]
    replayed = _disk_of(begin, disk)
    for number, call in enumerate(calls, 1):
        replayed.take(call)
        if call.kind in (UNLINK, RENAME, LINK, TRUNCATE) or number == len(calls):
            lay_out(folder, replayed.after_a_cut(None))
            state = state_of(shows_in)
            if state != states[-1][0]:
                states.append((state, number))
                with open_map(shows_in) as universal:
                    assert universal.verify(1, deep=True).sound
    return states


def _at(states: list[tuple[str, int]], done: int) -> tuple[str, int]:
    """The latest state that there can be after so many calls."""
    return [state for state in states if state[1] <= done][-1]


def _go_on(path: Path) -> None:
    """What a power cut leaves is sound, and can be gone on with."""
    if not path.exists():
        make(path)
    with open_map(path, writable=True) as universal:
        assert universal.verify(1, deep=True).sound
        universal.repair(jobs=1)


def _begins(folder: Path) -> Iterator[tuple[str, dict[str, bytes]]]:
    path, copy = folder / "map.gpkg", folder / "copy.gpkg"
    yield "nothing", {}
    yield "old", {path.name: _OLD_FORMAT.read_bytes()}
    make(path)
    add("1", -30.0, 3).run(path)
    remove("1").run(path)
    yield "two", {path.name: path.read_bytes()}
    merge(copy).run(path)
    shift("0", 2.0).run(path)
    yield "two and a copy", {path.name: path.read_bytes(), copy.name: copy.read_bytes()}


def _inside(count: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    total: Counter[str] = Counter()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory() as other:
        folder, log = Path(name).resolve(), Path(other) / "calls"
        begins = dict(_begins(folder))
        every = scenes(folder)
        for scene in every:
            share = -(-count // len(every))
            found = cut(scene, begins[scene.begins_with], folder, log, share, random)
            said = ", ".join(f"{what} {number}" for what, number in sorted(found.items()))
            print(f"  {scene.step.name} ({scene.begins_with}): {said}", flush=True)
            total.update(found)
        shutil.rmtree(folder)
        folder.mkdir()
    seconds = time.perf_counter() - start
    print(
        f"{total.total()} power cuts in {seconds:.0f} s: old or new, nothing acknowledged was lost"
    )


def main() -> None:
    """Run as a program."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["--inside"]:
        if "careless" in arguments:  # as if nothing were synced: this must be found
            store.keep_one_file = lambda connection, **_: keep_one_file(connection, durable=False)  # type: ignore[attr-defined]
        _inside(int(arguments[1]), int(arguments[2]))
        return
    count = arguments[0] if arguments else "1000"
    seed = arguments[1] if len(arguments) > 1 else "1"
    done = run_in_child("tests.crash.power", count, seed)
    print(done.stdout, end="")
    print(done.stderr, end="", file=sys.stderr)
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
