"""Live: local grids, poses and a costmap while the vehicle drives, the map at the end."""

from fieldgrid.live.finish import discard_session, finish_from, finish_session
from fieldgrid.live.kept import live_folder
from fieldgrid.live.live import Counts, Live
from fieldgrid.live.posing import LiveOptions
from fieldgrid.live.replay import replay
from fieldgrid.live.results import (
    LiveEvent,
    LiveGrid,
    LivePose,
    LiveResult,
    LiveWindow,
    What,
)

__all__ = [
    "Counts",
    "Live",
    "LiveEvent",
    "LiveGrid",
    "LiveOptions",
    "LivePose",
    "LiveResult",
    "LiveWindow",
    "What",
    "discard_session",
    "finish_from",
    "finish_session",
    "live_folder",
    "replay",
]
