"""A UVC stereo camera through OpenCV, as a source of frames: one device that gives both images
side by side, or two devices.

A frame has the time of this machine's clock at which it was taken from the driver; a camera of this
kind tells none. It is the receiver's time only as far as this clock is set by it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack

import cv2
import numpy as np

from fieldgrid.core import ConfigError, quoted
from fieldgrid.geometry import Rig
from fieldgrid.live.intake import Intake
from fieldgrid.live.pushed import PushedSource
from fieldgrid.recordings import PairRectifier, StereoFrame


def open_device(number: int, size_px: tuple[int, int]) -> cv2.VideoCapture:
    """A device of this machine, for pictures of (width, height) px; OSError where it is not
    there."""
    device = cv2.VideoCapture(number)
    if not device.isOpened():
        device.release()
        raise OSError(f"device {number} cannot be opened")
    device.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
    device.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
    device.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return device


def parse_devices(text: str) -> tuple[int, ...]:
    """The numbers of one device or of two, like 0 or 0,2; ConfigError for others."""
    parts = text.split(",")
    if not (len(parts) <= 2 and all(part.strip().isdecimal() for part in parts)):
        raise ConfigError(f"{quoted(text)} is no camera; give a device number, or two as in 0,1.")
    devices = tuple(int(part) for part in parts)
    if len(set(devices)) < len(devices) or max(devices) > 999:
        raise ConfigError(
            f"{quoted(text)} is no camera; give the numbers of two devices, left first."
        )
    return devices


class StereoDevices:
    """Pairs from one device, left and right side by side, or from two, left and right, of which at
    most `most_fps` a second are taken. `rectifier` makes rectified pairs of raw ones."""

    def __init__(
        self,
        devices: Sequence[int],
        rig: Rig,
        rectifier: PairRectifier | None = None,
        *,
        most_fps: float = 10.0,
    ) -> None:
        if not 0.1 <= most_fps <= 1000.0:
            raise ConfigError(f"{most_fps:g} pairs a second are outside 0.1..1000; 10 is usual.")
        self._devices, self._rectifier = tuple(devices), rectifier
        camera = rig.camera
        self._size_px = camera.width_px, camera.height_px
        self._raw_px = rectifier.raw_size_px if rectifier else self._size_px
        self._every_ns = round(0.9e9 / most_fps)  # a little less, or every second one were left out
        self._taken_ns = 0

    @property
    def name(self) -> str:
        """The camera and its devices."""
        return f"The camera {','.join(map(str, self._devices))}"

    def run(self, intake: Intake) -> None:
        """Give pairs as they come; see `Source`."""
        width, height = self._raw_px
        size_px = (width if len(self._devices) == 2 else 2 * width, height)
        with ExitStack() as stack:
            open_ = []
            for number in self._devices:
                device = open_device(number, size_px)
                stack.callback(device.release)
                open_.append(device)
            while not intake.stop.is_set():
                self._take(open_, intake)

    def _take(self, devices: Sequence[cv2.VideoCapture], intake: Intake) -> None:
        times_ns = []
        for device in devices:
            if not device.grab():
                raise OSError("it gives no more pictures")
            times_ns.append(time.time_ns())
        intake.arrived()
        time_ns = sum(times_ns) // len(times_ns)
        if 0 <= time_ns - self._taken_ns < self._every_ns:
            return
        self._taken_ns = time_ns
        pictures = []
        for device in devices:
            is_there, picture = device.retrieve()
            if not is_there:
                raise OSError("a picture of it cannot be read")
            grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            pictures.append(np.ascontiguousarray(grey, dtype=np.uint8))
        if len(pictures) == 1:
            half = pictures[0].shape[1] // 2
            pictures = [pictures[0][:, :half], pictures[0][:, half:]]
        left, right = pictures
        name = str(time_ns)
        sides = PushedSource(f"{name}/left", left), PushedSource(f"{name}/right", right)
        intake.push_frame(StereoFrame(name, time_ns, *sides, self._size_px, self._rectifier))

    def finish(self, intake: Intake) -> None:
        """Nothing is left open."""
