"""Live sessions of small drives, and what they told."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from fieldgrid.core import Float64, Int64
from fieldgrid.live import Live, LiveEvent, LiveResult, replay
from fieldgrid.pipeline import estimate_trajectory
from fieldgrid.recordings import DriveOptions, PoseSource, Recording, open_drive, open_recording

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


FRAME_DEG = 35.0
"""How the frame of the poses is turned against east."""


def write_tum(path: Path, time_ns: Int64, place_m: Float64, turned: Rotation) -> Path:
    lines = []
    for time, place, q in zip(time_ns.tolist(), place_m, turned.as_quat(), strict=True):
        numbers = " ".join(repr(float(value)) for value in (*place, *q))
        lines.append(f"{time // 10**9}.{time % 10**9:09d} {numbers}")
    path.write_text("\n".join(lines) + "\n")
    return path


def slam(drive: Path, path: Path, *, roll_deg: float = 0.0) -> Path:
    """What another program makes of a drive: the ground below its sensor, in a frame of its own,
    twenty times a second, with the axes forward, left, up."""
    with open_recording(drive) as recording:
        track = estimate_trajectory(recording)
        frame_ns = recording.frame_times_ns()
    time_ns = np.arange(frame_ns[0] - 4_000_000_000, frame_ns[-1] + 3_000_000_000, 50_000_000)
    poses = [track.at(int(t)) for t in time_ns]
    east, north = (np.array([getattr(p, name) for p in poses]) for name in ("east_m", "north_m"))
    yaw_deg = 90.0 - np.array([p.heading_deg for p in poses]) - FRAME_DEG
    turn = np.radians(FRAME_DEG)
    x, y = east - east[0], north - north[0]
    place = np.stack(
        [
            x * np.cos(turn) + y * np.sin(turn),
            -x * np.sin(turn) + y * np.cos(turn),
            np.zeros(len(x)),
        ],
        axis=1,
    )
    leans = np.full(len(x), roll_deg)
    turned = Rotation.from_euler("ZYX", np.stack([yaw_deg, 0.0 * leans, leans], axis=1), True)
    return write_tum(path, time_ns, place, turned)


@contextmanager
def with_poses(drive: Path, tum: Path) -> Iterator[Recording]:
    with open_drive(drive, DriveOptions(poses=PoseSource(tum))) as opened:
        yield opened.recording()
