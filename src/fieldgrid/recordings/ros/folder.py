"""A bag that is a folder: which files it consists of, in which order.

That is a ROS 2 bag, or the files that `rosbag record --split` leaves.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path, PurePath
from typing import NamedTuple

from fieldgrid.core import RecordingError

METADATA = "metadata.yaml"
_KEY = b"rosbag2_bagfile_information"
_MAX_METADATA_BYTES = 1 << 24
_LIST = re.compile(r"^( *)relative_file_paths:.*\n(?:\1[ -].*\n|[ \t]*\n)*", re.MULTILINE)
_ITEM = re.compile(r"^ *- (.*)$", re.MULTILINE)
_NUMBERED = re.compile(r"(\D*)(\d{0,18})")
_ROS2, _ROS1 = (".db3", ".mcap"), (".bag", ".bag.active")
PACKED = ".zstd"


class BagFiles(NamedTuple):
    """The files of a bag, and clauses on what is wrong with the list of them."""

    paths: list[Path]
    notes: list[str]


def is_bag_folder(folder: Path) -> bool:
    """Whether the folder holds files of a bag, or the description of one."""
    return is_ros2_folder(folder) or bool(_named(folder, _ROS1))


def is_ros2_folder(folder: Path) -> bool:
    """Whether the folder holds files of a ROS 2 bag, or the description of one."""
    return bool(_named(folder, _ROS2)) or _KEY in _metadata(folder)


def find_files(folder: Path) -> BagFiles:
    """The files in the order of recording: as its description lists them, or by their numbers.
    Raises RecordingError where there is none."""
    listing = _LIST.search(_metadata(folder).decode("utf-8", "replace") + "\n")
    names = _ITEM.findall(listing[0]) if listing else []
    listed = [folder / PurePath(name.strip(" \"'\r")).name for name in names]
    missing = [path.name for path in listed if not path.is_file()]
    paths = [path for path in listed if path.is_file()]
    # Beside a bag there often lies what it was converted from.
    paths = paths or _named(folder, _ROS2) or _named(folder, _ROS1)
    if not paths:
        raise RecordingError(
            f"{folder} holds no .db3, .mcap or .bag file; copy all files of the bag into it."
        )
    if not missing:
        return BagFiles(paths, [])
    more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
    return BagFiles(paths, [f"{missing[0]}{more}, named in {METADATA}, is missing"])


def _named(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """The files of the folder that are named so, packed or not, 2 before 10."""
    found = [
        path
        for path in folder.iterdir()
        if path.name.removesuffix(PACKED).endswith(suffixes) and path.is_file()
    ]
    return sorted(
        found, key=lambda p: [(int(n or 0), text) for text, n in _NUMBERED.findall(p.name)]
    )


def _metadata(folder: Path) -> bytes:
    """What the description of the folder holds; nothing where it cannot be read."""
    path = folder / METADATA
    with suppress(OSError):
        if path.is_file():  # and no pipe
            with path.open("rb") as file:
                return file.read(_MAX_METADATA_BYTES)
    return b""
