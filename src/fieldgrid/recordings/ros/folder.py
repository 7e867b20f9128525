"""A bag that is a folder: which files it consists of, in which order.

That is a ROS 2 bag, or the files that `rosbag record --split` leaves.
"""

from __future__ import annotations

import re
import tempfile
import textwrap
from contextlib import ExitStack
from pathlib import Path, PurePath
from typing import NamedTuple

from fieldgrid.core import RecordingError, UnfoldBudget
from fieldgrid.recordings.calibration.yaml_text import parse_yaml
from fieldgrid.recordings.ros.source import ZSTD_MAGIC, unpacked_pieces

METADATA = "metadata.yaml"
_KEY = "rosbag2_bagfile_information"
_MAX_METADATA_BYTES = 1 << 24
_LIST = re.compile(r"^( *)relative_file_paths:.*\n(?:\1[ -].*\n|[ \t]*\n)*", re.MULTILINE)
_ROS2, _ROS1 = (".db3", ".mcap"), (".bag", ".bag.active")
_PACKED = ".zstd"


class BagFiles(NamedTuple):
    """The files of a bag, and clauses on what is wrong with the list of them."""

    paths: list[Path]
    notes: list[str]


def is_bag_folder(folder: Path) -> bool:
    """Whether the folder holds files of a bag, or the description of one."""
    return is_ros2_folder(folder) or bool(_named(folder, _ROS1))


def is_ros2_folder(folder: Path) -> bool:
    """Whether the folder holds files of a ROS 2 bag, or the description of one."""
    return bool(_named(folder, _ROS2)) or _KEY.encode() in _metadata(folder)


def find_files(folder: Path) -> BagFiles:
    """The files in the order of recording. Raises RecordingError where there is none."""
    names = _listed(folder)
    listed = [folder / PurePath(name).name for name in names]
    missing = [path.name for path in listed if not path.is_file()]
    paths = [path for path in listed if path.is_file()]
    # Beside a bag there often lies what it was converted from.
    paths = paths or _named(folder, _ROS2) or _named(folder, _ROS1)
    if not paths:
        raise RecordingError(
            f"{folder} holds no .db3, .mcap or .bag file; copy all files of the bag into it."
        )
    notes = []
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        notes.append(f"{missing[0]}{more}, named in {METADATA}, is missing")
    return BagFiles(paths, notes)


def unpacked(path: Path, stack: ExitStack) -> tuple[Path, bool]:
    """The file itself, or what it holds if it is compressed; and whether that is all of it."""
    with path.open("rb") as file:
        if file.read(len(ZSTD_MAGIC)) != ZSTD_MAGIC:
            return path, True
    folder = stack.enter_context(tempfile.TemporaryDirectory())
    inner = Path(folder, path.name.removesuffix(_PACKED))
    try:
        with path.open("rb") as packed, inner.open("wb") as whole:
            for piece in unpacked_pieces(packed, UnfoldBudget(path, path.stat().st_size)):
                whole.write(piece)
    except EOFError:
        return inner, False
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be decompressed ({error.strerror}); free some space for temporary "
            "files, or unpack it with `zstd -d`."
        ) from error
    return inner, True


def _named(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """The files of the folder that are named so, packed or not, 2 before 10."""
    found = [
        path
        for path in folder.iterdir()
        if path.name.removesuffix(_PACKED).endswith(suffixes) and path.is_file()
    ]
    parts = re.compile(r"(\D*)(\d{0,18})")
    return sorted(found, key=lambda p: [(int(n or 0), text) for text, n in parts.findall(p.name)])


def _metadata(folder: Path) -> bytes:
    path = folder / METADATA
    if not path.is_file():
        return b""
    try:
        with path.open("rb") as file:
            return file.read(_MAX_METADATA_BYTES)
    except OSError:
        return b""


def _listed(folder: Path) -> list[str]:
    """The names that the description lists; none where it is missing or unreadable."""
    found = _LIST.search(_metadata(folder).decode("utf-8", "replace") + "\n")
    if found is None:
        return []
    try:
        names = parse_yaml(textwrap.dedent(found[0]))["relative_file_paths"]
    except (ValueError, LookupError, TypeError):
        return []
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
