"""The frames of a plain folder: by `frames.csv`, or by the names of the images."""

from __future__ import annotations

from pathlib import Path, PurePath

from fieldgrid.errors import RecordingError
from fieldgrid.recording.files import parse_time_ns, read_table
from fieldgrid.recording.images import SUFFIXES
from fieldgrid.recording.stored import Pair, checked_pairs

TABLE = "frames.csv"


def read_frames(folder: Path) -> tuple[tuple[Pair, ...], tuple[str, ...]]:
    """The stereo pairs of a folder in order of time, and remarks."""
    if (folder / TABLE).exists():
        return checked_pairs(_from_table(folder / TABLE), folder), ()
    pairs, notes = _from_names(folder)
    return checked_pairs(pairs, folder), notes


def _from_table(path: Path) -> list[Pair]:
    pairs = []
    for line, row in read_table(path, ("frame_id", "left", "right")):
        where = f"{path}, line {line}"
        for column in ("frame_id", "left", "right"):
            if not row[column]:
                raise RecordingError(f"{where}: {column} is empty; fill it or remove the row.")
        for name in (row["left"], row["right"]):
            # The table may come from elsewhere: it must not reach for other files of the reader.
            if PurePath(name).is_absolute() or ".." in PurePath(name).parts or "\0" in name:
                raise RecordingError(
                    f"{where}: {name!r} leads out of the recording; give a path inside its folder."
                )
        try:
            time_ns = parse_time_ns(row)
        except ValueError as problem:
            raise RecordingError(f"{where}: {problem}; correct it.") from problem
        pairs.append(Pair(time_ns, row["frame_id"], row["left"], row["right"]))
    return pairs


def _from_names(folder: Path) -> tuple[list[Pair], tuple[str, ...]]:
    left, right = _images(folder / "left"), _images(folder / "right")
    common = left.keys() & right.keys()
    pairs = []
    for stem in common:
        try:
            time_ns = parse_time_ns({"time_ns": stem})
        except ValueError:
            raise RecordingError(
                f"{folder} has no {TABLE}, and the image name {left[stem]} is no UTC time in "
                f"nanoseconds; add {TABLE} with frame_id, timestamp_utc_s, left, right."
            ) from None
        pairs.append(Pair(time_ns, stem, f"left/{left[stem]}", f"right/{right[stem]}"))
    alone = len(left) + len(right) - 2 * len(common)
    return pairs, (f"{alone} images without a partner skipped.",) if alone else ()


def _images(folder: Path) -> dict[str, str]:
    """File names of the images of a folder by their stem."""
    images: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in SUFFIXES:
            if path.stem in images:
                raise RecordingError(
                    f"{folder} has both {images[path.stem]} and {path.name}; remove one."
                )
            images[path.stem] = path.name
    return images
