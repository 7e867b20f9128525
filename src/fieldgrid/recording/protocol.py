"""What a recording is, whatever its files: frames, fixes, and the rig they came from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from fieldgrid.array_types import Float32, Int64, UInt8
from fieldgrid.errors import CalibrationError, RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.motion import Motion
from fieldgrid.rig import Rig

Image = UInt8
"""A grey image [row, column], row 0 at the top."""


class Source(Protocol):
    """Where one message or file of a frame comes from; its bytes are read when they are needed."""

    @property
    def name(self) -> str:
        """What an error calls it: the path, or the topic and time."""

    def sha256(self) -> str:
        """The hash of its bytes as recorded, in hexadecimal; empty when there are none."""


class ImageSource(Source, Protocol):
    """Where one image comes from."""

    def read(self) -> Image:
        """The image in grey, 8 bit; :class:`RecordingError` when it cannot be had."""


class DepthSource(Source, Protocol):
    """Where one image of depths comes from."""

    def read(self) -> Float32:
        """Depth along the optical axis [row, column], metres; NaN where there is none."""


class CloudSource(Source, Protocol):
    """Where one point cloud comes from."""

    def read(self) -> Float32:
        """Points [n, 3], metres in the sensor's frame: x right, y down, z forward; all finite."""


class PairRectifier(Protocol):
    """What makes a rectified pair of a raw one; safe to call from threads."""

    @property
    def raw_size_px(self) -> tuple[int, int]:
        """(width, height) of the raw images."""

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """The rectified pair, of the size that the calibration is for."""


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """A stereo pair that is not read yet.

    `time_ns` is UTC as the camera stamped it; the rig's offset is not added. `size_px` is the
    (width, height) that the calibration is for. The sources are rectified already where there is
    no `rectifier`.
    """

    frame_id: str
    time_ns: int
    left: ImageSource
    right: ImageSource
    size_px: tuple[int, int]
    rectifier: PairRectifier | None = None

    @property
    def sources(self) -> tuple[Source, ...]:
        """What the frame is made of."""
        return self.left, self.right

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
        width, height = self.rectifier.raw_size_px if self.rectifier else self.size_px
        if left.shape != (height, width):
            raise CalibrationError(
                f"{self.left.name} has {_size(left)} px, but the calibration is for "
                f"{width} x {height} px; give the calibration of these images."
            )
        return self.rectifier(left, right) if self.rectifier else (left, right)


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """An image of depths that is not read yet; times as in :class:`StereoFrame`."""

    frame_id: str
    time_ns: int
    depth: DepthSource
    size_px: tuple[int, int]

    @property
    def sources(self) -> tuple[Source, ...]:
        """What the frame is made of."""
        return (self.depth,)


@dataclass(frozen=True, slots=True)
class CloudFrame:
    """A point cloud that is not read yet; times as in :class:`StereoFrame`."""

    frame_id: str
    time_ns: int
    cloud: CloudSource

    @property
    def sources(self) -> tuple[Source, ...]:
        """What the frame is made of."""
        return (self.cloud,)


Frame = StereoFrame | DepthFrame | CloudFrame
"""What a local grid is made from. All frames of one recording are of one kind."""


def pair_of(frame: Frame) -> StereoFrame:
    """The frame as a stereo pair; RecordingError for one of another kind."""
    if not isinstance(frame, StereoFrame):
        raise RecordingError(
            f"This needs stereo pairs, and frame {frame.frame_id} is none; leave it out for this "
            "drive."
        )
    return frame


@dataclass(frozen=True, slots=True)
class Stream:
    """One sequence of messages or rows as recorded, used or not: what an inspection looks at.

    `role` is what it is to the recording (of `options.ROLES`, or gyro, wheels), empty when it is
    not used. `stamp_ns` are the times that the messages carry, int64, in the order of the record
    and not corrected, 0 for one without; `receive_ns` when each was written down, None where
    nothing says so. Of a stream that is not used both may be empty.
    """

    name: str
    kind: str
    role: str
    count: int
    stamp_ns: Int64
    receive_ns: Int64 | None = None


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

    def gnss_sha256(self) -> str:
        """The hash of what the fixes are from, in hexadecimal; empty when that is no one log."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for a reader: what was skipped or assumed, a sentence each."""

    @property
    def losses(self) -> tuple[str, ...]:
        """What of the drive is lost, since a file is truncated or damaged; a sentence each."""

    def streams(self) -> Sequence[Stream]:
        """Everything that was recorded, also what is not used."""

    def frame_times_ns(self) -> Int64:
        """Times of the frames as the camera stamped them, shape (frame_count,), increasing."""

    def frames(self) -> Iterator[Frame]:
        """The frames in order of time; no image is read before it is asked for."""

    def fixes(self) -> FixColumns:
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
