"""What comes to a drive from outside does not stop it: many connections, and a camera that is away
for a minute."""

from __future__ import annotations

import os
import shutil
import socket
import threading
import time
from collections import deque
from contextlib import ExitStack, suppress
from pathlib import Path

from fieldgrid.core import BuildSettings
from fieldgrid.live import Feed, FoxgloveServer, LivePage, LiveResult, LiveWindow, replay
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import Frame, open_recording
from tests.conftest import TWO_LANES, make_small_drive
from tests.live.conftest import IMU
from tests.live.making import begin
from tests.live.sources import TIMEOUT_S, Heard
from tests.pipeline.drives.making import content

CONNECTIONS, HELD = 5_000, 400
SENT = (b"", b"GET / HTTP/1.1\r\nHost: x\r\n", b"\0" * 100)
"""Nothing, half a request, and what is none."""


def flood(addresses: list[tuple[str, int]], descriptors: list[int]) -> None:
    """Connect many times, and keep the last open; note how many `descriptors` the process has."""
    with ExitStack() as stack:
        held: deque[socket.socket] = deque()
        for k in range(CONNECTIONS):
            connection = socket.create_connection(addresses[k % len(addresses)], TIMEOUT_S)
            held.append(stack.enter_context(connection))
            with suppress(OSError):  # it was hung up on
                connection.sendall(SENT[k // len(addresses) % len(SENT)])
            if len(held) > HELD:
                held.popleft().close()
            if k % 100 == 0:
                descriptors.append(len(os.listdir("/proc/self/fd")))


def is_served(feed: Feed) -> bool:
    """Whether the feed greets who connects."""
    with socket.create_connection(feed.address, TIMEOUT_S) as client:
        return client.recv(4) == b"FGWN"


def test_thousands_of_connections_to_its_servers_do_not_stop_a_drive(
    short_drive: Path, built: Path, tmp_path: Path
) -> None:
    out = tmp_path / "m.gpkg"
    with LivePage() as page, Feed("127.0.0.1", 0) as feed, FoxgloveServer(port=0) as foxglove:

        def take(result: LiveResult) -> None:
            page.take(result)
            foxglove.take(result)
            if isinstance(result, LiveWindow):
                feed.put(result)

        port = int(page.link.split(":")[2].split("/")[0])
        addresses = [("127.0.0.1", port), feed.address, foxglove.address]
        before = len(os.listdir("/proc/self/fd"))
        with open_recording(short_drive) as recording:
            live = begin(recording, out, on_result=take)
            descriptors: list[int] = []
            flooding = threading.Thread(target=flood, args=(addresses, descriptors))
            flooding.start()
            replay(live, recording, rate=None)
            flooding.join()
            assert (live.counts.frames, live.counts.dropped) == (6, 0)
            until_s = time.monotonic() + TIMEOUT_S
            while not is_served(feed) and time.monotonic() < until_s:
                time.sleep(0.05)
            assert is_served(feed)  # those who left made room
            live.finish()
    # 64 connections a server, and what a session and a map have open.
    assert len(descriptors) == CONNECTIONS // 100
    assert max(descriptors) - before < HELD + 3 * 64 + 40
    assert content(out) == content(built)


def test_a_camera_that_is_away_for_a_minute_is_told_and_comes_back(tmp_path: Path) -> None:
    drive = make_small_drive(tmp_path / "drive", [0, 1, 2, 40, 41, 42])
    (drive / "imu").mkdir()
    shutil.copy(TWO_LANES / IMU, drive / IMU)
    out, heard = tmp_path / "m.gpkg", Heard()

    def doubts() -> list[str]:
        return [window.doubt for window in heard.of(LiveWindow)]

    with open_recording(drive) as recording:
        live = begin(recording, out, on_result=heard)
        push_frame = live.push_frame

        def pushed(frame: Frame, *, wait: bool = False) -> bool:
            if frame.frame_id == "000040":
                heard.wait(lambda: any("no frame for" in one for one in heard.texts("pose")))
            if frame.frame_id == "000042":
                heard.wait(lambda: doubts()[-1:] == [""])
            return push_frame(frame, wait=wait)

        live.push_frame = pushed  # type: ignore[method-assign]
        replay(live, recording, rate=None)
        assert live.counts.frames == 6
        live.finish()
    build_map([drive], tmp_path / "built.gpkg", BuildSettings())
    assert content(out) == content(tmp_path / "built.gpkg")
