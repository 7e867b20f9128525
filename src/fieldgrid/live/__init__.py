"""Live: a drive that is not over: pushed to, seen at once, a map at its end.

* `session`: `Live`, pushed to while the vehicle drives; `results`: `LiveEvent`s it gives.
* `intake`: `Sources` in threads of their own; `sources`: receivers, cameras, folders, MCAP.
* `perceiver`: frames to local grids; `pose`: the pose now, by a fixed-lag estimate.
* `window`: `LiveWindow`, the costmap around the vehicle.
* `kept`: the journal on disk, from which `finish` makes the map after any end.
* `ros`: a node of ROS 2: topics in, windows, poses and the map out.
* `servers`: `LivePage`, `FoxgloveServer` and the TCP `Feed` for controllers.
* `replaying`: a recording pushed as if it were driven now.

The map at the end is made by the estimate and the fold of `pipeline`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.live.finish import (
        discard_session as discard_session,
        finish_from as finish_from,
        finish_session as finish_session,
    )
    from fieldgrid.live.intake import (
        InputSource as InputSource,
        Pauses as Pauses,
        Sources as Sources,
    )
    from fieldgrid.live.kept.kept_drive import live_folder as live_folder
    from fieldgrid.live.options import LiveOptions as LiveOptions
    from fieldgrid.live.replaying import replay as replay
    from fieldgrid.live.results import (
        Counts as Counts,
        LiveEvent as LiveEvent,
        LiveGrid as LiveGrid,
        LivePose as LivePose,
        LiveResult as LiveResult,
        LiveWindow as LiveWindow,
        What as What,
        WindowDoubt as WindowDoubt,
    )
    from fieldgrid.live.ros.head import Head as Head
    from fieldgrid.live.ros.node import RosNode as RosNode
    from fieldgrid.live.ros.place import RobotFrames as RobotFrames
    from fieldgrid.live.ros.serving import MapServer as MapServer
    from fieldgrid.live.ros.session import RosSession as RosSession
    from fieldgrid.live.ros.so_far import MapSoFar as MapSoFar
    from fieldgrid.live.ros.stream import RosStream as RosStream
    from fieldgrid.live.servers.address import (
        parse_feed as parse_feed,
        parse_server_address as parse_server_address,
    )
    from fieldgrid.live.servers.feed import Feed as Feed
    from fieldgrid.live.servers.foxglove import FoxgloveServer as FoxgloveServer
    from fieldgrid.live.servers.live_state import LiveState as LiveState
    from fieldgrid.live.servers.page import LivePage as LivePage
    from fieldgrid.live.session import Live as Live
    from fieldgrid.live.sources.camera import (
        StereoDevices as StereoDevices,
        parse_devices as parse_devices,
    )
    from fieldgrid.live.sources.images import ImageFolder as ImageFolder
    from fieldgrid.live.sources.links import parse_address as parse_address
    from fieldgrid.live.sources.mcap_stream import McapStream as McapStream, PoseTopic as PoseTopic
    from fieldgrid.live.sources.receiver import (
        Receiver as Receiver,
        ReceiverStream as ReceiverStream,
    )
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
