"""What the image files of a recording have in common, told or found out once for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fieldgrid.core import RecordingError
from fieldgrid.recordings.frames.images import ImageFile, ImageFormat
from fieldgrid.recordings.frames.pixels import BITS, Pixels, significant_bits
from fieldgrid.recordings.readers.settings_file import RecordingSettings
from fieldgrid.recordings.stored import Shot

_SAMPLES = 5


def image_format(
    folder: Path, shots: Sequence[Shot], settings: RecordingSettings
) -> tuple[ImageFormat, tuple[str, ...]]:
    """The format of the images of all frames, and a remark where it was guessed.

    Only images of 16 bit leave something open: how many of them the camera fills.
    """
    if settings.bits is not None:
        return ImageFormat(settings.bayer, settings.bits), ()
    step = max(1, len(shots) // _SAMPLES)
    chosen = [name for shot in shots[::step][:_SAMPLES] for name in shot.files]
    samples = (_deep_pixels(folder / name) for name in chosen)
    bits = significant_bits(sample for sample in samples if sample is not None)
    if bits == BITS[-1]:
        return ImageFormat(settings.bayer), ()
    note = (
        f"Of the 16 bits of the images the lower {bits} are taken as filled, by {len(chosen)} of "
        f"them; if that is wrong, say so in recording.toml: [images] bits = {bits}."
    )
    return ImageFormat(settings.bayer, bits), (note,)


def stored_size_px(folder: Path, shots: Sequence[Shot]) -> tuple[int, int] | None:
    """(width, height) of the first image; None where there is none yet, or it cannot be read."""
    try:
        return ImageFile(folder / shots[0].files[0]).size_px() if shots else None
    except RecordingError:
        return None


def _deep_pixels(path: Path) -> Pixels | None:
    """The pixels of an image if they have 16 bits; what is wrong with an image is said when it is
    used."""
    try:
        return ImageFile(path).deep_pixels()
    except RecordingError:
        return None
