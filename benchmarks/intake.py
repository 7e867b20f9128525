"""`python -m benchmarks.intake [FOLDER]`: what every file and folder of the shared data opens as.

A line each: fixes, frames, what moves, first and last second, and a word that stands for all values
of the columns, so that a value that changes is a line that vanishes and one that appears. A drive
that is refused has the first words of its refusal.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fieldgrid.core import FieldgridError
from fieldgrid.geometry import FixColumns
from fieldgrid.recordings import Drive, DriveOptions, Recording, open_drive

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_LETTERS = "abcdefghijklmnop"


def main() -> None:
    """Print the table."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else DATA
    for path in _candidates(folder):
        line = f"{path.relative_to(folder)}: {_opened(path)}"
        print(line.replace(f"{folder}/", ""), flush=True)


def _candidates(folder: Path) -> Iterator[Path]:
    """Every folder, and every file but images."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in (".png", ".jpg", ".jpeg", ".npy"):
            yield path


def _opened(path: Path) -> str:
    try:
        with open_drive(path, DriveOptions(unmounted=True)) as drive:
            return _told(drive)
    except FieldgridError as problem:
        sentence = str(problem).replace(str(path), "IT")
        return f"0 fixes, {type(problem).__name__}, {' '.join(sentence.split()[:12])}"


def _told(drive: Drive) -> str:
    fixes, moves = drive.fixes(), drive.motion()
    frames = drive.frame_times_ns() if isinstance(drive, Recording) else np.empty(0, np.int64)
    times_ns = np.concatenate([fixes.time_ns, frames])
    span = f"{times_ns.min() / 1e9:.1f} to {times_ns.max() / 1e9:.1f} s" if times_ns.size else ""
    moving = [name for name, said in moves._asdict().items() if said is not None]
    columns = [
        *(getattr(fixes, name) for name in FixColumns.__dataclass_fields__),
        *(part for name in moving for part in getattr(moves, name)),
        frames,
    ]
    return (
        f"{drive.kind}, {len(fixes)} fixes, {len(frames)} frames, {' '.join(moving)}, {span}, "
        f"values {_word(columns)}, {len(drive.notes)} notes"
    )


def _word(columns: list[object]) -> str:
    """Letters alone: a digit would be a figure."""
    digest = hashlib.sha256()
    for column in columns:
        digest.update(np.ascontiguousarray(np.asarray(column)).tobytes())
    return "".join(_LETTERS[value & 15] for value in digest.digest()[:10])


if __name__ == "__main__":
    main()
