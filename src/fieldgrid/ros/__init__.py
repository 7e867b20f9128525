"""Containers of ROS messages, of ROS 1 and ROS 2: read tolerantly and as a stream, and written.

`open_bag` opens a `.bag`, an `.mcap`, a `.db3` or a folder of these as one `Bag`, whatever state
its end is in. `McapWriter`, `BagFolderWriter` and `Ros1BagWriter` write. What the messages mean is
for others.
"""

from __future__ import annotations

from fieldgrid.ros.bag import Bag, Listen, Take, is_bag, open_bag
from fieldgrid.ros.definitions import decode, types
from fieldgrid.ros.model import Connection, Message, Topic
from fieldgrid.ros.writers import BagFolderWriter, McapWriter, Ros1BagWriter

__all__ = [
    "Bag",
    "BagFolderWriter",
    "Connection",
    "Listen",
    "McapWriter",
    "Message",
    "Ros1BagWriter",
    "Take",
    "Topic",
    "decode",
    "is_bag",
    "open_bag",
    "types",
]
