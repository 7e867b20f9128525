"""The frames of a recording as messages: images with their calibration, depths, points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from fieldgrid.core import Float32
from fieldgrid.geometry import Rig
from fieldgrid.perception import Sweep
from fieldgrid.pipeline.convert.drive import DEPTH, LEFT, LIDAR, RIGHT, StampedMessage
from fieldgrid.recordings import (
    Frame,
    Image,
    Recording,
    camera_info,
    cloud_message,
    compressed_image,
    header_of,
    image_message,
)


class Images(StrEnum):
    """How images are written: as the files they are, as pixels, or not at all."""

    COMPRESSED = "compressed"
    RAW = "raw"
    NONE = "none"


def frame_messages(
    recording: Recording, images: Images, progress: Callable[[int, int], None] | None
) -> Iterator[StampedMessage]:
    """All frames by the clock of the receiver, read one by one."""
    rig = recording.rig
    for done, frame in enumerate(recording.frames(), start=1):
        time_ns = frame.time_ns + rig.image_time_offset_ns
        for topic, message in frame.read(_FrameMessages(frame, rig, images, time_ns)):
            yield StampedMessage(time_ns, topic, message)
        if progress is not None:
            progress(done, recording.frame_count)


class _FrameMessages:
    """The messages of one frame, by its kind: topic and message."""

    def __init__(self, frame: Frame, rig: Rig, images: Images, time_ns: int) -> None:
        self._frame, self._rig, self._images, self._time_ns = frame, rig, images, time_ns

    def pair(self, left: Image, right: Image) -> Iterator[tuple[str, Any]]:
        """A pair: it is read already, which makes sure that it can be."""
        camera = self._rig.camera
        right_cx_px = camera.cx_px if camera.cx_right_px is None else camera.cx_right_px
        encoded = self._frame.encoded()
        sides = (
            ("left", LEFT, left, encoded[0], camera.cx_px, 0.0),
            ("right", RIGHT, right, encoded[1], right_cx_px, -camera.focal_baseline_px_m),
        )
        for side, name, grey, data, cx_px, shift_px_m in sides:
            header = header_of(self._time_ns, name)
            yield f"/stereo/{side}/camera_info", camera_info(camera, cx_px, shift_px_m, header)
            topic = f"/stereo/{side}/image_rect"
            if self._images is Images.RAW:
                yield topic, image_message(grey, "mono8", header)
            else:
                yield f"{topic}/compressed", compressed_image(data or _png(grey), header)

    def depth(self, depth_m: Float32) -> Iterator[tuple[str, Any]]:
        """An image of depths."""
        header = header_of(self._time_ns, DEPTH)
        camera = self._rig.depth_camera
        yield "/depth/camera_info", camera_info(camera, camera.cx_px, 0.0, header)
        metres = np.ascontiguousarray(depth_m, dtype="<f4")
        yield "/depth/image_rect", image_message(metres, "32FC1", header)

    def cloud(self, sweep: Sweep) -> Iterator[tuple[str, Any]]:
        """A cloud."""
        yield "/lidar/points", cloud_message(sweep, header_of(self._time_ns, LIDAR))


def _png(grey: Image) -> bytes:
    """Rectified pixels without loss."""
    _, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return bytes(data)
