"""The images that a frame was made from, where they still are.

A map names them and keeps their SHA-256. They are looked for by that name, from the working folder,
the folder of the map and the recordings that the user names, and are shown only if their bytes have
the hash that the map has. What is sent is a new JPEG, never the file.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath

import numpy as np
from PIL import Image

from fieldgrid.core import RecordingError

MAX_FILE_BYTES = 64 << 20
MAX_PIXELS = 64_000_000
_MAX_PARTS = 32
_SIDE_PX = 1600
_QUALITY = 88


def find_picture(name: str, sha256: str, folders: Sequence[Path]) -> tuple[bytes, int, int]:
    """The image of a name, in one of the folders, as JPEG, and the width and height in pixels of
    the image that it was made from; RecordingError says why there is none."""
    is_changed = False
    for path in _candidates(name, folders):
        data = _read(path)
        if data is not None:
            if not sha256 or hashlib.sha256(data).hexdigest() == sha256:
                return _jpeg(data, name)
            is_changed = True
    if is_changed:
        raise RecordingError(
            f"{name} is there, but it is another image than the one that the map was made from; "
            "give the recording with --recording FOLDER."
        )
    raise RecordingError(
        f"{name} is no longer where the map was made; give the recording with --recording FOLDER."
    )


def _candidates(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """Where an image may be: its name, and ever shorter ends of it, in each folder."""
    parts = PurePath(name.replace("\\", "/")).parts
    if not parts or len(parts) > _MAX_PARTS or "\0" in name or ".." in parts:
        return
    if Path(name).is_absolute():
        yield Path(name)
        parts = parts[1:]
    for first in range(len(parts)):
        for folder in folders:
            yield folder.joinpath(*parts[first:])


def _read(path: Path) -> bytes | None:
    """The bytes of a plain file of bearable size; None for anything else."""
    try:
        if not path.is_file() or path.stat().st_size > MAX_FILE_BYTES:
            return None
        return path.read_bytes()
    except OSError:
        return None


def _jpeg(data: bytes, name: str) -> tuple[bytes, int, int]:
    """An image as JPEG; one of 16 bits is stretched to 8 over the range that it uses."""
    written = io.BytesIO()
    try:
        with Image.open(io.BytesIO(data)) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise RecordingError(f"{name} has {width} x {height} pixels, too many to show.")
            drawn: Image.Image = image
            if image.mode.startswith("I"):
                values = np.asarray(image, dtype=np.float64)
                low, high = float(values.min()), float(values.max())
                stretched = (values - low) * (255.0 / max(high - low, 1.0))
                drawn = Image.fromarray(stretched.astype(np.uint8))
            drawn = drawn.convert("RGB")
        drawn.thumbnail((_SIDE_PX, _SIDE_PX))
        drawn.save(written, "JPEG", quality=_QUALITY)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise RecordingError(f"{name} cannot be shown: it is no image ({error}).") from error
    return written.getvalue(), width, height
