"""Live: local grids, poses and a costmap while the vehicle drives, the map at the end."""

from fieldgrid.live.camera import StereoDevices, parse_devices
from fieldgrid.live.feed import Feed
from fieldgrid.live.feeds import open_feed, parse_feed
from fieldgrid.live.finish import discard_session, finish_from, finish_session
from fieldgrid.live.images import ImageFolder
from fieldgrid.live.intake import Pauses, Sources
from fieldgrid.live.kept_drive import live_folder
from fieldgrid.live.live import Live
from fieldgrid.live.mcap_stream import McapStream
from fieldgrid.live.options import LiveOptions
from fieldgrid.live.receiver import Receiver, ReceiverStream
from fieldgrid.live.replay import replay
from fieldgrid.live.results import (
    Counts,
    LiveEvent,
    LiveGrid,
    LivePose,
    LiveResult,
    LiveWindow,
    What,
    WindowDoubt,
)

__all__ = [
    "Counts",
    "Feed",
    "ImageFolder",
    "Live",
    "LiveEvent",
    "LiveGrid",
    "LiveOptions",
    "LivePose",
    "LiveResult",
    "LiveWindow",
    "McapStream",
    "Pauses",
    "Receiver",
    "ReceiverStream",
    "Sources",
    "StereoDevices",
    "What",
    "WindowDoubt",
    "discard_session",
    "finish_from",
    "finish_session",
    "live_folder",
    "open_feed",
    "parse_devices",
    "parse_feed",
    "replay",
]
