"""What a recording is, whatever its files: stereo frames, fixes, and the rig they came from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import CalibrationError, RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.gnss import Fix
from fieldgrid.motion import Motion
from fieldgrid.rig import Rig

Image = npt.NDArray[np.uint8]
"""A grey image [row, column], row 0 at the top."""


class ImageSource(Protocol):
    """Where one image comes from; its bytes are read and decoded only by `read`."""

    @property
    def name(self) -> str:
        """What an error calls it: the path, or the topic and time."""

    def read(self) -> Image:
        """The image in grey, 8 bit; :class:`RecordingError` when it cannot be had."""

    def sha256(self) -> str:
        """The hash of its bytes as recorded, in hexadecimal; empty when there are none."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A stereo pair that is not read yet.

    `time_ns` is UTC as the camera stamped it; the rig's offset is not added. `size_px` is the
    (width, height) that the calibration is for.
    """

    frame_id: str
    time_ns: int
    left: ImageSource
    right: ImageSource
    size_px: tuple[int, int]

    def images(self) -> tuple[Image, Image]:
        """The rectified left and right image, grey, of the calibrated size.

        All reading and decoding happens here, and nothing is shared: frames may be read in
        worker threads.
        """
        left, right = self.left.read(), self.right.read()
        if left.shape != right.shape:
            raise RecordingError(
                f"The pair of frame {self.frame_id} differs in size: {self.left.name} has "
                f"{_size(left)} px, {self.right.name} {_size(right)} px; record both cameras alike."
            )
        width, height = self.size_px
        if left.shape != (height, width):
            raise CalibrationError(
                f"{self.left.name} has {_size(left)} px, but the calibration is for "
                f"{width} x {height} px; give the calibration of these rectified images."
            )
        return left, right


def _size(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


class Recording(Protocol):
    """A drive: what every kind of recording offers. It is a context manager."""

    @property
    def name(self) -> str:
        """The name of the drive, which its session takes."""

    @property
    def rig(self) -> Rig:
        """Camera, mount, antenna."""

    @property
    def datum_hint(self) -> Datum | None:
        """The datum that the recording itself asks for, None when it leaves that open."""

    @property
    def frame_count(self) -> int:
        """How many frames `frames` yields."""

    @property
    def gnss_source(self) -> str:
        """Which log the fixes are from; empty when there is none."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for a reader: what was skipped or assumed, a sentence each."""

    def frame_times_ns(self) -> npt.NDArray[np.int64]:
        """Times of the frames as the camera stamped them, shape (frame_count,), increasing."""

    def frames(self) -> Iterator[Frame]:
        """The frames in order of time; no image is read before it is asked for."""

    def fixes(self) -> Sequence[Fix]:
        """The fixes in the order of the log, none left out, not yet judged."""

    def motion(self) -> Motion:
        """Gyro and wheels, as far as the drive has them; empty when it has neither."""

    def close(self) -> None:
        """Release what is held open; a closed recording yields nothing more."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...
