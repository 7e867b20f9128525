"""Live sessions of small drives, and what they told."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from fieldgrid.live import Live, LiveEvent, LiveResult, replay
from fieldgrid.recording import Recording, open_recording

T = TypeVar("T")


BEFORE_S, AFTER_S = 6.0, 4.0


def cut_log(drive: Path) -> None:
    """Leave of the log what lies around the frames of a small drive."""
    with open_recording(drive) as recording:
        times_ns, fix_ns = recording.frame_times_ns(), recording.fixes().time_ns
    near = (fix_ns > times_ns[0] - BEFORE_S * 1e9) & (fix_ns < times_ns[-1] + AFTER_S * 1e9)
    log = drive / "gnss" / "gnss_rtk.nmea"
    epochs = re.split(rb"(?=\$GPGGA)", log.read_bytes())
    assert len(epochs) == len(fix_ns) + 1
    log.write_bytes(b"".join(epochs[k + 1] for k in near.nonzero()[0]))


class Told:
    """Keeps what a session tells."""

    def __init__(self) -> None:
        self.results: list[LiveResult] = []

    def __call__(self, result: LiveResult) -> None:
        self.results.append(result)

    def of(self, kind: type[T]) -> list[T]:
        return [result for result in self.results if isinstance(result, kind)]

    def texts(self, what: str) -> list[str]:
        return [event.text for event in self.of(LiveEvent) if event.what == what]


def begin(recording: Recording, out: Path, **options: Any) -> Live:
    """A session as the command has it of a recording."""
    return Live(
        out,
        recording.rig,
        options.pop("settings", None),
        name=recording.name,
        datum_hint=recording.datum_hint,
        source=recording.gnss_source,
        source_sha256=recording.gnss_sha256(),
        **options,
    )


def drive_live(
    drive: Path, out: Path, told: Callable[[LiveResult], None] | None = None, **options: Any
) -> None:
    """Replay a whole drive, no frame dropped, and make its map."""
    with (
        open_recording(drive) as recording,
        begin(recording, out, on_result=told, **options) as live,
    ):
        replay(live, recording, rate=None)
