"""An MCAP out of a pipe: the map of a build of the same file, and what cannot be read of it."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from fieldgrid.build import build_map
from fieldgrid.convert import convert_recording
from fieldgrid.errors import ConfigError
from fieldgrid.live import LiveOptions, McapStream, Sources, live_folder
from fieldgrid.recording import open_recording
from fieldgrid.recording.growing import open_growing
from fieldgrid.recording.stored import PairKind
from fieldgrid.settings import BuildSettings
from tests.build.making import content
from tests.live.making import begin
from tests.live.sources import QUICK, Heard, running


@pytest.fixture(scope="module")
def recorded(short_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short drive as an MCAP that is written as it comes: not in chunks, and without remarks on
    fixes, whose topic comes after them."""
    folder = tmp_path_factory.mktemp("mcap")
    convert_recording(short_drive, folder / "all.mcap")
    with (folder / "all.mcap").open("rb") as source, (folder / "drive.mcap").open("wb") as to:
        writer = Writer(to, use_chunking=False)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(source).iter_messages(log_time_order=True):
            assert schema is not None
            if channel.topic.endswith("/details"):
                continue
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, number
                )
            times = message.log_time, message.publish_time
            writer.add_message(channels[channel.topic], times[0], message.data, times[1])
        writer.finish()
    return folder / "drive.mcap"


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    return path


def stream(drive: Path, pipe: Path, **topics: str) -> McapStream:
    kind = open_growing(drive).kind
    assert isinstance(kind, PairKind)
    return McapStream(str(pipe), kind, topics)


def write(pipe: Path, data: bytes) -> threading.Thread:
    def run() -> None:
        with suppress(BrokenPipeError):  # the reader may have all that it waits for before
            pipe.write_bytes(data)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


def test_the_map_out_of_a_pipe_is_that_of_a_build(
    short_drive: Path, recorded: Path, pipe: Path, tmp_path: Path
) -> None:
    out, heard = tmp_path / "m.gpkg", Heard()
    build_map([recorded], tmp_path / "built.gpkg", BuildSettings())
    with open_recording(recorded) as recording:
        live = begin(recording, out, on_result=heard, options=LiveOptions(queue_frames=6))
        fixes = len(recording.fixes())
        with Sources(live, (stream(short_drive, pipe),), QUICK):
            write(pipe, recorded.read_bytes())
            heard.wait(lambda: live.counts.frames == 6 and live.counts.fixes == fixes)
        live.finish()
    assert not live_folder(out).exists()
    ours, theirs = content(out), content(tmp_path / "built.gpkg")
    for kind in theirs:
        if kind != "fieldgrid_session":  # which says where its data come from
            assert ours[kind] == theirs[kind], kind


def test_what_is_no_mcap_is_told_and_what_follows_is_read(
    short_drive: Path, recorded: Path, pipe: Path
) -> None:
    with running(stream(short_drive, pipe)) as notes:
        write(pipe, b"no MCAP at all" * 10).join()
        notes.wait_told("what comes is no MCAP")
        notes.wait_told("is tried again")
        write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.frames) == 6)


def test_topics_of_other_names(short_drive: Path, recorded: Path, pipe: Path) -> None:
    with running(stream(short_drive, pipe, left="/nothing")) as notes:
        write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.fixes) > 20)
    assert not notes.frames
    images = McapStream(str(pipe), stream(short_drive, pipe)._kind, takes_fixes=False)
    with running(images) as notes:
        write(pipe, recorded.read_bytes())
        notes.wait(lambda: len(notes.frames) == 6)
    assert not notes.fixes
    with pytest.raises(ConfigError, match="give one of left, right"):
        stream(short_drive, pipe, middle="/camera")
    with pytest.raises(ConfigError, match="No MCAP is read from"):
        McapStream("udp://:9000", stream(short_drive, pipe)._kind)
