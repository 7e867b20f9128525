"""The frames of a recording as messages: images with their calibration, depths, points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from fieldgrid.array_types import UInt8
from fieldgrid.convert.drive import Said
from fieldgrid.convert.messages import (
    DEPTH,
    LEFT,
    LIDAR,
    RIGHT,
    camera_info,
    cloud_message,
    depth_info,
    header_of,
    image_message,
    new,
)
from fieldgrid.recording import (
    CloudFrame,
    DepthFrame,
    Frame,
    ImageFile,
    ImageSource,
    Recording,
    StereoFrame,
)
from fieldgrid.recording.bag.images import CompressedImage
from fieldgrid.recording.images import AS_STORED
from fieldgrid.rig import DepthCamera, Rig, StereoCamera


class Images(StrEnum):
    """How images are written: as the files they are, as pixels, or not at all."""

    COMPRESSED = "compressed"
    RAW = "raw"
    NONE = "none"


def frames_said(
    recording: Recording, images: Images, progress: Callable[[int, int], None] | None
) -> Iterator[Said]:
    """All frames by the clock of the receiver, read one by one."""
    rig = recording.rig
    for done, frame in enumerate(recording.frames(), start=1):
        time_ns = frame.time_ns + rig.image_time_offset_ns
        for order, (topic, message) in enumerate(_of_frame(frame, rig, images, time_ns), start=6):
            yield Said(time_ns, order, topic, message)
        if progress is not None:
            progress(done, recording.frame_count)


def _of_frame(frame: Frame, rig: Rig, images: Images, time_ns: int) -> Iterator[tuple[str, Any]]:
    if isinstance(frame, StereoFrame):
        yield from _of_pair(frame, rig.camera, images, time_ns)
    elif isinstance(frame, DepthFrame) and isinstance(rig.sensor, DepthCamera):
        header = header_of(time_ns, DEPTH)
        depth = np.ascontiguousarray(frame.depth.read(), dtype="<f4")
        yield "/depth/camera_info", depth_info(rig.sensor, header)
        yield "/depth/image_rect", image_message(depth, "32FC1", header)
    elif isinstance(frame, CloudFrame):
        yield "/lidar/points", cloud_message(frame.cloud.read(), header_of(time_ns, LIDAR))


def _of_pair(
    frame: StereoFrame, camera: StereoCamera, images: Images, time_ns: int
) -> Iterator[tuple[str, Any]]:
    pixels = frame.images()  # also what makes sure that they can be read
    right_cx_px = camera.cx_px if camera.cx_right_px is None else camera.cx_right_px
    sides = (
        ("left", LEFT, frame.left, pixels[0], camera.cx_px, 0.0),
        ("right", RIGHT, frame.right, pixels[1], right_cx_px, -camera.focal_baseline_px_m),
    )
    for side, name, source, grey, cx_px, shift_px_m in sides:
        header = header_of(time_ns, name)
        yield f"/stereo/{side}/camera_info", camera_info(camera, cx_px, shift_px_m, header)
        topic = f"/stereo/{side}/image_rect"
        if images is Images.RAW:
            yield topic, image_message(grey, "mono8", header)
        else:
            stored = None if frame.rectifier else _stored(source)
            encoded, data = stored or ("png", _png(grey))
            yield (
                f"{topic}/compressed",
                new(
                    "sensor_msgs/CompressedImage",
                    header=header,
                    format=encoded,
                    data=np.frombuffer(data, dtype=np.uint8),
                ),
            )


def _stored(source: ImageSource) -> tuple[str, bytes] | None:
    """The bytes of an image as recorded, if they are a JPEG or a PNG that says all of itself."""
    if isinstance(source, ImageFile):
        if source.format != AS_STORED:
            return None
        data = source.path.read_bytes()
    elif isinstance(source, CompressedImage):
        data = source.decoded().data.tobytes()
    else:
        return None
    if data.startswith(b"\xff\xd8\xff"):
        return "jpeg", data
    return ("png", data) if data.startswith(b"\x89PNG\r\n\x1a\n") else None


def _png(grey: UInt8) -> bytes:
    """Rectified pixels without loss."""
    _, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return bytes(data)
