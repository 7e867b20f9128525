"""Containers of ROS messages, of ROS 1 and ROS 2: read tolerantly and as a stream, and written.

`open_bag` opens a `.bag`, an `.mcap`, a `.db3` or a folder of these as one `Bag`, whatever state
its end is in. What writes is in :mod:`fieldgrid.ros.writers`, which takes longer to import than all
that reads. What the messages mean is for others.
"""

from __future__ import annotations

from fieldgrid.ros.bag import Bag, Listen, Take, as_utc, is_bag, open_bag
from fieldgrid.ros.definitions import decode, types
from fieldgrid.ros.model import Connection, Message, Topic

__all__ = [
    "Bag",
    "Connection",
    "Listen",
    "Message",
    "Take",
    "Topic",
    "as_utc",
    "decode",
    "is_bag",
    "open_bag",
    "types",
]
