"""Bags of ROS 1 as ROS's own library reads them: where Debian's python3-rosbag is installed."""

from __future__ import annotations

import hashlib
import json
import subprocess
from functools import lru_cache
from pathlib import Path

from rosbags.highlevel import AnyReader

_PYTHON = "/usr/bin/python3"
_PROGRAM = """
import hashlib, io, json, sys
import rosbag
found = []
with rosbag.Bag(sys.argv[1]) as bag:
    for topic, message, time in bag.read_messages():
        again = io.BytesIO()
        message.serialize(again)
        digest = hashlib.sha256(again.getvalue()).hexdigest()
        found.append([topic, time.to_nsec(), message._md5sum, digest])
print(json.dumps(found))
"""


@lru_cache
def rosbag_is_there() -> bool:
    """Whether the system's Python has rosbag."""
    asked = [_PYTHON, "-c", "import rosbag"]
    return Path(_PYTHON).exists() and subprocess.run(asked, capture_output=True).returncode == 0


def check_by_rosbag(path: Path) -> None:
    """It decompresses each chunk and decodes each message by the definition within the bag."""
    with AnyReader([path]) as reader:
        written = [
            [connection.topic, time_ns, connection.digest, hashlib.sha256(data).hexdigest()]
            for connection, time_ns, data in reader.messages()
        ]
    asked = [_PYTHON, "-c", _PROGRAM, str(path)]
    done = subprocess.run(asked, capture_output=True, text=True, timeout=120, env={})
    assert done.returncode == 0, done.stderr
    assert sorted(json.loads(done.stdout)) == sorted(written)
