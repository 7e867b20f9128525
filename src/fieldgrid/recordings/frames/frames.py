"""Frames: what a local grid is made from, not read yet.

A frame and what it holds can be pickled, so that another process may read it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn, Protocol, TypeVar

from fieldgrid.core import CalibrationError, Float32, Int64, RecordingError, UInt8
from fieldgrid.perception import Sweep

Image = UInt8
"""A grey image [row, column], row 0 at the top."""

T_co = TypeVar("T_co", covariant=True)
T = TypeVar("T")


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

    def encoded(self) -> bytes:
        """The JPEG or PNG file that the image is and that says all of itself; else empty."""


class DepthSource(Source, Protocol):
    """Where one image of depths comes from."""

    def read(self) -> Float32:
        """Depth along the optical axis [row, column], metres; NaN where there is none."""


class CloudSource(Source, Protocol):
    """Where one point cloud comes from."""

    def sweep(self) -> Sweep:
        """The points, metres in the sensor's frame: x right, y down, z forward; all finite. With
        their times where they have any and still are where they were seen."""


class PairRectifier(Protocol):
    """What makes a rectified pair of a raw one; safe to call from threads."""

    @property
    def raw_size_px(self) -> tuple[int, int]:
        """(width, height) of the raw images."""

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """The rectified pair, of the size that the calibration is for."""


class FrameReader(Protocol[T_co]):
    """What is made of a frame, by its kind."""

    def pair(self, left: Image, right: Image) -> T_co:
        """Of a rectified pair."""

    def depth(self, depth_m: Float32) -> T_co:
        """Of depths [row, column], metres, NaN where there is none."""

    def cloud(self, sweep: Sweep) -> T_co:
        """Of points of the sensor's frame."""


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
        _check_size(self.left.name, left, (width, height))
        return self.rectifier(left, right) if self.rectifier else (left, right)

    def encoded(self) -> tuple[bytes, bytes]:
        """Both images as the JPEG or PNG files that they are; empty where they are none, or where
        they are rectified on the way."""
        if self.rectifier is not None:
            return b"", b""
        return self.left.encoded(), self.right.encoded()

    def read(self, reader: FrameReader[T]) -> T:
        """What a reader makes of the frame, once it is read."""
        return reader.pair(*self.images())


@dataclass(frozen=True, slots=True)
class SingleFrame:
    """A frame of one source, which is no pair; the rest as in :class:`StereoFrame`."""

    frame_id: str
    time_ns: int
    source: Source

    @property
    def sources(self) -> tuple[Source, ...]:
        """What the frame is made of."""
        return (self.source,)

    def images(self) -> NoReturn:
        """Raise RecordingError: this is no pair."""
        raise RecordingError(
            f"This needs stereo pairs, and frame {self.frame_id} is none; leave it out for this "
            "drive."
        )

    def encoded(self) -> tuple[bytes, bytes]:
        """Nothing: this is no pair."""
        return b"", b""


@dataclass(frozen=True, slots=True)
class DepthFrame(SingleFrame):
    """An image of depths that is not read yet."""

    source: DepthSource
    size_px: tuple[int, int]

    def read(self, reader: FrameReader[T]) -> T:
        """What a reader makes of the frame. CalibrationError for depths of another size than the
        calibration is for."""
        depth_m = self.source.read()
        _check_size(self.source.name, depth_m, self.size_px)
        return reader.depth(depth_m)


@dataclass(frozen=True, slots=True)
class CloudFrame(SingleFrame):
    """A point cloud that is not read yet."""

    source: CloudSource

    def read(self, reader: FrameReader[T]) -> T:
        """What a reader makes of the frame."""
        return reader.cloud(self.source.sweep())


Frame = StereoFrame | DepthFrame | CloudFrame
"""All frames of one recording are of one kind."""


class FrameSource(Protocol):
    """The frames of a recording. It can be pickled; a copy in another process reads the same as
    long as the recording is open."""

    @property
    def times_ns(self) -> Int64:
        """Times of the frames as the camera stamped them, increasing."""

    @property
    def roles(self) -> tuple[str, ...]:
        """What the parts of a frame are, of `options.ROLES`."""

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Frames number `start` to before `stop`, in order; no image is read before it is asked
        for."""


def _check_size(name: str, image: Image | Float32, size_px: tuple[int, int]) -> None:
    width, height = size_px
    if image.shape != (height, width):
        raise CalibrationError(
            f"{name} has {_size(image)} px, but the calibration is for {width} x {height} px; give "
            "the calibration of these images."
        )


def _size(image: Image | Float32) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
