"""Recordings: what was on the vehicle's disk after a drive, whatever its format."""

from fieldgrid.recording.columns import Columns, columns_from_text, epoch_s
from fieldgrid.recording.copies import cache_folder, is_url
from fieldgrid.recording.drive import Drive, Recording, Stream, as_recording, with_frames
from fieldgrid.recording.fetched import fetch
from fieldgrid.recording.fix_log import FixLog
from fieldgrid.recording.format import (
    Format,
    formats,
    mounting_path,
    register_format,
    unregister_format,
)
from fieldgrid.recording.frames import (
    CloudFrame,
    CloudSource,
    DepthFrame,
    DepthSource,
    Frame,
    FrameReader,
    FrameSource,
    Image,
    ImageSource,
    Source,
    StereoFrame,
)
from fieldgrid.recording.images import ImageFile
from fieldgrid.recording.mounting import Mounting
from fieldgrid.recording.opening import open_drive, open_recording
from fieldgrid.recording.options import ROLES, DriveOptions
from fieldgrid.recording.pose_source import PoseBody

__all__ = [
    "ROLES",
    "CloudFrame",
    "CloudSource",
    "Columns",
    "DepthFrame",
    "DepthSource",
    "Drive",
    "DriveOptions",
    "FixLog",
    "Format",
    "Frame",
    "FrameReader",
    "FrameSource",
    "Image",
    "ImageFile",
    "ImageSource",
    "Mounting",
    "PoseBody",
    "Recording",
    "Source",
    "StereoFrame",
    "Stream",
    "as_recording",
    "cache_folder",
    "columns_from_text",
    "epoch_s",
    "fetch",
    "formats",
    "is_url",
    "mounting_path",
    "open_drive",
    "open_recording",
    "register_format",
    "unregister_format",
    "with_frames",
]
