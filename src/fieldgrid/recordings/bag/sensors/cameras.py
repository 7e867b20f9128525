"""The camera of a bag, by camera_info: the same calibration that its file would be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import DepthCamera
from fieldgrid.recordings.bag.content import BagIndex
from fieldgrid.recordings.bag.topic_names import INFO, is_rectified
from fieldgrid.recordings.bag.topics import listing
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Calibration, Entries, data
from fieldgrid.recordings.calibration.ros import check_calibrated, depth_camera

_MOST_NUMBERS = 64
"""More than any matrix of a camera_info has."""


def stereo_pair(content: BagIndex, said: bool | None) -> Calibration:
    """The camera of the pair, and how raw images are rectified, by its two calibrations. Raises
    CalibrationError.

    Whether the images are rectified is `said`, or by None told by the names of their topics.
    """
    left, right = info_of(content, "left_info"), info_of(content, "right_info")
    topics = content.roles["left"], content.roles["right"]
    named = {is_rectified(topic) for topic in topics}
    if said is None and len(named) > 1:
        raise CalibrationError(
            f"{content.path}: of {topics[0]} and {topics[1]} one is rectified and one is not; "
            "choose two alike with --topic left= and --topic right=."
        )
    between = Entries({}, left.path)
    if not (left.has("P") or right.has("P")):
        frames = content.frame_id("left_info"), content.frame_id("right_info")
        placed = content.transforms.place(*frames)
        if placed is None:
            raise CalibrationError(
                f"{left.path} and {right.path} have no P, and no static transform joins their "
                f"frames {frames[0]!r} and {frames[1]!r}; calibrate the pair."
            )
        between = Entries({"R": data(placed.R), "T": data(placed.at_m)}, left.path)
    pair = CalibratedPair(left.path, left, right, between)
    found = pair.calibration(named.pop() if said is None else said)
    return found._replace(R_rect_left=left.get("R")) if left.has("R") else found


def disparity_camera(content: BagIndex, image: Any) -> DepthCamera:
    """The camera of disparity images, of which the first is given: f and T are its own."""
    info = info_of(content, "left_info")
    P = info.get("P")
    P[0, 0] = P[1, 1] = float(image.f)
    return depth_camera(info._replace(document={"P": data(P)}), float(image.t))


def info_of(content: BagIndex, role: str) -> Entries:
    """The calibration of a camera by a sensor_msgs/CameraInfo of either ROS. CalibrationError for
    one that is missing, or not of whole images."""
    path, roles, topics = content.path, content.roles, content.readings.bag.topics
    message = content.readings.first(roles.get(role))
    if message is None:
        infos = [topic for topic in topics.values() if topic.type == INFO]
        raise CalibrationError(
            f"{path} has no readable camera_info for {role}; record that of the camera, or name "
            f"it with --topic {role}=NAME, of {listing(infos or topics.values())}."
        )
    source = Path(f"{path.name}: {roles[role]}")
    if message.binning_x > 1 or message.binning_y > 1 or message.roi.width or message.roi.height:
        raise CalibrationError(
            f"{source}: binning or a region of interest is set, which is not read; record whole "
            "images with the calibration of their size."
        )
    numbers = {key: getattr(message, key.lower())[: _MOST_NUMBERS + 1] for key in "KDRP"}
    used = "KDRP" if numbers["P"].any() else "KD"
    if not numbers["R"].any():
        numbers["R"] = np.eye(3)
    document = {key: data(numbers[key]) for key in used}
    size_px = int(message.width), int(message.height)
    info = Entries(document, source, size_px, model=str(message.distortion_model))
    return check_calibrated(info)
