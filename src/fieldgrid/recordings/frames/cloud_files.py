"""Files of point clouds to points in the sensor's frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldgrid.core import Float32, RecordingError
from fieldgrid.perception import RawSweep, Sweep, seconds_after
from fieldgrid.recordings.files import RecordedFile
from fieldgrid.recordings.frames.frame_table import TABLE, FrameLayout
from fieldgrid.recordings.frames.frames import CloudFrame, Frame
from fieldgrid.recordings.frames.las import las_time_ns, read_las
from fieldgrid.recordings.frames.npy import parse_npy
from fieldgrid.recordings.frames.pcd import parse_pcd
from fieldgrid.recordings.frames.ply import parse_ply
from fieldgrid.recordings.stored import Shot
from fieldgrid.recordings.tables.motion_files import directions

AXES = "flu"
"""Where x, y and z of a cloud point when nothing is said: forward, left, up, as in ROS."""

_FARTHEST_M = 10_000.0


def _parse_npy(data: bytes, name: str) -> RawSweep:
    points = parse_npy(data, name)
    if points.ndim != 2 or points.shape[1] < 3:
        raise RecordingError(
            f"{name} has numbers of shape {points.shape}; a cloud is a row of x, y, z a point."
        )
    return RawSweep(points[:, :3])


def _parse_bin(data: bytes, name: str) -> RawSweep:
    if len(data) % 16:
        raise RecordingError(
            f"{name} has {len(data)} bytes, no multiple of the 16 of a point of KITTI; copy it "
            "again, or convert it."
        )
    return RawSweep(np.frombuffer(data, dtype="<f4").reshape(-1, 4)[:, :3])


_LAS = frozenset({".las", ".laz"})
_PARSERS = {".ply": parse_ply, ".pcd": parse_pcd, ".npy": _parse_npy, ".bin": _parse_bin}


def _time_ns(path: Path) -> int:
    """The time in a file without one in its name: LAS and LAZ may have it."""
    if path.suffix.lower() in _LAS:
        return las_time_ns(path)
    raise RecordingError(
        f"The cloud name {path.name} is no UTC time in s, ms, us or ns; rename the clouds, or add "
        f"{TABLE} with frame_id, timestamp_utc_s, cloud."
    )


CLOUDS = FrameLayout(("cloud",), ("clouds",), _LAS | _PARSERS.keys(), "cloud", "cloud", _time_ns)


@dataclass(frozen=True, slots=True)
class CloudKind:
    """What the numbers of cloud files mean: `axes` are where x, y and z point, like flu or rdf, and
    `scale_m` is what one of their units is. Points that are `corrected` for the motion within their
    sweep have no times any more."""

    axes: str = AXES
    corrected: bool = False
    scale_m: float = 1.0

    @property
    def roles(self) -> tuple[str, ...]:
        """Clouds."""
        return ("cloud",)

    def frame(self, folder: Path, shot: Shot) -> Frame:
        """The cloud, unread."""
        (name,) = shot.files
        source = CloudFile(folder / name, self, shot.time_ns)
        return CloudFrame(shot.frame_id, shot.time_ns, source)


@dataclass(frozen=True, slots=True)
class CloudFile(RecordedFile):
    """A PLY, PCD, LAS or LAZ, a NumPy array [n, 3 or more], or a .bin of KITTI (x, y, z and
    reflectance as float32). `stamp_ns` is the time of the frame."""

    kind: CloudKind = CloudKind()
    stamp_ns: int = 0

    def read(self) -> Float32:
        """Points [n, 3], metres: x right, y down, z forward. What is not finite, or beyond any
        range, is left out."""
        return self.sweep().points_m

    def sweep(self) -> Sweep:
        """The points, with their times where the file has any."""
        points, times = self._stored()
        with np.errstate(over="ignore", invalid="ignore"):
            own = points.astype(np.float32) * np.float32(self.kind.scale_m)
            near = (np.abs(own) < _FARTHEST_M).all(axis=1)  # false for NaN, too
        if not near.any() and np.isfinite(own).all(axis=1).any():
            raise RecordingError(
                f"The points of {self.path} lie over {_FARTHEST_M / 1000.0:g} km from "
                "their origin, so they are a map's and not a sensor's; give clouds in the sensor's "
                "frame, or, if they are not in metres, what a unit is: [cloud] scale_m in "
                "recording.toml."
            )
        after_s = None
        if times is not None and not self.kind.corrected:
            after_s = seconds_after(times[near], self.stamp_ns)
        return Sweep(to_optical(own[near], self.kind.axes), after_s)

    def _stored(self) -> RawSweep:
        suffix = self.path.suffix.lower()
        if suffix in _LAS:
            return read_las(self.path)
        data = self.data()
        if not data:
            raise RecordingError(f"{self.path} is empty; record or copy it again.")
        return _PARSERS[suffix](data, self.name)


def to_optical(points: Float32, axes: str) -> Float32:
    """Points [n, 3] with axes like flu as x right, y down, z forward: axes that change places
    and signs, exactly."""
    out = np.empty_like(points)
    for axis, (forward, left, up) in enumerate(directions(axes)):
        place, sign = (2, forward) if forward else (0, -left) if left else (1, -up)
        out[:, place] = points[:, axis] * np.float32(sign)
    return out
