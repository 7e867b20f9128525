"""The drives of a map as what is found in it rests on them: sessions and sigmas of their frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from fieldgrid.core import Float64
from fieldgrid.geometry import Status
from fieldgrid.maps import MapFile, to_universal


class VehicleTracks(NamedTuple):
    """What the drives of a map say beside their evidence: where the vehicle was, what each frame
    covers, the session it is of, and the sigma of its place."""

    track_m: Float64
    footprints: Sequence[shapely.Polygon]
    sessions: Sequence[str]
    sigma_m: Float64


class Reach:
    """Looks up which frames of the drives cover a shape; without drives none does."""

    def __init__(self, drives: VehicleTracks | None) -> None:
        self._drives = drives if drives is not None and len(drives.footprints) else None
        self._tree = None if self._drives is None else shapely.STRtree(self._drives.footprints)

    def of(self, shape: Any) -> tuple[tuple[str, ...], float]:
        """The sessions of the frames that cover something of a shape, in metres east and north, and
        the median sigma of the places of these frames, 0 where none is known."""
        if self._tree is None or self._drives is None:
            return (), 0.0
        seeing = np.sort(self._tree.query(shape, predicate="intersects"))
        sigma = self._drives.sigma_m[seeing]
        known = sigma[np.isfinite(sigma)]
        sessions = tuple(dict.fromkeys(self._drives.sessions[i] for i in seeing))
        return sessions, float(np.median(known)) if len(known) else 0.0


def drives_of(universal: MapFile, at: str | int | None) -> VehicleTracks:
    """The drives that a map has, or had after a session or by a date."""
    active = [info.name for info in universal.sessions() if info.active]
    names = active if at is None else universal.sessions_at(at)
    tracks, footprints, sessions, sigmas = [np.zeros((0, 2))], [], [], []
    for name in names:
        frames = [
            frame for frame in universal.frames(name) if frame.pose.status is not Status.REJECTED
        ]
        for frame in frames:
            pose, spec = frame.pose, frame.spec
            x = np.array([-0.5, 0.5, 0.5, -0.5]) * spec.width_m
            y = np.array([0.0, 0.0, 1.0, 1.0]) * spec.length_m
            footprints.append(shapely.Polygon(np.column_stack(to_universal(x, y, pose))))
            sessions.append(name)
            sigmas.append(pose.position_sigma_m)
        tracks.append(np.array([(f.pose.east_m, f.pose.north_m) for f in frames]).reshape(-1, 2))
    return VehicleTracks(np.concatenate(tracks), footprints, sessions, np.array(sigmas))
